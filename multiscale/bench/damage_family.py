"""Two-scale fatigue: the error of cycle jumps against their run time."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from multiscale.bench.trials import BenchFamily, Columns, Runs, Trial, judge_by
from multiscale.micro.damage import FatigueMaterial, two_scale_fatigue

__all__ = ["TOLERANCES", "life", "plan_damage", "scene_history"]

MATERIAL = FatigueMaterial(
    200e9, 0.3, 200e6, 0.5e6, 2.0, hardening=20e9, threshold=0.05, closure=0.2
)
"""Material with feedback of damage, closure and hardening, which make cycles differ."""

SCENES = ("reversed tension, 1.001 of the limit", "tension and torsion", "blocks of three kinds")
QUICK_SCENES = SCENES[1:2]

TOLERANCES = (0.3, 0.1, 0.03, 0.01, 0.003, 0.001)
"""Tolerances of the cycle jumps."""
QUICK_TOLERANCES = (0.1, 0.01)

EVERY = "every cycle"

SUBSTEPS = 16
"""Number of substeps of every piece of a cycle; four times as many give their error."""

REPEATS = 3


def scene_history(scene: str) -> np.ndarray:
    """Corners of a cycle of stress, or of a program of cycles, of a scene, Pa."""
    limit = MATERIAL.fatigue_limit
    reversed_tension = limit * np.array([1.0, -1.0])
    if scene == SCENES[0]:
        return 1.001 * reversed_tension
    if scene == SCENES[1]:  # out of phase: the principal axes turn
        angle = np.arange(8) * np.pi / 4.0
        path = np.zeros((8, 6))
        path[:, 0], path[:, 5] = np.cos(angle), np.sin(angle) / np.sqrt(3.0)
        return 1.05 * limit * path
    amplitudes, cycles = (1.05, 0.9, 1.15), (5, 10, 1)
    return np.concatenate(
        [
            np.tile(share * reversed_tension, count)
            for share, count in zip(amplitudes, cycles, strict=True)
        ]
    )


def life(scene: str, tolerance: float | None, substeps: int = SUBSTEPS) -> tuple[float, float]:
    """Cycles to rupture, and cycles that were followed to find them."""
    found = two_scale_fatigue(
        scene_history(scene), MATERIAL, jump_tolerance=tolerance, substeps=substeps
    )
    return float(found["cycles_to_rupture"]), float(found["computed_cycles"])


def plan_damage(*, quick: bool) -> BenchFamily:
    """Plan to find lives by following every cycle, and by jumps of several tolerances.

    If quick, one scene, two tolerances and one run of each. ``iterations`` counts the cycles that
    were followed.

    Notes
    -----
    *Errors* of the cycles to rupture are relative to the run that follows every cycle in the same
    substeps. ``error_uncertainty`` is the change by four times the substeps, which is also given as
    the error of that run: jumps need not be more accurate.
    *Times* hold for :func:`multiscale.micro.damage.two_scale_fatigue` in a process of its own,
    after a warm-up that takes imports and compilation.
    """
    tolerances = (None, *(QUICK_TOLERANCES if quick else TOLERANCES))
    return BenchFamily(
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
    )


def _judge(scene: str, runs: Runs) -> Iterator[tuple[Trial, Columns]]:
    """Judge jumps by the run that follows every cycle, and that run by its substeps."""
    for trial, columns in judge_by(_truth, count="iterations")(scene, runs):
        if trial.method == EVERY:  # without an error, or with NaN if it did not end
            columns["error"] += columns["error_uncertainty"]
        yield trial, columns


def _truth(scene: str, lives: list[float]) -> tuple[float, float]:
    """Follow every cycle, also in four times the substeps."""
    reference, _ = life(scene, None)
    return reference, abs(reference / life(scene, None, 4 * SUBSTEPS)[0] - 1.0)
