"""Balancing domain decomposition by constraints: a preconditioner for the shared unknowns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from multiscale.macro.discrete.cholesky import Solve
from multiscale.macro.substructures.condensation import Split
from multiscale.macro.substructures.problem import Interface

__all__ = ["Balancing", "Layout", "lay_out", "prepare_balancing"]


@dataclass(frozen=True, eq=False)
class Layout:
    """Shared unknowns and coarse unknowns of every substructure, in tables of one width.

    Attributes
    ----------
    shared : ndarray of int, shape (substructures, w)
        Shared unknowns; where there are fewer than w, ``n_shared``.
    coarse : ndarray of int, shape (substructures, c)
        Coarse unknowns, likewise.
    constraint : ndarray, shape (substructures, c, w)
        Coarse unknowns from the shared ones.
    n_shared, n_coarse : int
    faces : list of list of (int, ndarray)
        For every interface its substructures and, in each, the columns of its unknowns.
    """

    shared: np.ndarray
    coarse: np.ndarray
    constraint: np.ndarray
    n_shared: int
    n_coarse: int
    faces: list[list[tuple[int, np.ndarray]]]

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
        """Add up over the substructures, shape (shared,)."""
        return np.bincount(self.shared.ravel(), value.ravel(), self.n_shared + 1)[:-1]

    def multiply(self, schur: np.ndarray, value: np.ndarray) -> np.ndarray:
        """Apply the sum of the matrices of the substructures, shape (shared,)."""
        return self.add(np.einsum("pij,pj->pi", schur, self.take(value)))


def lay_out(
    parts: Split, slot: np.ndarray, basis: csr_array, interfaces: Sequence[Interface]
) -> Layout:
    """Make the tables.

    Parameters
    ----------
    parts : Split
    slot : ndarray of int, shape (edge,)
        Row of ``basis`` that every shared unknown of a substructure is.
    basis : csr_array, shape (shared, coarse)
        Motions whose amount all substructures have in common.
    interfaces : sequence of Interface
        Perfect ones, whose unknowns are the rows of ``basis`` one after the other.
    """
    n_shared, n_coarse = basis.shape
    count = parts.edge_start.size - 1
    shared = np.full((count, int(np.diff(parts.edge_start).max(initial=0))), n_shared)
    shared[parts.owner, parts.column] = slot
    own = [
        basis[slot[a:b]] for a, b in zip(parts.edge_start[:-1], parts.edge_start[1:], strict=True)
    ]
    used = [np.unique(block.indices) for block in own]
    width = max((item.size for item in used), default=0)
    coarse = np.full((count, width), n_coarse)
    constraint = np.zeros((count, width, shared.shape[1]))
    for part, (block, item) in enumerate(zip(own, used, strict=True)):
        coarse[part, : item.size] = item
        constraint[part, : item.size, : block.shape[0]] = block[:, item].toarray().T
    order, faces, first = np.argsort(shared, axis=1), [], 0
    for face in interfaces:
        rows = np.arange(first, first + face.size)
        at = [order[part][np.searchsorted(shared[part][order[part]], rows)] for part in face.sides]
        faces.append(list(zip(face.sides, at, strict=True)))
        first += face.size
    return Layout(shared, coarse, constraint, n_shared, n_coarse, faces)


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
        own = layout.take(force)
        u = np.einsum("pij,pj->pi", self.fine, own)
        if self.solve is not None:
            amount = np.einsum("pij,pj->pi", self.left, own)
            total = np.bincount(layout.coarse.ravel(), amount.ravel(), layout.n_coarse + 1)
            w = np.append(self.solve(total[:-1]), 0.0)
            u += np.einsum("pij,pj->pi", self.right, w[layout.coarse])
        return layout.add(u)


def prepare_balancing(
    layout: Layout,
    schur: np.ndarray,
    added: np.ndarray,
    factorise: Callable[[csr_array], Solve],
) -> Balancing:
    """Invert (2) for every substructure and factorise the coarse matrix.

    Parameters
    ----------
    layout : Layout
    schur : ndarray, shape (substructures, w, w)
        N/m; not necessarily symmetric.
    added : ndarray, shape (substructures, w)
        Stiffness added to its diagonal, N/m, so that no mechanism is left.
    factorise : callable
        Gives the solve with the coarse matrix.
    """
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
    inverse = np.linalg.inv(matrix)

    coarse = -inverse[:, width:, width:] * unit[:, None, None]
    rows = np.broadcast_to(layout.coarse[:, :, None], coarse.shape)
    columns = np.broadcast_to(layout.coarse[:, None, :], coarse.shape)
    kept = wanted[:, :, None] & wanted[:, None, :]
    assembled = coo_array((coarse[kept], (rows[kept], columns[kept])), shape=(layout.n_coarse,) * 2)
    D = _scaling(layout, schur, added)
    return Balancing(
        layout,
        D @ (inverse[:, :width, :width] / unit[:, None, None]) @ D.transpose(0, 2, 1),
        D @ inverse[:, :width, width:],
        inverse[:, width:, :width] @ D.transpose(0, 2, 1),
        factorise(csr_array(assembled)) if layout.n_coarse else None,
    )


def _scaling(layout: Layout, schur: np.ndarray, added: np.ndarray) -> np.ndarray:
    r"""Share of every substructure in the motion of an interface :math:`F`.

    .. math:: D_E = \Big( \sum_{E'} S_{E'}^{FF} \Big)^{-1} S_E^{FF}    \tag{3}
    """
    D = np.zeros_like(schur)
    for face in layout.faces:
        blocks = []
        for part, at in face:
            block = schur[part][np.ix_(at, at)]
            blocks.append(0.5 * (block + block.T) + np.diag(added[part, at]))
        shares = np.linalg.solve(sum(blocks), np.concatenate(blocks, axis=1))
        for (part, at), share in zip(face, np.split(shares, len(face), axis=1), strict=True):
            D[part][np.ix_(at, at)] = share
    return D
