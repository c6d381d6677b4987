r"""Tangent stiffness :math:`B^T k B` with a pattern and ordering that are computed once."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.link_system import LinkSystem
from multiscale.numerics.cholesky import Factorise, prepare_cholesky
from multiscale.numerics.compiled import compiled
from multiscale.numerics.factorisation import Solve

__all__ = ["Tangent", "place_rows", "prepare_tangent"]


@dataclass(frozen=True, eq=False)
class Tangent:
    """Symmetric matrices of one pattern, given by the entries of their upper triangle.

    Attributes
    ----------
    start, column : ndarray of int
        Pattern by rows: first entry of each row, shape (n + 1,), and increasing columns.
    place : ndarray of int, shape (rows, w (w + 1) / 2)
        Entry to which each product of two coefficients of a row of B is added, -1 if fixed.
    coefficient : ndarray, shape (rows, w), entries of B
    cholesky : callable, factorisation as returned by :func:`prepare_cholesky`
    """

    start: np.ndarray
    column: np.ndarray
    place: np.ndarray
    coefficient: np.ndarray
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
        strict = entries.copy()
        strict[self.diagonal] = 0.0
        lower = csr_array((strict, self.column, self.start), shape=(n, n)).T
        return csr_array(upper + lower)

    def factorise(self, entries: np.ndarray, *, signs: bool = False) -> Solve:
        """Return the function that solves with a matrix."""
        return self.cholesky(entries, signs)


def prepare_tangent(system: LinkSystem, model: LinkEquations) -> Tangent:
    """Return the tangent with its pattern and the entries to which every link is added."""
    first, second = system.ends.T
    nodes = np.arange(system.n_nodes)
    low, high = np.minimum(first, second), np.maximum(first, second)
    pairs = (np.append(low, nodes), np.append(high, nodes))
    size = (system.n_nodes, system.n_nodes)
    graph = csr_array(coo_array((np.ones(pairs[0].size, dtype=np.int8), pairs), shape=size))
    graph.sort_indices()
    start, column = _pattern(graph.indptr, graph.indices, model.number, model.n)
    return place_rows(model, start, column)


def place_rows(model: LinkEquations, start: np.ndarray, column: np.ndarray) -> Tangent:
    """Return the tangent of a known pattern, the upper triangle by rows."""
    place = _places(model.unknown, start, column)
    return Tangent(start, column, place, model.coefficient, prepare_cholesky(start, column))


@compiled
def _pattern(
    graph_start: np.ndarray, neighbour: np.ndarray, number: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pattern of the upper triangle of the unknowns from the graph of the nodes."""
    c = number.shape[1]
    start = np.zeros(n + 1, dtype=np.int32)
    for passes in range(2):
        if passes:
            for row in range(n):
                start[row + 1] += start[row]
            column = np.empty(start[n], dtype=np.int32)
        filled = 0
        for node in range(number.shape[0]):
            for p in range(c):
                if number[node, p] < 0:
                    continue
                for other in range(graph_start[node], graph_start[node + 1]):
                    b = neighbour[other]
                    for q in range(p if b == node else 0, c):
                        if number[b, q] >= 0:
                            if passes:
                                column[filled] = number[b, q]
                                filled += 1
                            else:
                                start[number[node, p] + 1] += 1
    return start, column


@compiled
def _places(unknown: np.ndarray, start: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Return the entry to which every product of two coefficients of a row is added."""
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
