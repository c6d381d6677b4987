"""Trials: the same question answered ever more accurately, each answer with its time."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from itertools import groupby
from typing import Any

import numpy as np

from multiscale import __version__
from multiscale.bench.measure import THREADS, Measurement, measure
from multiscale.schema import WORK_PRECISION, Dataset

__all__ = [
    "BenchFamily",
    "Columns",
    "Judge",
    "Runs",
    "Trial",
    "judge_by",
    "measure_family",
    "versions",
]


@dataclass(frozen=True, eq=False)
class Trial:
    """One answer to a question.

    Parameters
    ----------
    scene : str, the question
    method : str, how it is answered
    task : callable
        Returns the answer. Runs in a process of its own.
    warm_up : callable, takes imports and compilation in that process, untimed
    settings : mapping of str to float
        Settings of the accuracy: variables of ``WORK_PRECISION``, such as ``points``.
    repeats : int, number of runs, whose median time counts
    follows : Trial, optional
        Earlier trial, whose answer the task gets, or None if its process died.
    left_out : str
        Why the method is not measured, such as "because it is not installed"; empty if it is.
    """

    scene: str
    method: str
    task: Callable[..., Any]
    warm_up: Callable[[], object]
    settings: Mapping[str, float] = field(default_factory=dict)
    repeats: int = 1
    follows: "Trial | None" = None
    left_out: str = ""


Runs = Mapping[Trial, Measurement[Any]]
"""Measurements of the trials, in their order."""

Columns = dict[str, Any]
"""Variables of ``WORK_PRECISION`` in one row of the table."""

Judge = Callable[[str, Runs], Iterable[tuple[Trial, Columns]]]
"""From a scene and its runs to the rows of each trial, with ``error``, ``converged`` and more."""


@dataclass(frozen=True, eq=False)
class BenchFamily:
    """Questions of one kind, with everything that it takes to measure and judge the answers.

    Parameters
    ----------
    trials : iterable of Trial, scene by scene, each from coarse to fine
    judge : callable, says how good the answers to a scene are; see :func:`judge_by` for numbers
    title : str, question of the family
    packages : tuple of str, packages whose versions are recorded where they are installed
    threads : int, number of threads that a run may use
    process : bool, whether each run has a process of its own; otherwise memory is not measured
    error : str, long name of ``error``, if it differs from the name in ``WORK_PRECISION``
    attributes : mapping of str to (str or float), further attributes of the dataset
    """

    trials: Iterable[Trial]
    judge: Judge
    title: str
    packages: tuple[str, ...] = ()
    threads: int = THREADS
    process: bool = True
    error: str = ""
    attributes: Mapping[str, str | float] = field(default_factory=dict)


def measure_family(
    family: BenchFamily,
    report: Callable[[str], None],
    keep: Callable[[Dataset], object] = lambda found: None,
) -> Dataset:
    """Measure answers to questions, and judge them.

    Parameters
    ----------
    family : BenchFamily
    report : callable, gets a line after each measurement
    keep : callable
        Gets the dataset of all scenes so far after each scene, so that a killed run leaves it.

    Returns
    -------
    Dataset
        Follows ``WORK_PRECISION``. A row that lacks a variable of other rows is NaN there, and a
        trial without a row of the judge has one without an error. Histories are joined from
        ``history`` of the judge, shape (samples, 2), seconds and errors. The attribute ``cautions``
        has a sentence for each method that is left out.
    """
    load = os.getloadavg()[0]
    cautions, runs, rows = dict[str, None](), dict[Trial, Measurement[Any]](), list[Columns]()
    for scene, trials in groupby(family.trials, key=lambda trial: trial.scene):
        mine: dict[Trial, Measurement[Any]] = {}
        for trial in trials:
            if trial.left_out:
                cautions[f"{trial.method} is left out {trial.left_out}"] = None
                continue
            known = () if trial.follows is None else (runs[trial.follows].value,)
            runs[trial] = mine[trial] = measure(
                partial(trial.task, *known),
                warm_up=trial.warm_up,
                repeats=trial.repeats,
                threads=family.threads,
                process=family.process,
            )
            settings = "".join(f", {name} {value:g}" for name, value in trial.settings.items())
            report(f"{scene}, {trial.method}{settings}: a run of {runs[trial].wall_time:.3g} s")
        if mine:
            rows += _judged(family, scene, mine)
            keep(_arranged(family, rows, runs, cautions, load))
    return _arranged(family, rows, runs, cautions, load)


def _judged(family: BenchFamily, scene: str, runs: Runs) -> Iterator[Columns]:
    """Yield the rows of a scene."""
    judged: dict[Trial, list[Columns]] = {trial: [] for trial in runs}
    for trial, columns in family.judge(scene, runs):
        judged[trial].append(columns)
    for trial, run in runs.items():
        row = {"scene": scene, "method": trial.method, "wall_time": run.wall_time}
        row |= {"peak_memory": run.peak_memory} if family.process else {}
        row |= {"error": np.nan, "converged": 0, **trial.settings}
        yield from (row | columns for columns in judged[trial] or [{}])


def _arranged(
    family: BenchFamily, rows: list[Columns], runs: Runs, cautions: Iterable[str], load: float
) -> Dataset:
    """Arrange rows of runs; ``load`` is the load of the machine before."""
    histories = [row.get("history", np.zeros((0, 2))) for row in rows]
    names = dict.fromkeys(name for row in rows for name in row if name != "history")
    variables = {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}
    if sum(map(len, histories)):
        variables["history_run"] = np.repeat(np.arange(len(rows)), [*map(len, histories)])
        variables["history_seconds"], variables["history_error"] = np.concatenate(histories).T
    repeats = max(trial.repeats for trial in runs)
    found = WORK_PRECISION.build(
        variables,
        **{
            "title": family.title,
            "versions": versions(*family.packages),
            "threads": family.threads,
            "cores": os.cpu_count() or 1,
            "load_before": load,
            "load_after": os.getloadavg()[0],  # processes that run or wait, mean of a minute
            "repeats": repeats,
            "wall_time_counts": f"{'median' if repeats > 1 else 'one run'}; without start of the "
            f"process, imports and compilation",
            "cautions": "\n".join(cautions),
            **family.attributes,
        },
    )
    if family.error:
        found["error"].attrs["long_name"] = family.error
    return found


def versions(*packages: str) -> str:
    """Name the versions of this package and of the other packages that are installed."""
    others = dict.fromkeys(name for name in packages if name != "multiscale" and find_spec(name))
    return ", ".join([f"multiscale {__version__}", *(f"{name} {version(name)}" for name in others)])


def judge_by(truth: Callable[[str, list[float]], tuple[float, float]], *, count: str = "") -> Judge:
    """Judge answers that are numbers, or samples of a number, by the truth."""

    def judge(scene: str, runs: Runs) -> Iterable[tuple[Trial, Columns]]:
        found = [
            np.atleast_1d((np.nan, np.nan) if run.value is None else run.value)
            for run in runs.values()
        ]
        answers = [one[:1] if count else one for one in found]
        exact, uncertainty = truth(scene, [float(one.mean()) for one in answers])
        for (trial, run), whole, samples in zip(runs.items(), found, answers, strict=True):
            columns = {
                "error": float(np.sqrt(np.mean((samples / exact - 1.0) ** 2))),
                "error_uncertainty": uncertainty,
                "wall_time": run.wall_time / samples.size,
                "converged": int(np.isfinite(samples).all()),
            }
            yield trial, columns | ({count: float(whole[1])} if count else {})

    return judge
