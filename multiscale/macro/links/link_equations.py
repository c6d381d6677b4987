r"""Equilibrium :math:`B^T \tau(B u) = \alpha F^d` of links: operator B, tangent B^T k B, states."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, triu

from multiscale.convergence import Solution
from multiscale.laws.link import Beam
from multiscale.macro.links.link_system import LinkSystem
from multiscale.numerics.factorisation import Factorise, Solve, prepare_cholesky


@dataclass(frozen=True, eq=False)
class Tangent:
    """Symmetric matrices of the same pattern, as entries of their upper triangle by rows."""

    start: np.ndarray  # first entry of each row, shape (n + 1,)
    column: np.ndarray  # increasing in each row
    products: csr_array  # products of two coefficients of a row of B, shape (entries, rows)
    pair: np.ndarray  # places in their row of both coefficients of every product, shape (2, ...)
    components: int  # of a node
    links: int  # number of the first rows of B, which are elongations
    cholesky: Factorise

    @property
    def diagonal(self) -> np.ndarray:
        """Indices of the entries on the diagonal, shape (n,)."""
        return self.start[:-1]

    @property
    def pattern(self) -> csr_array:
        """Upper triangle of ones, shape (n, n)."""
        n = self.start.size - 1
        return csr_array((np.ones(self.column.size, np.int8), self.column, self.start), (n, n))

    def entries(self, stiffness: np.ndarray) -> np.ndarray:
        """Return the upper triangle of B^T k B, N/m, for stiffnesses k of shape (rows,), N/m."""
        return np.asarray(self.products @ stiffness)

    @cached_property
    def motions(self) -> tuple[np.ndarray, ...]:
        """Products of two displacements of a link: their places, links, axes i and j, and signs."""
        (first, second), (i, j) = np.divmod(self.pair, self.components)
        at = np.flatnonzero((self.products.indices < self.links) & (i < 3) & (j < 3))
        sign = np.where(first == second, 1.0, -1.0)  # opposite at both ends
        return at, self.products.indices[at], i[at], j[at], sign[at]

    def geometric(self, direction: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Return the upper triangle of along n n^T + across (I - n n^T) of the links, N/m."""
        at, link, i, j, sign = self.motions
        value = np.zeros(self.products.nnz)
        value[at] = (along - across)[link] * direction[link, i] * direction[link, j]
        value[at] += across[link] * (i == j)
        value[at] *= sign
        return np.add.reduceat(value, self.products.indptr[:-1])

    def matrix(self, entries: np.ndarray) -> csr_array:
        """Return the matrix with both triangles, shape (n, n), N/m."""
        n = self.start.size - 1
        upper = csr_array((entries, self.column, self.start), shape=(n, n))
        return csr_array(upper + triu(upper, k=1).T)

    def factorise(self, entries: np.ndarray, *, signs: bool = False) -> Solve:
        """Return the function that solves with a matrix."""
        return self.cholesky(entries, signs)


