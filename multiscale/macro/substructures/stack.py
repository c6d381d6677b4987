"""Processes, and all substructures of a process: block-diagonal operators on long vectors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from os import environ
from typing import Any, Protocol, TypeVar

import numpy as np
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import csr_array, diags_array, vstack

from multiscale.errors import CaseError, MultiscaleError
from multiscale.macro.monolithic import FULL
from multiscale.macro.substructures.problem import CutInterface, CutProblem, Links, Substructure
from multiscale.numerics.factorisation import Factorise, Solve, on_diagonal, prepare_cholesky

__all__ = [
    "Alone",
    "Factors",
    "ProcessGroup",
    "Ranks",
    "Sides",
    "Stack",
    "lay_out_sides",
    "share",
    "split_columns",
    "stack_parts",
    "together",
    "world",
]

T = TypeVar("T")

LAUNCHERS = ("PMI_SIZE", "PMI_RANK", "OMPI_COMM_WORLD_SIZE", "PMIX_RANK")
"""Variables of the environment that ``mpiexec`` sets."""


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


class ProcessGroup(Protocol):
    """Group of processes. Each owns some substructures; every process has all interfaces."""

    size: int
    rank: int

    def concatenate(self, value: np.ndarray) -> np.ndarray:
        """Join the parts of all processes, in their order, on every process."""
        ...

    def collect(self, items: list[Any]) -> list[Any]:
        """Join the lists of all processes, in their order, on every process."""
        ...

    def total(self, value: np.ndarray) -> np.ndarray:
        """Add up over the processes, on every process."""
        ...


class Alone:
    """One process."""

    size, rank = 1, 0

    def concatenate(self, value: np.ndarray) -> np.ndarray:
        """Return the value."""
        return value

    def collect(self, items: list[Any]) -> list[Any]:
        """Return the list."""
        return items

    def total(self, value: np.ndarray) -> np.ndarray:
        """Return the value."""
        return value


class Ranks:
    """Processes of an MPI communicator."""

    def __init__(self, communicator: Any) -> None:
        self.communicator = communicator
        self.size, self.rank = communicator.Get_size(), communicator.Get_rank()

    def concatenate(self, value: np.ndarray) -> np.ndarray:
        """Gather arrays of different lengths."""
        value = np.ascontiguousarray(value, dtype=float)
        counts = self.communicator.allgather(value.size)
        out = np.empty(sum(counts))
        self.communicator.Allgatherv(value, (out, counts))
        return out

    def collect(self, items: list[Any]) -> list[Any]:
        """Gather lists of anything."""
        return [item for part in self.communicator.allgather(items) for item in part]

    def total(self, value: np.ndarray) -> np.ndarray:
        """Sum in the order of the ranks, so that every process gets the same digits."""
        value = np.ascontiguousarray(value, dtype=float)
        out = np.empty((self.size, *value.shape))
        self.communicator.Allgather(value, out)
        return np.asarray(out.sum(axis=0))


def world() -> ProcessGroup:
    """Return the processes that ``mpiexec`` has started, or this one alone.

    Without ``mpiexec`` nothing of MPI is loaded.

    Raises
    ------
    CaseError
        If it was started by ``mpiexec`` and mpi4py is missing.
    """
    if not any(name in environ for name in LAUNCHERS):
        return Alone()
    try:
        communicator = import_module("mpi4py.MPI").COMM_WORLD
    except ImportError as error:
        raise CaseError(
            "started by mpiexec, but mpi4py is not installed; pip install 'multiscale-contact[mpi]'"
        ) from error
    return Ranks(communicator)


def share(count: int, team: ProcessGroup) -> range:
    """Substructures of this process: consecutive, as equal in number as possible."""
    if count < team.size:
        raise CaseError(
            f"{team.size} processes cannot share {count} substructures; start fewer, or cut finer"
        )
    bounds = np.linspace(0, count, team.size + 1).round().astype(int)
    return range(bounds[team.rank], bounds[team.rank + 1])


def together(team: ProcessGroup, task: Callable[[], T]) -> T:
    """Run a task that may fail; if it fails on one process, raise on all, so that none waits."""
    error: Exception | None = None
    try:
        result = task()
    except (MultiscaleError, np.linalg.LinAlgError) as caught:
        error = caught
    if team.total(np.array([float(error is not None)]))[0]:
        raise error or MultiscaleError("a step of the solver failed in another process")
    return result
