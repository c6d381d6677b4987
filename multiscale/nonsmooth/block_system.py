r"""Linear systems with the block pattern of a friction problem.

The systems of Newton and interior-point methods may be singular up to round-off on purpose, where
the impulses are not unique, so they are factorised here without the check of
:func:`multiscale.numerics.factorisation.factorise`; the methods look at what comes out.
"""

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.numerics.compiled import compiled
from multiscale.numerics.factorisation import Solve

__all__ = ["factorise_blocks"]

SMALL = 100
"""Unknowns up to which a matrix is treated as full."""

DENSE = 0.25
"""Share of blocks from which on a matrix is treated as full."""

PIVOT = 0.01
"""Diagonal pivot that is good enough, relative to its column: others cost fill-in."""


def factorise_blocks(
    problem: ScaledFriction, added: np.ndarray, left: np.ndarray | None = None
) -> Solve | None:
    r"""Factorise :math:`A W + B` with block-diagonal :math:`A` and :math:`B`."""
    contacts = problem.friction.size
    n = 3 * contacts
    shape = (contacts, 3)
    blocks = problem.blocks
    if left is not None:
        blocks = _times_left(blocks, problem.starts, left)
    system = (problem.columns, problem.starts, problem.diagonal, blocks, added)
    if n <= SMALL or problem.columns.size > DENSE * contacts**2:
        full = np.zeros((n, n))
        _fill_full(*system, full)
        factors, pivots, info = dgetrf(full.T, overwrite_a=True)
        if info != 0:
            return None
        return lambda b: np.asarray(dgetrs(factors, pivots, b.ravel(), trans=1)[0]).reshape(shape)

    values, indices, pointers = _scalar_rows(*system)
    try:  # compressed rows of A W + B are compressed columns of its transpose
        sparse = splu(
            csc_matrix((values, indices, pointers), shape=(n, n)),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=PIVOT,
        )
    except RuntimeError:
        return None
    return lambda b: np.asarray(sparse.solve(b.ravel(), "T")).reshape(shape)


@compiled
def _times_left(blocks, starts, left):  # type: ignore[no-untyped-def]
    """Multiply the block rows of W by A."""
    out = np.empty_like(blocks)
    for i in range(starts.size - 1):
        for k in range(starts[i], starts[i + 1]):
            for a in range(3):
                for b in range(3):
                    out[k, a, b] = (
                        left[i, a, 0] * blocks[k, 0, b]
                        + left[i, a, 1] * blocks[k, 1, b]
                        + left[i, a, 2] * blocks[k, 2, b]
                    )
    return out


@compiled
def _fill_full(columns, starts, diagonal, blocks, added, full):  # type: ignore[no-untyped-def]
    """Write the blocks, with ``added`` on the diagonal, into a full matrix."""
    for i in range(starts.size - 1):
        for k in range(starts[i], starts[i + 1]):
            j = columns[k]
            for a in range(3):
                for b in range(3):
                    full[3 * i + a, 3 * j + b] = blocks[k, a, b]
                    if k == diagonal[i]:
                        full[3 * i + a, 3 * j + b] += added[i, a, b]


@compiled
def _scalar_rows(columns, starts, diagonal, blocks, added):  # type: ignore[no-untyped-def]
    """Compressed rows of the blocks with ``added`` on the diagonal."""
    contacts = starts.size - 1
    values = np.empty(9 * starts[-1])
    indices = np.empty(9 * starts[-1], np.int32)
    pointers = np.zeros(3 * contacts + 1, np.int32)
    place = 0
    for i in range(contacts):
        for a in range(3):
            for k in range(starts[i], starts[i + 1]):
                for b in range(3):
                    indices[place] = 3 * columns[k] + b
                    values[place] = blocks[k, a, b]
                    if k == diagonal[i]:
                        values[place] += added[i, a, b]
                    place += 1
            pointers[3 * i + a + 1] = place
    return values, indices, pointers
