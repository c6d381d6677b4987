"""Ladders of fidelities: the same question answered ever better, each time at its price."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from multiscale.bench.measure import Measured, measure
from multiscale.bench.record import load_average, record, versions

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Rung", "measure_ladders"]


Answer = float | np.ndarray | tuple[float, float]
"""A number, samples of it, or a number with a count of the work."""


@dataclass(frozen=True, eq=False)
class Rung:
    """One answer to a question.

    Parameters
    ----------
    scene : str
        The question.
    method : str
        How it is answered.
    task : callable
        Returns the answer: one number, or samples of it. Runs in a process of its own.
    count : str
        Variable of ``WORK_PRECISION`` that the task returns after its answer, if any.
    settings : mapping of str to float
        How well it is answered: variables of ``WORK_PRECISION``, such as ``points``.
    """

    scene: str
    method: str
    task: Callable[[], Answer]
    settings: Mapping[str, float] = field(default_factory=dict)
    count: str = ""


def measure_ladders(
    rungs: Iterable[Rung],
    truth: Callable[[str, list[float]], tuple[float, float]],
    *,
    title: str,
    warm_up: Callable[[], object],
    packages: tuple[str, ...] = (),
    repeats: int = 1,
    report: Callable[[str], None] = lambda line: None,
) -> "xr.Dataset":
    """Measure ladders, and compare their answers with the truth.

    Parameters
    ----------
    rungs : iterable of Rung
        Those of a scene from coarse to fine; all with settings of the same names.
    truth : callable
        Gets a scene and the mean answers of its rungs; returns the true answer, and how far that
        may be off, relative to it.
    title : str
        What is asked.
    warm_up : callable
        Takes imports and compilation in every process, untimed.
    packages : tuple of str
        Whose versions matter.
    repeats : int
        Number of runs of each, whose median time counts.
    report : callable
        Gets a line after each measurement.

    Returns
    -------
    Dataset
        Follows ``WORK_PRECISION``. The error of samples is the root of their mean square error,
        and their time that of one. NaN if the process died or did not converge.
    """
    load = load_average()
    runs: dict[Rung, Measured[Answer]] = {}
    for rung in rungs:
        runs[rung] = measure(rung.task, warm_up=warm_up, repeats=repeats)
        settings = ", ".join(f"{name} {value:g}" for name, value in rung.settings.items())
        report(f"{rung.scene}, {rung.method}, {settings}: {runs[rung].wall_time:.3g} s")
    answers, counts = dict[Rung, np.ndarray](), dict[Rung, dict[str, float]]()
    for rung, run in runs.items():
        found = np.atleast_1d((np.nan, np.nan) if run.value is None else run.value)
        answers[rung] = found[:1] if rung.count else found
        counts[rung] = {rung.count: float(found[1])} if rung.count else {}
    truths = {
        scene: truth(scene, [float(a.mean()) for rung, a in answers.items() if rung.scene == scene])
        for scene in dict.fromkeys(rung.scene for rung in runs)
    }
    return record(
        [
            _row(rung, runs[rung], answers[rung], *truths[rung.scene]) | counts[rung]
            for rung in runs
        ],
        title=title,
        versions=versions(*packages),
        load_before=load,
        repeats=repeats,
        wall_time_counts=(
            f"{'median' if repeats > 1 else 'one run'}; without start of the process, imports and "
            f"compilation"
        ),
    )


def _row(
    rung: Rung,
    run: Measured[Answer],
    samples: np.ndarray,
    exact: float,
    uncertainty: float,
) -> dict[str, float | str]:
    """Cost and error of one rung."""
    return {
        "scene": rung.scene,
        "method": rung.method,
        **rung.settings,
        "error": float(np.sqrt(np.mean((samples / exact - 1.0) ** 2))),
        "error_uncertainty": uncertainty,
        "wall_time": run.wall_time / samples.size,
        "peak_memory": run.peak_memory,
        "converged": int(np.isfinite(samples).all()),
    }
