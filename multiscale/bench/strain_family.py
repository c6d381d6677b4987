"""Cells at large strain: the error of the mean gap against run time, grid by grid."""

from functools import partial

import numpy as np

from multiscale.bench.limits import limit_of
from multiscale.bench.trials import BenchFamily, Trial, judge_by
from multiscale.laws.bulk import J2, NeoHookean

__all__ = ["STRAIN_SCENES", "gap_over_wave", "plan_strain"]

YOUNG, POISSON = 1e9, 0.3  # Pa, 1
AMPLITUDE = 0.04
"""Amplitude of the waves over their length, for slopes up to a quarter."""

STRAIN_SCENES = {
    "rubber waves": (NeoHookean(YOUNG, POISSON), 0.06),
    "plastic waves": (J2(YOUNG, POISSON, 0.005 * YOUNG, 0.01 * YOUNG), 0.006),
}
"""Law of the body, and mean pressure over Young's modulus."""

POINTS, QUICK_POINTS = (8, 16, 32, 64), (8, 12, 16)
WARM = 8


def gap_over_wave(scene: str, points: int) -> float:
    """Press waves on a grid of so many points along an edge: mean gap over wavelength."""
    from multiscale.micro import Cell, Path, Surface, solve_cell

    law, pressure = STRAIN_SCENES[scene]
    wave = np.cos(2.0 * np.pi * np.arange(points) / points)
    surface = Surface(AMPLITUDE * wave[:, None] * wave, (1.0, 1.0))
    layers = max(4, points // 2)
    cell = Cell(surface, 0.5, layers, YOUNG, POISSON, bulk=law)
    response = solve_cell(cell, Path(pressure=(pressure * YOUNG,)))
    if not response["converged"].values.all():
        return np.nan
    return float(response["mean_gap"].values.ravel()[-1])


def plan_strain(*, quick: bool) -> BenchFamily:
    """Plan to press waves of rubber and of plastic steel on grids of all sizes.

    If quick, three coarse grids.

    Notes
    -----
    *Errors* of the mean gap are relative to its limit, extrapolated from the three finest grids;
    the distance of the finest grid from this limit is their uncertainty. The largest increments of
    the plastic path are the same on all grids, so that most of their error is not seen here.
    """
    grids = QUICK_POINTS if quick else POINTS
    return BenchFamily(
        [
            Trial(
                scene,
                type(STRAIN_SCENES[scene][0]).__name__,
                partial(gap_over_wave, scene, n),
                partial(gap_over_wave, "plastic waves", WARM),
                {"points": n},
            )
            for scene in STRAIN_SCENES
            for n in grids
        ],
        judge_by(partial(limit_of, len(grids))),
        title="cells at large strain: mean gap",
        packages=("numba",),
    )
