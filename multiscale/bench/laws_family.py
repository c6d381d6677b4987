"""Fitted laws: the error of the stiffness of an interface against the time of its cells."""

from collections.abc import Iterable
from functools import partial

import numpy as np

from multiscale.bench.trials import BenchFamily, Trial, judge_by

__all__ = ["fitted_stiffness", "plan_laws"]

YOUNG, POISSON, SLOPE = 210e9, 0.3, 0.1  # Pa, 1, 1
SIZE, LONGEST, SHORTEST = 80e-6, 20e-6, 10e-6
"""Edge of the cells, longest and shortest wave, m."""
POINTS = 64
LOWEST, ASKED, HIGHEST = 0.2e9, 1e9, 4e9
"""Pressures between which cells are pressed, and where the stiffness is asked for, Pa."""
STEPS = 8

FAMILIES = ("convex_decreasing", "exponential", "power")
REALISATIONS, QUICK_REALISATIONS = (2, 4, 8, 16, 32), (2, 4)
SAMPLES = 4
"""Number of ensembles of each size, over which the error is averaged."""
TRUTH, QUICK_TRUTH = 1024, 16
"""Number of realisations of the truth; none of them is in an ensemble."""
PARTS = 8
"""Number of equal shares of these realisations, whose scatter gives the uncertainty."""

SCENE = "stiffness of a rough interface"


def plan_laws(*, quick: bool) -> BenchFamily:
    """Plan to fit laws of several families to ensembles of flat cells of growing size.

    If quick, two sizes, and fewer realisations for the truth.

    Notes
    -----
    *Errors* of the stiffness at 1 GPa are root mean squares over four ensembles, relative to the
    law of free form fitted to 1024 other realisations; two standard errors, from eighths of them,
    are the uncertainty. More realisations do not remove the misfit of a family of two parameters.
    *Times* count the cells and the fit, one after the other.
    """
    return BenchFamily(
        [
            Trial(
                SCENE,
                family.replace("_", " "),
                partial(_samples, family, count),
                partial(fitted_stiffness, "power", range(2)),
                {"realisations": count},
            )
            for family in FAMILIES
            for count in (QUICK_REALISATIONS if quick else REALISATIONS)
        ],
        judge_by(partial(_truth, QUICK_TRUTH if quick else TRUTH)),
        title="interface laws: stiffness at 1 GPa",
        packages=("scipy",),
    )


def fitted_stiffness(family: str, seeds: Iterable[int]) -> float:
    """Press cells and fit a law of a family: its stiffness at 1 GPa, Pa/m."""
    from multiscale.micro import Cell, Path, run_ensemble, self_affine
    from multiscale.upscaling import fit_law, law_from_dataset

    cells = [
        Cell(
            self_affine(
                (POINTS, POINTS),
                (SIZE, SIZE),
                int(seed),
                hurst_exponent=0.8,
                long_cutoff=LONGEST,
                short_cutoff=SHORTEST,
                rms_slope=SLOPE,
            ),
            SIZE,
            8,
            YOUNG,
            POISSON,
            geometry="flat",
        )
        for seed in seeds
    ]
    response = run_ensemble(cells, Path(pressure=tuple(np.geomspace(LOWEST, HIGHEST, STEPS))))
    law = law_from_dataset(fit_law(response, family=family, n_samples=0))
    return float(law.stiffness(law.gap_at(np.array([ASKED])))[0])


def _samples(family: str, count: int) -> np.ndarray:
    """Stiffness of several ensembles."""
    return np.array(
        [fitted_stiffness(family, range(k * count, (k + 1) * count)) for k in range(SAMPLES)]
    )


def _truth(count: int, scene: str, answers: list[float]) -> tuple[float, float]:
    """Stiffness of many realisations, and two of its relative standard errors."""
    first = SAMPLES * max(REALISATIONS)  # after the seeds of the ensembles
    shares = np.arange(first, first + count).reshape(PARTS, -1)
    parts = np.array([fitted_stiffness("convex_decreasing", share) for share in shares])
    mean = parts.mean()
    return float(mean), float(2.0 * parts.std(ddof=1) / np.sqrt(PARTS) / mean)
