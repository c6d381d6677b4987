"""Two-scale fatigue: the error of cycle jumps against their run time."""

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from multiscale.bench.trials import Columns, Report, Runs, Trial, judge_by, measure_trials
from multiscale.micro.damage import FatigueMaterial, StressBlock, two_scale_fatigue

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["TOLERANCES", "bench_damage", "life", "scene_history"]

MATERIAL = FatigueMaterial(
    200e9, 0.3, 200e6, 0.5e6, 2.0, hardening=20e9, threshold=0.05, closure=0.2
)
"""Feedback of damage, closure and hardening: what makes cycles differ from each other."""

SCENES = ("reversed tension, 1.001 of the limit", "tension and torsion", "blocks of three kinds")
QUICK_SCENES = SCENES[1:2]

TOLERANCES = (0.3, 0.1, 0.03, 0.01, 0.003, 0.001)
"""Of the jumps."""
QUICK_TOLERANCES = (0.1, 0.01)

EVERY = "every cycle"

SUBSTEPS = 16
"""Of every piece of a cycle; four times as many tell their error."""

REPEATS = 3


def scene_history(scene: str) -> list[StressBlock]:
    """Stress history of a scene, Pa."""
    limit = MATERIAL.fatigue_limit
    if scene == SCENES[0]:
        return [StressBlock(1.001 * limit * np.array([1.0, -1.0]))]
    if scene == SCENES[1]:  # out of phase: the principal axes turn
        angle = np.arange(8) * np.pi / 4.0
        path = np.zeros((8, 6))
        path[:, 0], path[:, 5] = np.cos(angle), np.sin(angle) / np.sqrt(3.0)
        return [StressBlock(1.05 * limit * path)]
    amplitudes, cycles = (1.05, 0.9, 1.15), (50, 1000, 5)
    return [
        StressBlock(share * limit * np.array([1.0, -1.0]), count)
        for share, count in zip(amplitudes, cycles, strict=True)
    ]


def life(scene: str, tolerance: float | None, substeps: int = SUBSTEPS) -> tuple[float, float]:
    """Cycles to rupture, and cycles that were followed to find them."""
    found = two_scale_fatigue(
        scene_history(scene), MATERIAL, jump_tolerance=tolerance, substeps=substeps
    )
    return float(found["cycles_to_rupture"]), float(found["computed_cycles"])


def bench_damage(*, quick: bool, report: Report) -> "xr.Dataset":
    """Find lives by following every cycle, and by jumps of several tolerances.

    If quick, one scene, two tolerances and one run of each. ``iterations`` are the
    cycles that were followed.

    Notes
    -----
    *Errors* are those of the cycles to rupture, relative to every cycle followed in the same
    substeps. ``error_uncertainty`` is what four times the substeps change, which is also given as
    the error of the run that follows every cycle: below it jumps need not be.
    *Times* are those of :func:`multiscale.micro.damage.two_scale_fatigue` in a process of its own,
    after a warm-up that takes imports and compilation.
    """
    tolerances = (None, *(QUICK_TOLERANCES if quick else TOLERANCES))
    return measure_trials(
        [
            Trial(
                scene,
                EVERY if tolerance is None else "cycle jumps",
                partial(life, scene, tolerance),
                partial(life, SCENES[1], 0.3),
                {"tolerance": tolerance or 0.0},
                1 if quick else REPEATS,
            )
            for scene in (QUICK_SCENES if quick else SCENES)
            for tolerance in tolerances
        ],
        _judge,
        title="two-scale fatigue: error of the life against run time",
        packages=("numba",),
        report=report,
    )


def _judge(scene: str, runs: Runs) -> Iterator[tuple[Trial, Columns]]:
    """Judge jumps by the run that follows every cycle, and that run by its substeps."""
    for trial, columns in judge_by(_truth, count="iterations")(scene, runs):
        if trial.method == EVERY:  # without an error, or with NaN if it did not end
            columns["error"] += columns["error_uncertainty"]
        yield trial, columns


def _truth(scene: str, lives: list[float]) -> tuple[float, float]:
    """Follow every cycle, and say what four times the substeps change."""
    reference, _ = life(scene, None)
    return reference, abs(reference / life(scene, None, 4 * SUBSTEPS)[0] - 1.0)
