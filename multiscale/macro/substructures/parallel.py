"""Substructures over processes."""

from collections.abc import Callable
from importlib import import_module
from os import environ
from typing import Any, Protocol, TypeVar

import numpy as np

from multiscale.errors import CaseError, MultiscaleError

__all__ = ["Alone", "ProcessGroup", "Ranks", "share", "together", "world"]

T = TypeVar("T")

LAUNCHERS = ("PMI_SIZE", "PMI_RANK", "OMPI_COMM_WORLD_SIZE", "PMIX_RANK")
"""Variables of the environment that ``mpiexec`` sets."""


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