@dataclass(frozen=True, eq=False)
class LinkEquations:
    r"""Arrays of :math:`B^T \tau(B u) = \alpha F^d`: elongations, then other modes of beams."""

    link: np.ndarray  # link of a row, shape (rows,)
    unknown: np.ndarray  # unknowns of a row, shape (rows, w), -1 for fixed components
    coefficient: np.ndarray  # entries of B, shape (rows, w)
    stiffness: np.ndarray  # k, shape (rows,), N/m
    prestress: np.ndarray  # tau^0, shape (rows,), N
    lower: np.ndarray  # admissible range, shape (rows,), N
    upper: np.ndarray
    load: np.ndarray  # F^d, shape (n,), N
    number: np.ndarray  # unknown of each component of the nodes, shape (nodes, c), -1 if fixed
    # rotations times a length and moments over it: every unknown is in m, every force in N
    unit: np.ndarray  # factor of each component: 1, or a length, m, for rotations

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.load.size

    @cached_property
    def operator(self) -> csr_array:
        """Sparse B, shape (rows, n)."""
        entry = (self.unknown >= 0) & (self.coefficient != 0.0)
        first = np.append(0, np.cumsum(entry.sum(axis=1)))
        shape = (len(self.unknown), self.n)
        return csr_array((self.coefficient[entry], self.unknown[entry], first), shape)

    @property
    def finite_stiffness(self) -> np.ndarray:
        """Stiffness of the rows, N/m; links of fixed length have the largest finite stiffness."""
        rigid = np.isinf(self.stiffness)
        stiffest = float(np.max(self.stiffness[~rigid], initial=0.0)) or 1.0
        return np.where(rigid, stiffest, self.stiffness)

    @cached_property
    def tangent(self) -> Tangent:
        """Tangent with the pattern of the unknowns that rows couple."""
        # products of two coefficients of a row, sorted by their entry in the upper triangle
        pairs = np.stack(np.triu_indices(self.unknown.shape[1])).astype(np.int8)
        i, j = np.sort(self.unknown[:, pairs].swapaxes(0, 1), axis=0).astype(np.int64)
        row, pair = np.nonzero(i >= 0)
        key = i[row, pair] * self.n + j[row, pair]
        order = np.argsort(key, kind="stable")
        row, places, key = row[order], pairs[:, pair[order]], key[order]
        product = np.prod(self.coefficient[row, places], axis=0)
        # entries: runs of equal keys
        first = np.flatnonzero(np.diff(key, prepend=-1))
        shape = (first.size, len(self.unknown))
        products = csr_array((product, row, np.append(first, row.size)), shape)
        upper, column = np.divmod(key[first], max(self.n, 1))
        start = np.searchsorted(upper, np.arange(self.n + 1)).astype(np.int32)
        column = column.astype(np.int32)
        solver = prepare_cholesky(start, column)
        components, links = self.number.shape[1], 1 + int(self.link.max(initial=-1))
        return Tangent(start, column, products, places, components, links, solver)

    def factorise(self, stiffness: np.ndarray) -> Solve:
        """Return the function that solves with B^T k B, for stiffnesses k of the rows, N/m."""
        return self.tangent.factorise(self.tangent.entries(stiffness))

    def at_nodes(self, u: np.ndarray) -> np.ndarray:
        """Return unknowns at the nodes, shape (nodes, c), m and rad; zero for fixed components."""
        # -1 selects the appended zero
        return np.asarray(np.append(u, 0.0)[self.number] / self.unit)

    def elongate(self, u: np.ndarray) -> np.ndarray:
        """Return B u, shape (rows,), m."""
        return np.asarray(self.operator @ u)

    def gather(self, tension: np.ndarray) -> np.ndarray:
        """Return B^T tau, shape (n,), N."""
        return np.asarray(self.operator.T @ tension)


def equations(system: LinkSystem) -> LinkEquations:
    """Return a row for each deformation of the links, and the numbers of the unknowns."""
    c = system.n_components
    free = ~np.asarray(system.fixed, dtype=bool)
    number = np.full(free.shape, -1, dtype=np.int32)
    number[free] = np.arange(np.count_nonzero(free), dtype=np.int32)
    unit = np.ones(c)
    unit[3:] = system.length.mean()

    coefficient = np.zeros((system.n_links, 2, c))
    coefficient[:, 0, :3], coefficient[:, 1, :3] = -system.direction, system.direction
    rows = np.arange(system.n_links)
    stiffness, (lower, upper) = system.stiffness, system.bounds
    if c == 6:
        beam_rows, beam_coefficient, beam_stiffness = _beam_modes(system)
        rows = np.concatenate([rows, beam_rows])
        coefficient = np.concatenate([coefficient, beam_coefficient])
        stiffness = np.concatenate([stiffness, beam_stiffness])
    extra = rows.size - system.n_links
    return LinkEquations(
        link=rows,
        unknown=np.ascontiguousarray(number[system.ends[rows]].reshape(rows.size, -1)),
        coefficient=(coefficient / unit).reshape(rows.size, -1),
        stiffness=stiffness,
        prestress=np.append(system.prestress, np.zeros(extra)),
        lower=np.append(lower, np.full(extra, -np.inf)),
        upper=np.append(upper, np.full(extra, np.inf)),
        load=(system.load / unit)[free],
        number=number,
        unit=unit,
    )


