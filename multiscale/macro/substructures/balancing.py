"""Balancing domain decomposition by constraints: a preconditioner for the shared unknowns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.sparse import coo_array, csr_array

from multiscale.fe.condensation import Split
from multiscale.macro.substructures.parallel import ProcessGroup, together
from multiscale.macro.substructures.problem import CutInterface
from multiscale.macro.substructures.stack import split_columns
from multiscale.numerics.factorisation import Solve

__all__ = ["Balancing", "Layout", "lay_out", "prepare_balancing"]


@dataclass(frozen=True, eq=False)
class Layout:
    """Shared and coarse unknowns of the substructures of a process, in tables of one width.

    Attributes
    ----------
    shared : ndarray of int, shape (substructures, w)
        Shared unknowns; where there are fewer than w, ``n_shared``.
    coarse : ndarray of int, shape (substructures, c), coarse unknowns, likewise
    constraint : ndarray, shape (substructures, c, w), coarse unknowns from the shared ones
    n_shared, n_coarse : int
    faces : list of (int, list of (int, ndarray))
        For every interface its size, the substructures among these that it has and, in each, the
        columns of its unknowns.
    team : ProcessGroup, processes that share the substructures
    """

    shared: np.ndarray
    coarse: np.ndarray
    constraint: np.ndarray
    n_shared: int
    n_coarse: int
    faces: list[tuple[int, list[tuple[int, np.ndarray]]]]
    team: ProcessGroup

    def gather(self, blocks: list[np.ndarray]) -> np.ndarray:
        """Matrices of the substructures in one array, shape (substructures, w, w)."""
        width = self.shared.shape[1]
        table = np.zeros((len(blocks), width, width))
        for place, block in zip(table, blocks, strict=True):
            place[: len(block), : len(block)] = block
        return table

    def take(self, value: np.ndarray) -> np.ndarray:
        """Give every substructure its shared unknowns, shape (substructures, w)."""
        return np.asarray(np.append(value, 0.0)[self.shared])

    def add(self, value: np.ndarray) -> np.ndarray:
        """Add up over the substructures of all processes, shape (shared,)."""
        force = np.bincount(self.shared.ravel(), value.ravel(), self.n_shared + 1)
        return self.team.total(force[:-1])

    def multiply(self, schur: np.ndarray, value: np.ndarray) -> np.ndarray:
        """Apply the sum of the matrices of the substructures, shape (shared,)."""
        return self.add(np.einsum("pij,pj->pi", schur, self.take(value)))


def lay_out(
    parts: Split,
    slot: np.ndarray,
    basis: csr_array,
    interfaces: Sequence[CutInterface],
    mine: range,
    team: ProcessGroup,
) -> Layout:
    """Make the tables."""
    n_shared, n_coarse = basis.shape
    count = parts.edge_start.size - 1
    shared = np.full((count, int(np.diff(parts.edge_start).max(initial=0))), n_shared)
    shared[parts.owner, parts.column] = slot
    used, motions = split_columns(csr_array(basis[slot]), parts.edge_start)
    width = max((item.size for item in used), default=0)
    coarse = np.full((count, width), n_coarse)
    constraint = np.zeros((count, width, shared.shape[1]))
    for part, (block, item) in enumerate(zip(motions, used, strict=True)):
        coarse[part, : item.size] = item
        constraint[part, : item.size, : block.shape[0]] = block.T
    order, faces, first = np.argsort(shared, axis=1), [], 0
    for face in interfaces:
        rows = np.arange(first, first + face.size)
        own_sides = [side - mine.start for side in face.sides if side in mine]
        at = [order[part][np.searchsorted(shared[part][order[part]], rows)] for part in own_sides]
        faces.append((face.size, list(zip(own_sides, at, strict=True))))
        first += face.size
    return Layout(shared, coarse, constraint, n_shared, n_coarse, faces, team)


@dataclass(frozen=True, eq=False)
class Balancing:
    r"""Preconditioner by balanced solves of the substructures.

    .. math:: M^{-1} = \sum_E R_E^T D_E (Z_E + \Phi_E L^{-1} \Psi_E^T) D_E R_E,    \tag{1}

    where, with the Schur complement :math:`S_E` and the coarse unknowns :math:`C_E`,

    .. math::
        \begin{pmatrix} S_E & C_E^T \\ C_E & 0 \end{pmatrix}^{-1} =
        \begin{pmatrix} Z_E & \Phi_E \\ \Psi_E^T & -L_E \end{pmatrix}, \qquad
        L = \sum_E L_E.    \tag{2}

    References
    ----------
    .. [1] C. R. Dohrmann, SIAM J. Sci. Comput. 25 (2003) 246-258,
       doi:10.1137/S1064827502412887.
    """

    layout: Layout
    fine: np.ndarray
    right: np.ndarray
    left: np.ndarray
    solve: Solve | None

    def __call__(self, force: np.ndarray) -> np.ndarray:
        """Approximate displacement of the shared unknowns for a force on them."""
        layout = self.layout
        shares = layout.take(force)
        u = np.einsum("pij,pj->pi", self.fine, shares)
        if self.solve is not None:
            amount = np.einsum("pij,pj->pi", self.left, shares)
            total = np.bincount(layout.coarse.ravel(), amount.ravel(), layout.n_coarse + 1)
            w = np.append(self.solve(layout.team.total(total[:-1])), 0.0)
            u += np.einsum("pij,pj->pi", self.right, w[layout.coarse])
        return layout.add(u)


def prepare_balancing(
    layout: Layout, schur: np.ndarray, added: np.ndarray, factorise: Callable[[csr_array], Solve]
) -> Balancing:
    """Invert (2) for every substructure and factorise the coarse matrix."""
    count, width = layout.shared.shape
    size = layout.coarse.shape[1]
    real, wanted = layout.shared < layout.n_shared, layout.coarse < layout.n_coarse
    diagonal = np.where(real, np.einsum("pii->pi", schur) + added, 0.0)
    unit = np.max(diagonal, axis=1, initial=0.0)
    unit[unit <= 0.0] = 1.0
    matrix = np.zeros((count, width + size, width + size))
    matrix[:, :width, :width] = schur / unit[:, None, None]
    at = np.arange(width)
    matrix[:, at, at] += np.where(real, added / unit[:, None], 1.0)
    matrix[:, width:, :width] = layout.constraint
    matrix[:, :width, width:] = layout.constraint.transpose(0, 2, 1)
    at = np.arange(width, width + size)
    matrix[:, at, at] += np.where(wanted, 0.0, 1.0)
    inverse = together(layout.team, lambda: np.linalg.inv(matrix))

    coarse = -inverse[:, width:, width:] * unit[:, None, None]
    rows = np.broadcast_to(layout.coarse[:, :, None], coarse.shape)
    columns = np.broadcast_to(layout.coarse[:, None, :], coarse.shape)
    used = wanted[:, :, None] & wanted[:, None, :]
    entries = layout.team.collect([(coarse[used], rows[used], columns[used])])
    value, row, column = (np.concatenate(item) for item in zip(*entries, strict=True))
    assembled = csr_array(coo_array((value, (row, column)), shape=(layout.n_coarse,) * 2))
    D = together(layout.team, partial(_scaling, layout, schur, added))
    return Balancing(
        layout,
        D @ (inverse[:, :width, :width] / unit[:, None, None]) @ D.transpose(0, 2, 1),
        D @ inverse[:, :width, width:],
        inverse[:, width:, :width] @ D.transpose(0, 2, 1),
        _solve_first(layout.team, assembled, factorise) if layout.n_coarse else None,
    )


def _solve_first(
    team: ProcessGroup, matrix: csr_array, factorise: Callable[[csr_array], Solve]
) -> Solve:
    """Let the first process solve for all, so that all get the same digits."""
    solve = together(team, lambda: None if team.rank else factorise(matrix))
    return lambda right: team.total(np.zeros_like(right) if solve is None else solve(right))


def _scaling(layout: Layout, schur: np.ndarray, added: np.ndarray) -> np.ndarray:
    r"""Share of every substructure in the motion of an interface :math:`F`.

    .. math:: D_E = \Big( \sum_{E'} S_{E'}^{FF} \Big)^{-1} S_E^{FF}    \tag{3}
    """
    D = np.zeros_like(schur)
    blocks, sums = [], [np.zeros(0)]
    for size, sides in layout.faces:
        of_sides = []
        for part, at in sides:
            block = schur[part][np.ix_(at, at)]
            of_sides.append(0.5 * (block + block.T) + np.diag(added[part, at]))
        blocks.append(of_sides)
        sums.append(sum(of_sides, np.zeros((size, size))).ravel())
    total, first = layout.team.total(np.concatenate(sums)), 0
    for (size, sides), of_sides in zip(layout.faces, blocks, strict=True):
        whole = total[first : first + size**2].reshape(size, size)
        first += size**2
        for (part, at), block in zip(sides, of_sides, strict=True):
            D[part][np.ix_(at, at)] = np.linalg.solve(whole, block)
    return D
