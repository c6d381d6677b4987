"""Trials: the same question answered ever better, each time at its price."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.bench.measure import THREADS, Measurement, measure
from multiscale.bench.record import load_average, record, versions

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Columns", "Judge", "Report", "Runs", "Trial", "judge_by", "measure_trials"]

Report = Callable[[str], None]
"""Gets a line after each measurement."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One answer to a question.

    Parameters
    ----------
    scene : str
        The question.
    method : str
        How it is answered.
    task : callable
        Returns the answer. Runs in a process of its own.
    warm_up : callable
        Takes imports and compilation in that process, untimed.
    settings : mapping of str to float
        How well it is answered: variables of ``WORK_PRECISION``, such as ``points``.
    repeats : int
        Number of runs, whose median time counts.
    follows : Trial, optional
        An earlier one, whose answer, or None if its process died, the task gets.
    """

    scene: str
    method: str
    task: Callable[..., Any]
    warm_up: Callable[[], object]
    settings: Mapping[str, float] = field(default_factory=dict)
    repeats: int = 1
    follows: "Trial | None" = None


Runs = Mapping[Trial, Measurement[Any]]
"""What the trials returned and took, in their order."""

Columns = dict[str, Any]
"""Variables of ``WORK_PRECISION`` of one trial."""

Judge = Callable[[str, Runs], Iterable[Columns]]
"""From a scene and its runs to ``error``, ``converged`` and more of each of them."""


def measure_trials(
    trials: Iterable[Trial],
    judge: Judge,
    *,
    title: str,
    packages: tuple[str, ...] = (),
    threads: int = THREADS,
    report: Report = lambda line: None,
    process: bool = True,
    **attributes: Any,
) -> "xr.Dataset":
    """Measure answers to questions, and judge them.

    Parameters
    ----------
    trials : iterable of Trial
        Trials, of each scene from coarse to fine; all settings have the same names.
    judge : callable
        Says how good the answers to a scene are; see :func:`judge_by` for numbers.
    title : str
        Question of the family.
    packages : tuple of str
        Packages whose versions are recorded.
    threads : int
        That a run may use.
    report : callable
        Gets a line after each measurement.
    process : bool
        Whether each run has a process of its own; otherwise memory is not measured.
    **attributes
        Of :func:`multiscale.bench.record.record`.

    Returns
    -------
    Dataset
        Follows ``WORK_PRECISION``; its histories are joined from ``history`` of the judge, shape
        (samples, 2), seconds and errors.
    """
    load = load_average()
    runs: dict[Trial, Measurement[Any]] = {}
    for trial in trials:
        known = () if trial.follows is None else (runs[trial.follows].value,)
        runs[trial] = measure(
            partial(trial.task, *known),
            warm_up=trial.warm_up,
            repeats=trial.repeats,
            threads=threads,
            process=process,
        )
        settings = "".join(f", {name} {value:g}" for name, value in trial.settings.items())
        report(f"{trial.scene}, {trial.method}{settings}: {runs[trial].wall_time:.3g} s")
    judged: dict[Trial, Columns] = {}
    for scene in dict.fromkeys(trial.scene for trial in runs):
        mine = {trial: run for trial, run in runs.items() if trial.scene == scene}
        judged |= zip(mine, judge(scene, mine), strict=True)
    histories = [judged[trial].pop("history", np.zeros((0, 2))) for trial in runs]
    samples = np.concatenate(histories)
    found = {
        "history_run": np.repeat(np.arange(len(runs)), [len(one) for one in histories]),
        "history_seconds": samples[:, 0],
        "history_error": samples[:, 1],
    }
    repeats = max(trial.repeats for trial in runs)
    rows: list[Columns] = [
        {"scene": trial.scene, "method": trial.method, "wall_time": run.wall_time}
        | ({"peak_memory": run.peak_memory} if process else {})
        | {**trial.settings, **judged[trial]}
        for trial, run in runs.items()
    ]
    return record(
        rows,
        found if len(samples) else {},
        threads=threads,
        load_before=load,
        **{
            "title": title,
            "versions": versions(*packages),
            "repeats": repeats,
            "wall_time_counts": f"{'median' if repeats > 1 else 'one run'}; without start of the "
            f"process, imports and compilation",
            **attributes,
        },
    )


def judge_by(truth: Callable[[str, list[float]], tuple[float, float]], *, count: str = "") -> Judge:
    """Judge answers that are numbers, or samples of a number, by the truth.

    Parameters
    ----------
    truth : callable
        Gets a scene and the mean answers of its trials; returns the true answer, and how far that
        may be off, relative to it.
    count : str
        Variable of ``WORK_PRECISION`` that a task returns after its number, if any.

    Returns
    -------
    callable
        Error: root mean square over the samples; time: mean over them.
        NaN if the process died or did not converge.
    """

    def judge(scene: str, runs: Runs) -> Iterable[Columns]:
        found = [
            np.atleast_1d((np.nan, np.nan) if run.value is None else run.value)
            for run in runs.values()
        ]
        answers = [one[:1] if count else one for one in found]
        exact, uncertainty = truth(scene, [float(one.mean()) for one in answers])
        for run, whole, samples in zip(runs.values(), found, answers, strict=True):
            yield {
                "error": float(np.sqrt(np.mean((samples / exact - 1.0) ** 2))),
                "error_uncertainty": uncertainty,
                "wall_time": run.wall_time / samples.size,
                "converged": int(np.isfinite(samples).all()),
            } | ({count: float(whole[1])} if count else {})

    return judge
