"""The whole chain: error of an interface's stiffness against the time from surface to answer."""

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from multiscale.bench.trials import BenchFamily, Trial, judge_by

__all__ = ["measure_interface", "plan_chain"]

CASE, PRELOAD = "ground_steel", 2
"""The shipped case, and which of its preloads is looked at."""

POINTS, QUICK_POINTS = (48, 64, 96, 128), (34, 48)
REALISATIONS, QUICK_REALISATIONS = (3, 6, 12), (3,)
MORE = 4
"""Number of other realisations of the truth over the number of the largest run."""
SAMPLES, APART = 4, 1000
"""Number of runs of each kind, over which the error is averaged; distance of their seeds, more than
any of them takes, with the flat cells beside."""

SCENE = "stiffness of an interface of ground steel"


def measure_interface(points: int, realisations: int, sample: int = 0) -> tuple[float, float]:
    """Run a sample of the case: stiffness of the interface and half of its 95 % interval, Pa/m."""
    from multiscale.pipeline import Case, load_case, run

    case = load_case(CASE)
    assert isinstance(case, Case)  # as this shipped case is
    cell = case.cell.model_copy(update={"points": (points, points)})
    seed = case.micro.seed + APART * sample
    # the ladder measures the error of the grid itself, without cells on half of the points
    changes = {"realisations": realisations, "seed": seed, "coarser": 0}
    micro = case.micro.model_copy(update=changes)
    with TemporaryDirectory() as folder:
        results = run(case.model_copy(update={"cell": cell, "micro": micro}), Path(folder))
    at = results.macro_result.isel(step=PRELOAD)
    low, high = at["interface_stiffness_mean_law"].values
    return float(at["interface_stiffness"]), 0.5 * float(high - low)


def plan_chain(*, quick: bool) -> BenchFamily:
    """Plan runs of a case on several grids with several numbers of realisations.

    If quick, two coarse grids, three realisations.

    Notes
    -----
    *Errors* of the stiffness of the interface at one preload, which the bodies beside it would hide
    in the stiffness of the joint, are root mean squares over four runs, relative to four times as
    many other realisations on the finest grid, whose stated 95 % interval is the uncertainty.
    *Times* are measured in one process, from the case to its datasets.
    """
    grids = QUICK_POINTS if quick else POINTS
    counts = QUICK_REALISATIONS if quick else REALISATIONS
    return BenchFamily(
        [
            Trial(
                SCENE,
                f"{points} x {points} points",
                partial(_samples, points, count),
                partial(measure_interface, QUICK_POINTS[0], 3),
                {"realisations": count},
            )
            for points in grids
            for count in counts
        ],
        judge_by(partial(_truth, grids[-1], MORE * counts[-1])),
        title="whole chain: stiffness of an interface",
        packages=("scipy", "numba"),
    )


def _samples(points: int, realisations: int) -> np.ndarray:
    """Stiffness of several runs, Pa/m."""
    return np.array([measure_interface(points, realisations, k)[0] for k in range(SAMPLES)])


def _truth(points: int, count: int, scene: str, answers: list[float]) -> tuple[float, float]:
    """Stiffness from many other realisations, and half of its interval over it."""
    exact, half = measure_interface(points, count, SAMPLES)
    return exact, half / exact
