r"""Static condensation of sparse matrices, and compliance onto faces.

A block-diagonal matrix may contain several bodies. They are factorised at once, and their columns
share right-hand sides, since the columns of different bodies are independent.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.sparse import csc_array, csr_array, issparse

from multiscale.numerics.factorisation import Solve, factorise

COLUMNS = 64  # right-hand sides that are solved together


@dataclass(frozen=True, eq=False)
class Split:
    """Eliminated and retained unknowns of the bodies of a block-diagonal matrix."""

    inside: np.ndarray  # eliminated unknowns, body after body
    edge: np.ndarray  # retained unknowns, body after body
    edge_start: np.ndarray  # (bodies + 1,), first place of every body in edge, and its size

    @property
    def column(self) -> np.ndarray:
        """Number of every retained unknown in its body."""
        return np.asarray(np.arange(self.edge.size) - self.edge_start[self.owner])

    @property
    def owner(self) -> np.ndarray:
        """Body of every retained unknown."""
        return np.repeat(np.arange(self.edge_start.size - 1), np.diff(self.edge_start))


def split(start: np.ndarray, shared: np.ndarray) -> Split:
    """Split the unknowns; a body has the unknowns ``start[E]`` to ``start[E + 1]``."""
    inside, edge = np.flatnonzero(~shared), np.flatnonzero(shared)
    return Split(inside, edge, np.searchsorted(edge, start))


@dataclass(frozen=True, eq=False)
class CondensedStiffness:
    """Schur complements :math:`S = K_{bb} - K_{bi} K_{ii}^{-1} K_{ib}`, i inside, b retained."""

    split: Split
    blocks: list[np.ndarray]  # S of every body, N/m
    solve: Solve  # applies the inverse of K_ii of all bodies
    out: csr_array | np.ndarray  # K_bi, N/m
    back: csr_array | np.ndarray  # K_ib, N/m

    def reduce(self, force: np.ndarray) -> np.ndarray:
        """Force on the retained unknowns that is equivalent to a force on all unknowns, N."""
        inner = self.solve(force[self.split.inside])
        return np.asarray(force[self.split.edge] - self.out @ inner)

    def expand(self, force: np.ndarray, edge: np.ndarray) -> np.ndarray:
        """Displacement of all unknowns from the displacement of the retained unknowns, m."""
        u = np.empty(force.size)
        u[self.split.edge] = edge
        u[self.split.inside] = self.solve(force[self.split.inside] - self.back @ edge)
        return u


def condense(
    matrix: csr_array | np.ndarray, unknowns: Split, factorise: Callable[..., Solve]
) -> CondensedStiffness:
    """Condense a block-diagonal matrix; the dense matrix of a single body stays dense."""
    rows, edge_rows = matrix[unknowns.inside], matrix[unknowns.edge]
    back, out = rows[:, unknowns.edge], edge_rows[:, unknowns.inside]
    retained = edge_rows[:, unknowns.edge]
    solve = factorise(rows[:, unknowns.inside])
    if not issparse(matrix):
        return CondensedStiffness(unknowns, [retained - out @ solve(back)], solve, out, back)
    inner = _inverse_between(solve, out, back, unknowns.edge_start)
    bounds = pairwise(unknowns.edge_start)
    blocks = [
        retained[a:b, a:b].toarray() - block for (a, b), block in zip(bounds, inner, strict=True)
    ]
    return CondensedStiffness(unknowns, blocks, solve, out, back)


def condense_body(
    stiffness: csr_array, retained: np.ndarray, *, name: str = "the stiffness of the body"
) -> CondensedStiffness:
    """Condense the symmetric stiffness of a body onto the retained unknowns.

    Examples
    --------
    >>> springs = csr_array([[2.0, -1.0, -1.0], [-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
    >>> condense_body(springs, np.array([1, 2])).blocks[0]
    array([[ 0.5, -0.5],
           [-0.5,  0.5]])
    """
    inside = np.setdiff1d(np.arange(stiffness.shape[0]), retained)
    unknowns = Split(inside, retained, np.array([0, retained.size]))
    condensed = condense(csr_array(stiffness), unknowns, partial(factorise, name=name))
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
    """Compute ``rows @ inverse @ columns`` of every body, in batches of right-hand sides."""
    sizes = np.diff(start)
    width = int(sizes.max(initial=0))
    entries = columns.tocoo()
    place = (np.arange(start[-1]) - np.repeat(start[:-1], sizes))[entries.coords[1]]
    shape = (columns.shape[0], width)
    merged = csc_array((entries.data, (entries.coords[0], place)), shape=shape)
    product = np.empty((rows.shape[0], width))
    for first in range(0, width, COLUMNS):
        batch = slice(first, first + COLUMNS)
        product[:, batch] = rows @ solve(merged[:, batch].toarray())
    return [product[a:b, : b - a] for a, b in pairwise(start)]


def _symmetric(block: np.ndarray) -> np.ndarray:
    """Symmetric part."""
    return np.asarray(0.5 * (block + block.T))
