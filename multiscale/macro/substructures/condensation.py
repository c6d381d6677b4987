"""Static condensation of all substructures onto the unknowns that they share."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from multiscale.numerics.cholesky import Solve

__all__ = ["Condensed", "Split", "condense", "split"]


@dataclass(frozen=True, eq=False)
class Split:
    """Unknowns of some substructures side by side, inside them and shared.

    Attributes
    ----------
    inside, edge : ndarray of int
        Unknowns that no neighbour shares, and the others; rising.
    inside_start, edge_start : ndarray of int, shape (substructures + 1,)
        Those of a substructure.
    """

    inside: np.ndarray
    edge: np.ndarray
    inside_start: np.ndarray
    edge_start: np.ndarray

    @property
    def column(self) -> np.ndarray:
        """Number of every shared unknown in its substructure."""
        return np.asarray(np.arange(self.edge.size) - self.edge_start[self.owner])

    @property
    def owner(self) -> np.ndarray:
        """Substructure of every shared unknown."""
        return np.repeat(np.arange(self.edge_start.size - 1), np.diff(self.edge_start))


def split(start: np.ndarray, shared: np.ndarray) -> Split:
    """Split the unknowns; those of a substructure are ``start[E]`` to ``start[E + 1]``."""
    inside, edge = np.flatnonzero(~shared), np.flatnonzero(shared)
    return Split(inside, edge, np.searchsorted(inside, start), np.searchsorted(edge, start))


@dataclass(frozen=True, eq=False)
class Condensed:
    r"""Schur complements :math:`S = K_{bb} - K_{bi} K_{ii}^{-1} K_{ib}`.

    Attributes
    ----------
    blocks : list of ndarray
        :math:`S` of every substructure, N/m.
    """

    split: Split
    blocks: list[np.ndarray]
    solve: Solve
    out: csr_array
    back: csr_array

    def reduce(self, force: np.ndarray) -> np.ndarray:
        """Force on the shared unknowns that a force on all amounts to, N."""
        inner = self.solve(force[self.split.inside])
        return np.asarray(force[self.split.edge] - self.out @ inner)

    def expand(self, force: np.ndarray, edge: np.ndarray) -> np.ndarray:
        """Displacement of all unknowns from that of the shared ones, m."""
        u = np.empty(force.size)
        u[self.split.edge] = edge
        u[self.split.inside] = self.solve(force[self.split.inside] - self.back @ edge)
        return u


def condense(matrix: csr_array, parts: Split, factorise: Callable[[csr_array], Solve]) -> Condensed:
    """Condense a block-diagonal matrix; all substructures are solved at once.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
        N/m; it need not be symmetric.
    parts : Split
    factorise : callable
        Gives the solve with the matrix of the inside.
    """
    rows, edge_rows = matrix[parts.inside], matrix[parts.edge]
    back, out = csr_array(rows[:, parts.edge]), csr_array(edge_rows[:, parts.inside])
    own = csr_array(edge_rows[:, parts.edge])
    solve = factorise(csr_array(rows[:, parts.inside]))
    # the columns of different substructures do not meet
    width = int(np.diff(parts.edge_start).max(initial=0))
    merged = np.zeros((parts.inside.size, width))
    entries = back.tocoo()
    merged[entries.coords[0], parts.column[entries.coords[1]]] = entries.data
    product = out @ solve(merged)
    blocks = []
    for a, b in zip(parts.edge_start[:-1], parts.edge_start[1:], strict=True):
        blocks.append(own[a:b, a:b].toarray() - product[a:b, : b - a])
    return Condensed(parts, blocks, solve, out, back)