def _beam_modes(system: LinkSystem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return links, coefficients (rows, 2, 6) and stiffness of five modes of each beam."""
    rows, coefficients, stiffness = [], [], []
    for index, law in enumerate(system.laws):
        if not isinstance(law, Beam):
            continue
        links = np.flatnonzero(system.kind == index)
        x, y, z = _beam_axes(system.direction[links], np.array(law.up, dtype=float))
        chord = 2.0 / system.length[links, None]
        modes = np.zeros((5, links.size, 2, 6))
        modes[0, :, 0, 3:], modes[0, :, 1, 3:] = -x, x
        for first, axis, across in ((1, y, z), (3, z, -y)):
            modes[first, :, 0, 3:], modes[first, :, 1, 3:] = axis, -axis
            modes[first + 1, :, 0, 3:], modes[first + 1, :, 1, 3:] = axis, axis
            modes[first + 1, :, 0, :3], modes[first + 1, :, 1, :3] = -chord * across, chord * across
        rows.append(np.repeat(links, 5))
        coefficients.append(modes.transpose(1, 0, 2, 3).reshape(-1, 2, 6))
        stiffness.append(law.mode_stiffness(system.length[links])[1:].T.ravel())
    return np.concatenate(rows), np.concatenate(coefficients), np.concatenate(stiffness)


def rotary_inertia(system: LinkSystem) -> np.ndarray:
    """Return inertias of the nodes against rotations over their mass, shape (nodes, 3, 3), m2."""
    length, inertia = np.zeros(system.n_nodes), np.zeros((system.n_nodes, 3, 3))
    for index, law in enumerate(system.laws):
        if not isinstance(law, Beam):
            continue
        links = np.flatnonzero(system.kind == index)
        axes = np.array(_beam_axes(system.direction[links], np.array(law.up, dtype=float)))
        about_y, about_z = law.bending_y / law.rigidity, law.bending_z / law.rigidity
        # homogeneous section, r² = I / A = EI / EA:
        #     (r_y² + r_z²) e_x e_x^T + r_y² e_y e_y^T + r_z² e_z e_z^T  (1)
        each = np.einsum("a,abi,abj->bij", [about_y + about_z, about_y, about_z], axes, axes)  # (1)
        for end in system.ends[links].T:
            np.add.at(length, end, system.length[links])
            np.add.at(inertia, end, system.length[links, None, None] * each)
    return np.asarray(inertia / np.where(length > 0.0, length, 1.0)[:, None, None])


def _beam_axes(direction: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the local axes x, y, z of beams, each of shape (beams, 3)."""
    up = up / np.sqrt(up @ up)
    along = np.abs(direction @ up) > 1.0 - 1e-9
    upward = np.where(along[:, None], np.array([1.0, 0.0, 0.0]), up)
    z = upward - np.einsum("bi,bi->b", upward, direction)[:, None] * direction
    z = z / np.sqrt(np.einsum("bi,bi->b", z, z))[:, None]
    return direction, np.cross(z, direction), z


def compatibility(system: LinkSystem) -> csr_array:
    """Return the sparse compatibility operator of the free unknowns, shape (rows, n)."""
    return equations(system).operator


@dataclass(frozen=True, eq=False)
class LinkState:
    """Equilibrium at a load factor."""

    solution: Solution  # its value is the displacement, shape (n,), m
    tension: np.ndarray  # shape (rows,), N; of the modes of beams their force
    slack: np.ndarray  # shape (rows,), m; at least zero


def state_of(
    model: LinkEquations, solution: Solution, change: np.ndarray | None = None
) -> LinkState:
    """Return the state with the tensions (14), (15) of the source and the slack."""
    if change is None:
        change = model.stiffness * model.elongate(solution.value)
    elastic = model.prestress + change
    tension = np.clip(elastic, model.lower, model.upper)
    return LinkState(solution, tension, np.abs(tension - elastic) / model.stiffness)


def force_scale(model: LinkEquations, load: np.ndarray) -> float:
    """Return the reference force of residuals, N: the largest load, else the largest prestress."""
    return float(np.abs(load).max(initial=0.0)) or float(np.abs(model.prestress).max()) or 1.0


def round_off(tension: np.ndarray) -> float:
    """Return the residual force due to the rounding of the tensions, N."""
    return float(8.0 * np.finfo(float).eps * np.abs(tension).max())
