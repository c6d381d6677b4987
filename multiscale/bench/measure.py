"""Tasks measured in separate processes: answer, time, memory, and the dataset of all."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from math import nan
from multiprocessing import get_context
from pathlib import Path
from statistics import median_low
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np

from multiscale import __version__
from multiscale.executors import thread_count
from multiscale.executors import threads as kernel_threads
from multiscale.schema import WORK_PRECISION, Dataset

THREADS = 2  # number of threads that a measured code may use by default

Row = dict[str, Any]
"""Variables of ``WORK_PRECISION`` in a row of the table; ``value``, the answer, which is not
stored; and ``history``, seconds and errors, shape (samples, 2)."""


class Measurement(NamedTuple):
    """Answer of the run of median time, with times, s, and memory of its process, byte."""

    value: Any  # None if a process died, for instance for lack of memory
    wall_time: float = nan
    cpu_time: float = nan
    peak_memory: float = nan


def measure(
    task: Callable[[], Any],
    warm_up: Callable[[], object],
    *,
    repeats: int = 1,
    threads: int = THREADS,
    process: bool = True,
) -> Measurement:
    """Run a picklable task several times after a warm-up, for imports and compilation, untimed."""
    runs = list[Measurement]()
    for _ in range(repeats):
        if not process:
            runs.append(_run(task, warm_up, threads)._replace(peak_memory=nan))
            continue
        # spawn: a forked process would start with the memory of this process
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
            try:
                runs.append(executor.submit(_run, task, warm_up, threads).result())
            except BrokenProcessPool:
                return Measurement(None)
    middle = median_low(run.wall_time for run in runs)
    return next(run for run in runs if run.wall_time == middle)


def _run(task: Callable[[], Any], warm_up: Callable[[], object], threads: int) -> Measurement:
    from threadpoolctl import threadpool_limits

    warm_up()
    with threadpool_limits(threads), ExitStack() as stack:
        if "numba" in sys.modules:  # else not imported, as it would add to the measured memory
            stack.enter_context(kernel_threads(min(threads, thread_count())))
        begin, cpu = perf_counter(), process_time()
        value = task()
        times = perf_counter() - begin, process_time() - cpu
    return Measurement(value, *times, peak_memory())


def peak_memory() -> float:
    """Return the largest resident memory of this process so far, byte."""
    from multiscale.io import read_text

    status = Path("/proc/self/status")
    if status.exists():  # Linux, where getrusage also counts the memory of the parent
        line = next(line for line in read_text(status).splitlines() if line.startswith("VmHWM"))
        return 1024.0 * float(line.split()[1])
    try:
        import resource
    except ImportError:  # Windows
        return nan
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


@dataclass(frozen=True, eq=False)
class BenchFamily:
    """A family of scenes; ``scenes`` goes from a :class:`Runner` and ``quick`` to judged rows."""

    title: str
    scenes: "Callable[[Runner, bool], Iterator[Sequence[Row]]]"
    packages: tuple[str, ...] = ()  # with recorded versions, where they are installed
    threads: int = THREADS  # number that a run may use
    process: bool = True  # whether runs have separate processes; else memory is not measured
    error: str = ""  # long name of ``error``, if it differs from ``WORK_PRECISION``
    attributes: Mapping[str, str | float] = field(default_factory=dict)  # of the dataset


@dataclass(eq=False)
class Runner:
    """Measures the answers of a family; ``report`` gets a line after each."""

    family: BenchFamily
    report: Callable[[str], None]
    repeats: int = 1
    load: float = field(default_factory=lambda: os.getloadavg()[0])
    cautions: list[str] = field(default_factory=list)

    def __call__(
        self,
        scene: str,
        method: str,
        task: Callable[..., Any],
        *arguments: object,
        warm: tuple[object, ...] = (),
        repeats: int = 1,
        **settings: float,
    ) -> Row:
        """Measure a task with arguments, after the same task with ``warm`` arguments."""
        self.repeats = max(self.repeats, repeats)
        run = measure(
            partial(task, *arguments),
            partial(task, *warm),
            repeats=repeats,
            threads=self.family.threads,
            process=self.family.process,
        )
        accuracy = "".join(f", {name} {value:g}" for name, value in settings.items())
        self.report(f"{scene}, {method}{accuracy}: a run of {run.wall_time:.3g} s")
        row = {"scene": scene, "method": method, "error": nan, "converged": 0, **settings}
        row |= run._asdict()
        if not self.family.process:
            del row["peak_memory"]
        return row

    def leave_out(self, method: str, reason: str) -> None:
        """Record why a method is not measured."""
        if (caution := f"{method} is left out {reason}") not in self.cautions:
            self.cautions.append(caution)

    def dataset(self, rows: Sequence[Row]) -> Dataset:
        """Arrange rows; a row that lacks a variable of others is NaN there."""
        histories = [row.get("history", np.zeros((0, 2))) for row in rows]
        names = dict.fromkeys(name for row in rows for name in row)
        variables = {
            name: np.array([row.get(name, nan) for row in rows])
            for name in names
            if name not in ("value", "history")
        }
        if sum(map(len, histories)):
            variables["history_run"] = np.repeat(np.arange(len(rows)), [*map(len, histories)])
            variables["history_seconds"], variables["history_error"] = np.concatenate(histories).T
        attributes: dict[str, str | float] = {
            "title": self.family.title,
            "versions": versions(*self.family.packages),
            "threads": self.family.threads,
            "cores": os.cpu_count() or 1,
            "load_before": self.load,
            "load_after": os.getloadavg()[0],  # running and queued processes, mean of a minute
            "repeats": self.repeats,
            "wall_time_counts": f"{'median' if self.repeats > 1 else 'one run'}; without start of "
            f"the process, imports and compilation",
            "cautions": "\n".join(self.cautions),
        }
        dataset = WORK_PRECISION.build(variables, **(attributes | dict(self.family.attributes)))
        if self.family.error:
            dataset["error"].attrs["long_name"] = self.family.error
        return dataset


def measure_family(
    family: BenchFamily,
    *,
    quick: bool,
    report: Callable[[str], None] = lambda line: None,
    keep: Callable[[Dataset], object] = lambda dataset: None,
) -> Dataset:
    """Measure and judge the answers to all scenes; arguments as of :func:`~.bench`."""
    runner, rows = Runner(family, report), list[Row]()
    for scene in family.scenes(runner, quick):
        rows += scene
        keep(runner.dataset(rows))  # a run that is killed leaves its finished scenes
    return runner.dataset(rows)


def versions(*packages: str) -> str:
    """List the versions of this package and of the installed other packages."""
    others = dict.fromkeys(name for name in packages if name != "multiscale" and find_spec(name))
    return ", ".join([f"multiscale {__version__}", *(f"{name} {version(name)}" for name in others)])


def judge(rows: Sequence[Row], exact: float, uncertainty: float = nan) -> Sequence[Row]:
    """Judge numbers, or samples of a number by their root mean square error, by the truth."""
    for row in rows:
        samples = np.atleast_1d(nan if row["value"] is None else row["value"])
        row["error"] = float(np.sqrt(np.mean((samples / exact - 1.0) ** 2)))
        row["error_uncertainty"] = uncertainty
        row["converged"] = int(np.isfinite(samples).all())
        for time in ("wall_time", "cpu_time"):
            row[time] /= samples.size
    return rows


def extrapolate(values: np.ndarray, order: float | None = None) -> float:
    """Extrapolate a result from its last three grids, each twice as fine as the grid before.

    >>> extrapolate(1.0 + 0.25 ** np.arange(3.0))
    1.0
    """
    first, second, third = (float(value) for value in values[-3:])
    before, last = second - first, third - second
    if last == 0.0:
        return third
    if order is None:
        order = 2.0
        if before / last > 0.0:
            order = float(np.clip(np.log2(before / last), 1.0, 2.0))
    return float(third + last / (2.0**order - 1.0))


def limit_of(rows: Sequence[Row]) -> tuple[float, float]:
    """Extrapolate answers, from coarse to fine; return the limit and the distance of the last."""
    answers = np.array([row["value"] for row in rows], dtype=float)
    limit = extrapolate(answers)
    return limit, abs(answers[-1] / limit - 1.0)
