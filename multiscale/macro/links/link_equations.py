r"""Equilibrium :math:`B^T \tau(B u) = \alpha F^d` of links: operator B, tangent B^T k B, states."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, triu

from multiscale.convergence import Solution
from multiscale.laws.link import Beam
from multiscale.macro.links.link_system import LinkSystem
from multiscale.numerics.compiled import compiled
from multiscale.numerics.factorisation import Factorise, Solve, prepare_cholesky


@dataclass(frozen=True, eq=False)
class Tangent:
    """Symmetric matrices of the same pattern, as entries of their upper triangle by rows."""

    start: np.ndarray  # first entry of each row, shape (n + 1,)
    column: np.ndarray  # increasing in each row
    place: np.ndarray  # entry of each product of two coefficients of a row of B, -1 if fixed
    coefficient: np.ndarray  # entries of B, shape (rows, w)
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
        return np.asarray(_fill(self.place, self.coefficient, stiffness, self.column.size))

    def geometric(self, direction: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Return the upper triangle of a sum of stiffnesses along and across the links, N/m."""
        size = self.column.size
        return np.asarray(_fill_geometric(self.place, direction, along, across, size))

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
    r"""Arrays of the equilibrium :math:`B^T \tau(B u) = \alpha F^d`.

    The rows are the elongations of the links in their order, then the other modes of the beams.
    Rotations are multiplied by a length and moments divided by it, so that every unknown is in m
    and every force in N.
    """

    link: np.ndarray  # link of a row, shape (rows,)
    unknown: np.ndarray  # unknowns of a row, shape (rows, w), -1 for fixed components
    coefficient: np.ndarray  # entries of B, shape (rows, w)
    stiffness: np.ndarray  # k, shape (rows,), N/m
    prestress: np.ndarray  # tau^0, shape (rows,), N
    lower: np.ndarray  # admissible range, shape (rows,), N
    upper: np.ndarray
    load: np.ndarray  # F^d, shape (n,), N
    number: np.ndarray  # unknown of each component of the nodes, shape (nodes, c), -1 if fixed
    unit: np.ndarray  # factor of each component: 1, or a length, m, for rotations

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.load.size

    @cached_property
    def operator(self) -> csr_array:
        """Sparse B, shape (rows, n)."""
        return self._rows((self.unknown >= 0) & (self.coefficient != 0.0), self.coefficient)

    @property
    def finite_stiffness(self) -> np.ndarray:
        """Stiffness of the rows, N/m; links of fixed length have the largest finite stiffness."""
        rigid = np.isinf(self.stiffness)
        stiffest = float(np.max(self.stiffness[~rigid], initial=0.0)) or 1.0
        return np.where(rigid, stiffest, self.stiffness)

    @cached_property
    def tangent(self) -> Tangent:
        """Tangent with the pattern of the unknowns that rows couple."""
        coupled = self._rows(self.unknown >= 0, np.ones_like(self.unknown))
        upper = triu(coupled.T @ coupled, format="csr")
        upper.sort_indices()
        place = _places(self.unknown, upper.indptr, upper.indices)
        cholesky = prepare_cholesky(upper.indptr, upper.indices)
        return Tangent(upper.indptr, upper.indices, place, self.coefficient, cholesky)

    def _rows(self, entry: np.ndarray, value: np.ndarray) -> csr_array:
        """Return some entries of the rows as a sparse matrix, shape (rows, n)."""
        first = np.append(0, np.cumsum(entry.sum(axis=1)))
        shape = (len(self.unknown), self.n)
        return csr_array((value[entry], self.unknown[entry], first), shape)

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


@compiled
def _places(unknown: np.ndarray, start: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Return the position in the matrix of each product of two coefficients of a row."""
    width = unknown.shape[1]
    place = np.full((unknown.shape[0], width * (width + 1) // 2), -1, dtype=np.int32)
    for row in range(unknown.shape[0]):
        pair = -1
        for p in range(width):
            for q in range(p, width):
                pair += 1
                i, j = unknown[row, p], unknown[row, q]
                if i < 0 or j < 0:
                    continue
                if i > j:
                    i, j = j, i
                low, high = start[i], start[i + 1]
                while low < high:
                    middle = (low + high) // 2
                    if column[middle] < j:
                        low = middle + 1
                    else:
                        high = middle
                place[row, pair] = low
    return place


@compiled
def _fill(
    place: np.ndarray, coefficient: np.ndarray, stiffness: np.ndarray, size: int
) -> np.ndarray:
    """Sum k b b^T over the rows b of B."""
    entries = np.zeros(size)
    for row in range(place.shape[0]):
        pair = 0
        for p in range(coefficient.shape[1]):
            scaled = stiffness[row] * coefficient[row, p]
            for q in range(p, coefficient.shape[1]):
                if place[row, pair] >= 0:
                    entries[place[row, pair]] += scaled * coefficient[row, q]
                pair += 1
    return entries


@compiled
def _fill_geometric(
    place: np.ndarray, direction: np.ndarray, along: np.ndarray, across: np.ndarray, size: int
) -> np.ndarray:
    """Sum along n n^T + across (I - n n^T) over the links, with opposite signs at their ends."""
    entries = np.zeros(size)
    width = int(np.sqrt(2.0 * place.shape[1]))  # w (w + 1) / 2 products
    c = width // 2
    for link in range(direction.shape[0]):
        pair = -1
        for p in range(width):
            for q in range(p, width):
                pair += 1
                i, j = p % c, q % c
                if place[link, pair] < 0 or i > 2 or j > 2:
                    continue
                value = (along[link] - across[link]) * direction[link, i] * direction[link, j]
                if i == j:
                    value += across[link]
                entries[place[link, pair]] += value if p // c == q // c else -value
    return entries
