"""Jobs for worker processes, of this machine or of others."""

import logging
import os
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, as_completed
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from multiscale.errors import CaseError, MultiscaleError

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

__all__ = ["call_on_one_thread", "cores", "process_pool", "run_jobs", "workers"]

Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")


def run_jobs(
    function: Callable[..., Result],
    jobs: Mapping[Key, tuple[Any, ...]],
    executor: Executor | None,
    finish: Callable[[Key, Result], None],
) -> None:
    """Call a function once for each job, and take its results as they come.

    Parameters
    ----------
    function : callable
        Importable by name, if there is an executor. Workers call it with one thread for kernels:
        they share the machine.
    jobs : mapping of key to tuple
        Arguments.
    executor : Executor, optional
        Any of ``concurrent.futures``, of dask (``Client.get_executor()``) or of mpi4py; serial,
        with all threads, if not given. A pool of processes must spawn them
        (``multiprocessing.get_context("spawn")``): threads of kernels do not survive a fork.
    finish : callable
        Gets key and result of each job, in this process.

    Raises
    ------
    MultiscaleError
        If a worker process died.
    """
    if executor is None:
        for key, arguments in jobs.items():
            finish(key, function(*arguments))
        return
    futures = {
        executor.submit(call_on_one_thread, function, *job): key for key, job in jobs.items()
    }
    done = 0
    try:
        for future in as_completed(futures):
            finish(futures[future], future.result())
            done += 1
    except BrokenExecutor as error:
        raise MultiscaleError(
            f"a worker process died after {done} of {len(jobs)} jobs, perhaps for lack of memory, "
            f"or forked where it should be spawned; what is finished is kept, so run again with "
            f"fewer jobs"
        ) from error
    except CancelledError as error:
        raise MultiscaleError(
            f"the workers were lost after {done} of {len(jobs)} jobs; what is finished is kept, so "
            f"run again once they are back"
        ) from error
    finally:
        for future in futures:
            future.cancel()


def call_on_one_thread(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function with one thread for kernels: its process shares the machine with others."""
    import numba

    numba.set_num_threads(1)
    return function(*arguments)


@contextmanager
def workers(jobs: int, dask: str | None) -> Iterator[Executor | None]:
    """Give the workers of a dask scheduler, a pool of processes, or nothing for a single job.

    Parameters
    ----------
    jobs : int
        Processes of this machine; 0 takes one for each core.
    dask : str, optional
        Address of a scheduler, whose workers are taken instead.

    Raises
    ------
    CaseError
        If dask is not installed, or no scheduler answers.
    """
    if dask is not None:
        with _dask_workers(dask) as executor:
            yield executor
        return
    jobs = jobs or cores()
    if jobs == 1:
        yield None
        return
    with process_pool(jobs) as executor:
        yield executor


def process_pool(jobs: int) -> "ProcessPoolExecutor":
    """Return a pool of processes that end when this one is killed."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    # spawn: a forked process would inherit locks of the kernels' threads
    return ProcessPoolExecutor(
        jobs, mp_context=get_context("spawn"), initializer=_leave_with_parent
    )


@contextmanager
def _dask_workers(address: str) -> Iterator[Executor]:
    """Give the workers of a dask scheduler."""
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise CaseError("--dask needs dask; install the extra 'cluster'") from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # sentences tell enough
    try:
        client = Client(address, timeout=10)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise CaseError(f"no dask scheduler answers at {address!r}: {error}") from error
    try:
        with client, client.get_executor() as executor:  # type: ignore[no-untyped-call]
            yield executor
    except KilledWorker as error:
        raise MultiscaleError(
            "several workers of dask died of the same job, perhaps for lack of memory; what is "
            "finished is kept, so run again on larger workers"
        ) from error


def cores() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _leave_with_parent() -> None:
    """Let a worker end when the run is killed: nobody else would tell it."""
    from multiprocessing import parent_process
    from threading import Thread

    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=watch, daemon=True).start()
