"""Time and memory of a task in processes of its own."""

import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass
from math import nan
from multiprocessing import get_context
from pathlib import Path
from statistics import median, median_low
from time import perf_counter
from typing import Generic, TypeVar

from multiscale.executors import thread_count
from multiscale.executors import threads as kernel_threads

__all__ = ["THREADS", "Measurement", "measure", "peak_memory"]

THREADS = 2
"""Number of threads that a measured code may use by default."""

T = TypeVar("T")


@dataclass(frozen=True)
class Measurement(Generic[T]):
    """Answer of a task, with its time and memory.

    Attributes
    ----------
    value : object or None
        Answer of the run of median time; ``None`` if a process died, for instance for lack of
        memory.
    wall_time : float, median over the runs, s; ``nan`` if a process died
    peak_memory : float or None
        Median of the largest resident memory of the whole process, with its interpreter and
        libraries, byte; ``nan`` if a process died, ``None`` without processes of its own.
    """

    value: T | None
    wall_time: float
    peak_memory: float | None


def measure(
    task: Callable[[], T],
    *,
    warm_up: Callable[[], object],
    repeats: int = 3,
    threads: int = THREADS,
    process: bool = True,
) -> Measurement[T]:
    """Run a task several times; arguments as of :class:`~.trials.Trial` and its family.

    For a process, the task and its result must be picklable.
    """
    runs: list[tuple[T, float, float]] = []
    for _ in range(repeats):
        if not process:
            runs.append(_run(task, warm_up, threads))
            continue
        # spawn: a forked process would start with the memory of this one
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
            try:
                runs.append(executor.submit(_run, task, warm_up, threads).result())
            except BrokenProcessPool:
                return Measurement(None, float("nan"), float("nan"))
    time = median_low(run[1] for run in runs)
    value = next(value for value, seconds, _ in runs if seconds == time)
    return Measurement(value, time, median(run[2] for run in runs) if process else None)


def _run(
    task: Callable[[], T], warm_up: Callable[[], object], threads: int
) -> tuple[T, float, float]:
    """Warm up, then run the task: its value, time and peak memory."""
    from threadpoolctl import threadpool_limits

    warm_up()
    with threadpool_limits(threads), ExitStack() as stack:
        if "numba" in sys.modules:  # not imported for codes without it, whose memory is measured
            stack.enter_context(kernel_threads(min(threads, thread_count())))
        begin = perf_counter()
        value = task()
        elapsed = perf_counter() - begin
    return value, elapsed, peak_memory()


def peak_memory() -> float:
    """Largest resident memory of this process so far, byte."""
    from multiscale.io import read_text

    status = Path("/proc/self/status")
    if status.exists():  # Linux, where getrusage also counts what the parent had
        line = next(line for line in read_text(status).splitlines() if line.startswith("VmHWM"))
        return 1024.0 * float(line.split()[1])
    try:
        import resource
    except ImportError:  # Windows
        return nan
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
