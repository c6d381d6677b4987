"""Groups of processes, and block-diagonal operators of the substructures of a process."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from os import environ
from typing import Any, Protocol, TypeVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array, diags_array, triu, vstack

from multiscale.errors import CaseError, MultiscaleError
from multiscale.macro.monolithic import FULL
from multiscale.macro.substructures.problem import CutProblem, Links, join_links
from multiscale.numerics.factorisation import (
    NOT_DEFINITE,
    Factorise,
    Solve,
    on_diagonal,
    prepare_cholesky,
)

T = TypeVar("T")

LENT = 1e-12
"""Stiffness lent to every unknown, relative to its diagonal, for mechanisms inside."""

LAUNCHERS = ("PMI_SIZE", "PMI_RANK", "OMPI_COMM_WORLD_SIZE", "PMIX_RANK")
"""Variables of the environment that ``mpiexec`` sets."""


class ProcessGroup(Protocol):
    """Group of processes. Each has some substructures; every process has all interfaces."""

    size: int
    rank: int

    def concatenate(self, value: np.ndarray) -> np.ndarray:
        """Join the arrays of all processes, in their order, on every process."""
        ...

    def collect(self, items: list[Any]) -> list[Any]:
        """Join the lists of all processes, in their order, on every process."""
        ...

    def total(self, value: np.ndarray) -> np.ndarray:
        """Add up over the processes, on every process."""
        ...


class Alone:
    """A single process."""

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


ALONE = Alone()


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
        return [item for gathered in self.communicator.allgather(items) for item in gathered]

    def total(self, value: np.ndarray) -> np.ndarray:
        """Sum in the order of the ranks, so that every process gets the same digits."""
        value = np.ascontiguousarray(value, dtype=float)
        out = np.empty((self.size, *value.shape))
        self.communicator.Allgather(value, out)
        return np.asarray(out.sum(axis=0))


@dataclass(frozen=True, eq=False)
class Sides:
    """Sides of all interfaces, in the order of their substructures, in m rows."""

    place: tuple[tuple[slice, ...], ...]  # rows of every side, by interface
    start: np.ndarray  # first row of every substructure, and m, (substructures + 1,)
    slot: np.ndarray  # interface unknown of every row, (m,)
    count: np.ndarray  # number of sides of every interface unknown, (slots,)
    perfect: np.ndarray  # of bool, whether the interface has no law, (m,)
    joints: np.ndarray  # rows of both sides of the interfaces with a law, (2, 3, points)

    @property
    def m(self) -> int:
        """Number of rows."""
        return self.slot.size

    def mean(self, value: np.ndarray) -> np.ndarray:
        """Mean over the sides, on every side."""
        return np.asarray((np.bincount(self.slot, value) / self.count)[self.slot])


def lay_out_sides(problem: CutProblem) -> Sides:
    """Lay out the rows of every side of every interface."""
    interfaces = problem.interfaces
    first_slot = np.cumsum([0, *(face.size for face in interfaces)])
    place: list[list[slice]] = [[slice(0)] * len(face.sides) for face in interfaces]
    slots, perfect, start, row = [], [np.zeros(0, dtype=bool)], [0], 0
    for sides in problem.sides:
        for index, side in sides:
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


@dataclass(frozen=True, eq=False)
class Stack:
    """Block-diagonal operators of the substructures of a process."""

    problem: CutProblem
    team: ProcessGroup
    local: range  # numbers of these substructures
    sides: Sides  # of all substructures
    start: np.ndarray  # first unknown of every substructure, and n, (substructures + 1,)
    stiffness: csr_array  # K, (n, n), N/m
    load: np.ndarray  # (n, cases), N
    trace: csr_array  # displacement of all sides of these substructures, (m, n)
    links: Links  # of all substructures; empty without links
    one_sided: np.ndarray  # of bool, links that may go slack, (rows,)
    shared: np.ndarray  # of bool, unknowns on perfect interfaces, (n,)

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return int(self.start[-1])

    @property
    def rows(self) -> slice:
        """Rows of these substructures among the rows of all sides."""
        return slice(self.sides.start[self.local.start], self.sides.start[self.local.stop])

    def matrix(self, link_stiffness: np.ndarray, side_stiffness: csr_array | None) -> csr_array:
        """Return K + B^T k B + T^T k_0 T, N/m."""
        B = self.links.operator
        matrix = self.stiffness + B.T @ diags_array(link_stiffness) @ B
        if side_stiffness is not None:
            matrix = matrix + self.trace.T @ side_stiffness @ self.trace
        return csr_array(matrix)


class Factors:
    """Cholesky factors of matrices of the same pattern; the pattern is analysed once."""

    def __init__(self) -> None:
        self.pattern: tuple[np.ndarray, np.ndarray] | None = None
        self.factorise: Factorise | None = None

    def __call__(self, matrix: csr_array | np.ndarray) -> Solve:
        """Factorise a positive definite matrix."""
        if isinstance(matrix, csr_array) and matrix.nnz > FULL * matrix.shape[0] ** 2:
            matrix = matrix.toarray()
        if isinstance(matrix, np.ndarray):
            try:
                factors = cho_factor(matrix)
            except np.linalg.LinAlgError as error:
                raise MultiscaleError(NOT_DEFINITE) from error
            return lambda rhs: np.asarray(cho_solve(factors, rhs))

        upper = csr_array(triu(matrix, format="csr"))  # with its diagonal
        upper.sort_indices()
        pattern = (upper.indptr.astype(np.int32), upper.indices.astype(np.int32))
        known = self.pattern is not None and all(
            np.array_equal(new, old) for new, old in zip(pattern, self.pattern, strict=True)
        )
        if not known or self.factorise is None:
            self.pattern, self.factorise = pattern, prepare_cholesky(*pattern)
        return self.factorise(upper.data, False)


def stack_substructures(problem: CutProblem, team: ProcessGroup = ALONE) -> Stack:
    """Stack the substructures of this process."""
    local = share(len(problem.substructures), team)
    chosen = [problem.substructures[number] for number in local]
    sides, links = lay_out_sides(problem), join_links(chosen)
    traces = [
        vstack([csr_array((0, each.n)), *(problem.interfaces[i].trace[side] for i, side in faces)])
        for each, faces in zip(chosen, problem.sides[local.start : local.stop], strict=True)
    ]
    start, trace = np.cumsum([0, *(each.n for each in chosen)]), on_diagonal(traces)
    perfect = sides.perfect[sides.start[local.start] : sides.start[local.stop]]
    shared = np.zeros(start[-1], dtype=bool)
    shared[trace[perfect].indices] = True
    return Stack(
        problem,
        team,
        local,
        sides,
        start,
        on_diagonal(each.stiffness for each in chosen),
        np.concatenate([each.load for each in chosen]),
        trace,
        links,
        np.isfinite(links.lower) | np.isfinite(links.upper),
        shared,
    )


def split_columns(
    matrix: csr_array, start: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Columns with entries in each block of rows, and the block on them as a dense matrix."""
    blocks = [matrix[first:last] for first, last in pairwise(start)]
    used = [np.unique(block.indices) for block in blocks]
    return used, [block[:, at].toarray() for block, at in zip(blocks, used, strict=True)]


def world() -> ProcessGroup:
    """Return the processes that ``mpiexec`` has started, or a single process.

    Raises
    ------
    CaseError
        If ``mpiexec`` has started the process and mpi4py is missing.
    """
    if not any(name in environ for name in LAUNCHERS):
        return ALONE
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
            f"{team.size} processes cannot share {count} substructures; start fewer processes, or "
            f"cut finer"
        )
    bounds = np.linspace(0, count, team.size + 1).round().astype(int)
    return range(bounds[team.rank], bounds[team.rank + 1])


def together(team: ProcessGroup, task: Callable[[], T]) -> T:
    """Run a task; if it fails on a process, raise on all processes, which avoids a deadlock."""
    error: Exception | None = None
    try:
        result = task()
    except (MultiscaleError, np.linalg.LinAlgError) as caught:
        error = caught
    if team.total(np.array([float(error is not None)]))[0]:
        raise error or MultiscaleError("a step of the solver failed in another process")
    return result
