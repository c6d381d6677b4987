"""All substructures of a process: block-diagonal operators on long vectors."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import csr_array, diags_array, vstack

from multiscale.macro.substructures.problem import CutInterface, CutProblem, Links, Substructure
from multiscale.numerics.factorisation import Factorise, Solve, on_diagonal, prepare_cholesky

__all__ = ["Sides", "Stack", "lay_out_sides", "split_columns", "stack_parts"]

FULL = 0.1
"""Share of the entries of a matrix that are not zero above which it is factorised in full."""


@dataclass(frozen=True, eq=False)
class Sides:
    """Sides of all interfaces, in the order of their substructures.

    Attributes
    ----------
    place : tuple of tuple of slice, rows of every side, by interface
    start : ndarray of int, shape (substructures + 1,)
        Rows of a substructure: from ``start[E]`` to ``start[E + 1]``.
    slot : ndarray of int, shape (m,), unknown of the interface that a row is one side of
    count : ndarray of int, shape (slots,), number of sides of every such unknown
    perfect : ndarray of bool, shape (m,), whether the interface has no law
    joints : ndarray of int, shape (2, 3, points), rows of both sides of the interfaces with a law
    """

    place: tuple[tuple[slice, ...], ...]
    start: np.ndarray
    slot: np.ndarray
    count: np.ndarray
    perfect: np.ndarray
    joints: np.ndarray

    @property
    def m(self) -> int:
        """Number of rows."""
        return self.slot.size

    def mean(self, value: np.ndarray) -> np.ndarray:
        """Mean over the sides, given back to every side."""
        return np.asarray((np.bincount(self.slot, value) / self.count)[self.slot])


def lay_out_sides(problem: CutProblem) -> Sides:
    """Give every side of every interface its rows."""
    parts, interfaces = problem.substructures, problem.interfaces
    first_slot = np.cumsum([0, *(face.size for face in interfaces)])
    place: list[list[slice]] = [[slice(0)] * len(face.sides) for face in interfaces]
    slots, perfect, start, row = [], [np.zeros(0, dtype=bool)], [0], 0
    for mine in _sides_of(interfaces, len(parts)):
        for index, side in mine:
            size = interfaces[index].size
            place[index][side] = slice(row, row + size)
            slots.append(np.arange(first_slot[index], first_slot[index + 1]))
            perfect.append(np.full(size, interfaces[index].law is None))
            row += size
        start.append(row)
    joints = [
        np.stack([np.arange(side.start, side.stop).reshape(3, -1) for side in sides])
        for face, sides in zip(interfaces, place, strict=True)
        if face.law is not None
    ]
    slot = np.concatenate(slots) if slots else np.zeros(0, dtype=int)
    return Sides(
        tuple(tuple(sides) for sides in place),
        np.array(start),
        slot,
        np.bincount(slot, minlength=first_slot[-1]),
        np.concatenate(perfect),
        np.concatenate([np.zeros((2, 3, 0), dtype=int), *joints], axis=2),
    )


def _sides_of(interfaces: Sequence[CutInterface], count: int) -> list[list[tuple[int, int]]]:
    """Interface and side that every substructure has."""
    sides: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for index, face in enumerate(interfaces):
        for side, owner in enumerate(face.sides):
            if owner < count:
                sides[owner].append((index, side))
    return sides


@dataclass(frozen=True, eq=False)
class Stack:
    r"""Block-diagonal operators of some substructures.

    Attributes
    ----------
    start : ndarray of int, shape (substructures + 1,), unknowns of a substructure
    stiffness : csr_array, shape (n, n), :math:`K`
    load : ndarray, shape (n, cases)
    trace : csr_array, shape (m, n), displacement of all sides of these substructures
    links : Links, all links; without any, of no rows
    one_sided : ndarray of bool, shape (rows,), links that may go slack
    shared : ndarray of bool, shape (n,), unknowns on perfect interfaces
    """

    start: np.ndarray
    stiffness: csr_array
    load: np.ndarray
    trace: csr_array
    links: Links
    one_sided: np.ndarray
    shared: np.ndarray

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return int(self.start[-1])

    def matrix(self, link_stiffness: np.ndarray, side_stiffness: csr_array | None) -> csr_array:
        """Return K + B^T k B + T^T k_0 T, N/m."""
        B = self.links.operator
        matrix = self.stiffness + B.T @ diags_array(link_stiffness) @ B
        if side_stiffness is not None:
            matrix = matrix + self.trace.T @ side_stiffness @ self.trace
        return csr_array(matrix)


class Factors:
    """Cholesky factors of matrices of one pattern; the pattern is analysed once."""

    def __init__(self) -> None:
        self.pattern: tuple[np.ndarray, np.ndarray] | None = None
        self.factorise: Factorise | None = None

    def __call__(self, matrix: csr_array) -> Solve:
        """Factorise a positive definite matrix."""
        from scipy.sparse import triu

        if matrix.nnz > FULL * matrix.shape[0] ** 2:
            factors = lu_factor(matrix.toarray())
            return lambda rhs: np.asarray(lu_solve(factors, rhs))

        upper = csr_array(triu(matrix, format="csr"))  # with its diagonal
        upper.sort_indices()
        pattern = (upper.indptr.astype(np.int32), upper.indices.astype(np.int32))
        known = self.pattern is not None and all(
            np.array_equal(new, old) for new, old in zip(pattern, self.pattern, strict=True)
        )
        if not known or self.factorise is None:
            self.pattern, self.factorise = pattern, prepare_cholesky(*pattern)
        return self.factorise(upper.data, False)


def stack_parts(problem: CutProblem, parts: Sequence[int]) -> Stack:
    """Put substructures side by side."""
    chosen = [problem.substructures[part] for part in parts]
    none = np.zeros(0)
    links = [
        part.links or Links(csr_array((0, part.n)), none, none, none, none, np.zeros(0, int))
        for part in chosen
    ]
    joined = Links(
        on_diagonal(item.operator for item in links),
        *(
            np.concatenate([getattr(item, name) for item in links])
            for name in ("stiffness", "prestress", "lower", "upper", "number")
        ),
    )
    start = np.cumsum([0, *(part.n for part in chosen)])
    shared = np.zeros(start[-1], dtype=bool)
    for face in problem.interfaces:
        for owner, trace in zip(face.sides, face.trace, strict=True):
            if owner in parts and face.law is None:
                shared[start[owner - parts[0]] + trace.indices] = True
    return Stack(
        start,
        on_diagonal(part.stiffness for part in chosen),
        np.concatenate([part.load for part in chosen]),
        _traces(problem.interfaces, chosen, parts),
        joined,
        np.isfinite(joined.lower) | np.isfinite(joined.upper),
        shared,
    )


def split_columns(
    matrix: csr_array, start: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Columns that each block of rows uses, and its entries in them as a full matrix."""
    blocks = [matrix[first:last] for first, last in pairwise(start)]
    used = [np.unique(block.indices) for block in blocks]
    return used, [block[:, at].toarray() for block, at in zip(blocks, used, strict=True)]


def _traces(
    interfaces: Sequence[CutInterface], chosen: Sequence[Substructure], parts: Sequence[int]
) -> csr_array:
    """Traces in the order of :class:`Sides`."""
    blocks = []
    sides = _sides_of(interfaces, max(parts) + 1)
    for number, part in zip(parts, chosen, strict=True):
        mine = [interfaces[index].trace[side] for index, side in sides[number]]
        blocks.append(vstack(mine) if mine else csr_array((0, part.n)))
    return on_diagonal(blocks)
