"""The whole chain: error of the stiffness of a joint against the time from surface to answer."""

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from multiscale.bench.trials import BenchFamily, Trial, judge_by

__all__ = ["joint_stiffness", "plan_chain"]

CASE, PRELOAD = "ground_steel", 2
"""The shipped case, and which of its preloads is looked at."""

POINTS, QUICK_POINTS = (48, 64, 96, 128), (34, 48)
REALISATIONS, QUICK_REALISATIONS = (3, 6, 12), (3,)
MORE = 2
"""Number of other realisations of the truth over the number of the largest run."""

SCENE = "stiffness of a ground steel joint"


def joint_stiffness(points: int, realisations: int, first: int = 0) -> float:
    """Run the case on a grid, from a first realisation on: stiffness of the joint, Pa/m."""
    from multiscale.pipeline import Case, load_case, run

    case = load_case(CASE)
    assert isinstance(case, Case)  # as this shipped case is
    cell = case.cell.model_copy(update={"points": (points, points)})
    micro = case.micro.model_copy(
        update={"realisations": realisations, "seed": case.micro.seed + first}
    )
    with TemporaryDirectory() as folder:
        results = run(case.model_copy(update={"cell": cell, "micro": micro}), Path(folder))
    return float(results.macro_result["joint_stiffness"].values[PRELOAD])


def plan_chain(*, quick: bool) -> BenchFamily:
    """Plan runs of a case on several grids with several numbers of realisations.

    If quick, two coarse grids, three realisations.

    Notes
    -----
    *Errors* of the stiffness of the joint at one preload are relative to twice as many other
    realisations on the finest grid, whose distance from the best answer is the uncertainty. *Times*
    are measured in one process, from the case to its datasets.
    """
    grids = QUICK_POINTS if quick else POINTS
    counts = QUICK_REALISATIONS if quick else REALISATIONS
    return BenchFamily(
        [
            Trial(
                SCENE,
                f"{points} x {points} points",
                partial(joint_stiffness, points, count),
                partial(joint_stiffness, QUICK_POINTS[0], 3),
                {"realisations": count},
            )
            for points in grids
            for count in counts
        ],
        judge_by(partial(_truth, grids[-1], MORE * counts[-1])),
        title="whole chain: stiffness of a joint",
        packages=("scipy", "numba"),
    )


def _truth(points: int, count: int, scene: str, answers: list[float]) -> tuple[float, float]:
    """Stiffness from many other realisations, and its distance from the best answer."""
    exact = joint_stiffness(points, count, first=1000)
    return exact, abs(answers[-1] / exact - 1.0)
