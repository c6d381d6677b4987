r"""Static condensation of sparse matrices, and compliance onto faces.

Several bodies may stand side by side in a block-diagonal matrix. They are factorised at once, and
their columns share right-hand sides, since the columns of different bodies do not meet.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.sparse import csc_array, csr_array

from multiscale.numerics.factorisation import Solve, factorise

__all__ = ["CondensedStiffness", "Split", "compliances", "condense", "condense_body", "split"]

COLUMNS = 64  # right-hand sides that are solved together


@dataclass(frozen=True, eq=False)
class Split:
    """Unknowns of some bodies side by side, inside them and kept, body after body.

    ``edge_start``, shape (bodies + 1,), is the first unknown of every body in ``edge``, and its
    size.
    """

    inside: np.ndarray
    edge: np.ndarray
    edge_start: np.ndarray

    @property
    def column(self) -> np.ndarray:
        """Number of every kept unknown in its body."""
        return np.asarray(np.arange(self.edge.size) - self.edge_start[self.owner])

    @property
    def owner(self) -> np.ndarray:
        """Body of every kept unknown."""
        return np.repeat(np.arange(self.edge_start.size - 1), np.diff(self.edge_start))


def split(start: np.ndarray, shared: np.ndarray) -> Split:
    """Split the unknowns; a body has the unknowns ``start[E]`` to ``start[E + 1]``."""
    inside, edge = np.flatnonzero(~shared), np.flatnonzero(shared)
    return Split(inside, edge, np.searchsorted(edge, start))


@dataclass(frozen=True, eq=False)
class CondensedStiffness:
    """Schur complements :math:`S = K_{bb} - K_{bi} K_{ii}^{-1} K_{ib}`, i inside and b kept.

    ``blocks`` are :math:`S` of every body, N/m, ``solve`` is the inverse of :math:`K_{ii}` of all,
    and ``out`` and ``back`` are :math:`K_{bi}` and :math:`K_{ib}`, N/m.
    """

    split: Split
    blocks: list[np.ndarray]
    solve: Solve
    out: csr_array
    back: csr_array

    def reduce(self, force: np.ndarray) -> np.ndarray:
        """Force on the kept unknowns that a force on all amounts to, N."""
        inner = self.solve(force[self.split.inside])
        return np.asarray(force[self.split.edge] - self.out @ inner)

    def expand(self, force: np.ndarray, edge: np.ndarray) -> np.ndarray:
        """Displacement of all unknowns from the displacement of the kept ones, m."""
        u = np.empty(force.size)
        u[self.split.edge] = edge
        u[self.split.inside] = self.solve(force[self.split.inside] - self.back @ edge)
        return u


def condense(
    matrix: csr_array, parts: Split, factorise: Callable[[csr_array], Solve]
) -> CondensedStiffness:
    """Condense a block-diagonal matrix."""
    rows, edge_rows = matrix[parts.inside], matrix[parts.edge]
    back, out = csr_array(rows[:, parts.edge]), csr_array(edge_rows[:, parts.inside])
    kept = csr_array(edge_rows[:, parts.edge])
    solve = factorise(csr_array(rows[:, parts.inside]))
    inner = _inverse_between(solve, out, back, parts.edge_start)
    bounds = pairwise(parts.edge_start)
    blocks = [kept[a:b, a:b].toarray() - block for (a, b), block in zip(bounds, inner, strict=True)]
    return CondensedStiffness(parts, blocks, solve, out, back)


def condense_body(
    stiffness: csr_array, kept: np.ndarray, *, name: str = "the stiffness of the body"
) -> CondensedStiffness:
    """Condense the symmetric stiffness of one body onto some unknowns.

    Examples
    --------
    >>> springs = csr_array([[2.0, -1.0, -1.0], [-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
    >>> condense_body(springs, np.array([1, 2])).blocks[0]
    array([[ 0.5, -0.5],
           [-0.5,  0.5]])
    """
    inside = np.setdiff1d(np.arange(stiffness.shape[0]), kept)
    parts = Split(inside, kept, np.array([0, kept.size]))
    condensed = condense(csr_array(stiffness), parts, partial(factorise, name=name))
    return replace(condensed, blocks=[_symmetric(block) for block in condensed.blocks])


def compliances(
    solve: Solve, faces: csr_array, start: np.ndarray | None = None
) -> list[np.ndarray]:
    r"""Compute the compliance :math:`F_E K_E^{-1} F_E^T` of every body, exactly symmetric."""
    start = np.array([0, faces.shape[0]]) if start is None else start
    return [_symmetric(block) for block in _inverse_between(solve, faces, faces.T, start)]


def _inverse_between(
    solve: Solve, rows: csr_array, columns: csr_array, start: np.ndarray
) -> list[np.ndarray]:
    """Compute ``rows @ inverse @ columns`` of every body, some right-hand sides at a time."""
    sizes = np.diff(start)
    width = int(sizes.max(initial=0))
    entries = columns.tocoo()
    place = (np.arange(start[-1]) - np.repeat(start[:-1], sizes))[entries.coords[1]]
    shape = (columns.shape[0], width)
    merged = csc_array((entries.data, (entries.coords[0], place)), shape=shape)
    product = np.empty((rows.shape[0], width))
    for first in range(0, width, COLUMNS):
        part = slice(first, first + COLUMNS)
        product[:, part] = rows @ solve(merged[:, part].toarray())
    return [product[a:b, : b - a] for a, b in pairwise(start)]


def _symmetric(block: np.ndarray) -> np.ndarray:
    """Symmetric part."""
    return np.asarray(0.5 * (block + block.T))
