"""Jobs for worker processes on this machine or on a cluster."""

import logging
import os
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, as_completed
from contextlib import contextmanager
from math import inf
from typing import TYPE_CHECKING, Any, TypeVar

from multiscale.errors import CaseError, MultiscaleError

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

__all__ = ["call_on_one_thread", "cores", "process_pool", "run_jobs", "usable_memory", "workers"]

USABLE = 0.8  # of the memory of a machine

Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")


def run_jobs(
    function: Callable[..., Result],
    jobs: Mapping[Key, tuple[Any, ...]],
    executor: Executor | None,
    finish: Callable[[Key, Result], None],
) -> None:
    """Call a function once for each job, and process the results in the order of completion.

    Parameters
    ----------
    function : callable
        The function, importable by name if an executor is given. Workers call it with one thread
        for kernels, because they share the machine.
    jobs : mapping of key to tuple
        Arguments of each call.
    executor : Executor, optional
        Executor of ``concurrent.futures``, dask (``Client.get_executor()``) or mpi4py; serial, with
        all threads, if not given. A pool must spawn its processes
        (``multiprocessing.get_context("spawn")``): threads of kernels do not survive a fork.
    finish : callable
        ``finish(key, result)`` is called in this process after each job.

    Raises
    ------
    MultiscaleError
        If a worker process died or the workers were lost.
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
            f"or because it was forked instead of spawned; finished results are kept, so run "
            f"again with fewer jobs"
        ) from error
    except CancelledError as error:
        raise MultiscaleError(
            f"the workers were lost after {done} of {len(jobs)} jobs; finished results are kept, "
            f"so run again once the workers are back"
        ) from error
    finally:
        for future in futures:
            future.cancel()


def call_on_one_thread(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function with one thread for kernels, in a process that shares its machine."""
    import numba

    numba.set_num_threads(1)
    return function(*arguments)


@contextmanager
def workers(jobs: int, dask: str | None) -> Iterator[Executor | None]:
    """Yield the workers of a dask scheduler, a pool of processes, or None for a single job.

    Parameters
    ----------
    jobs : int
        Number of processes on this machine; 0 for one per core.
    dask : str, optional
        Address of a scheduler whose workers replace the processes.

    Raises
    ------
    CaseError
        If dask is not installed, or no scheduler answers at the address.
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


@contextmanager
def process_pool(jobs: int) -> Iterator["ProcessPoolExecutor"]:
    """Yield a pool of processes that end when this process is interrupted or killed."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import active_children, get_context

    # spawn: a forked process would inherit locks of the kernels' threads
    spawn = get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=spawn, initializer=_follow_parent) as executor:
        try:
            yield executor
        except (KeyboardInterrupt, GeneratorExit):
            for worker in active_children():  # whose jobs nobody waits for
                worker.terminate()
            raise


@contextmanager
def _dask_workers(address: str) -> Iterator[Executor]:
    """Yield the workers of a dask scheduler."""
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise CaseError("--dask needs dask; install the extra 'cluster'") from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # errors below are sentences
    try:
        client = Client(address, timeout=10)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise CaseError(f"no dask scheduler answers at {address!r}: {error}") from error
    try:
        with client, client.get_executor() as executor:  # type: ignore[no-untyped-call]
            yield executor
    except KilledWorker as error:
        raise MultiscaleError(
            "several workers of dask died of the same job, perhaps for lack of memory; finished "
            "results are kept, so run again on larger workers"
        ) from error


def cores() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def usable_memory() -> float:
    """Return the byte of this machine that a solve may take; infinite where it is not told."""
    if not hasattr(os, "sysconf"):  # Windows
        return inf
    return USABLE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent process, and end this worker when it ends, even if killed."""
    import signal
    from multiprocessing import parent_process
    from threading import Thread

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=watch, daemon=True).start()
