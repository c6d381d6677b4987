"""Jobs for worker processes, of this machine or of others."""

from collections.abc import Callable, Hashable, Mapping
from concurrent.futures import Executor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from multiscale.errors import MultiscaleError

__all__ = ["run_jobs"]

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
        with all threads, if not given.
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
    futures = {executor.submit(_call, function, *job): key for key, job in jobs.items()}
    done = 0
    try:
        for future in as_completed(futures):
            finish(futures[future], future.result())
            done += 1
    except BrokenProcessPool as error:
        raise MultiscaleError(
            f"a worker process died after {done} of {len(jobs)} jobs, perhaps for lack of memory; "
            f"what is finished is kept, so run again with fewer jobs"
        ) from error
    finally:
        for future in futures:
            future.cancel()


def _call(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function on one thread."""
    import numba

    numba.set_num_threads(1)
    return function(*arguments)
