"""Stiffness of a porous solid: its error against run time over size, number and voxels."""

from functools import partial

import numpy as np

from multiscale.bench.trials import BenchFamily, Trial, judge_by
from multiscale.micro.damage import Recipe, effective_stiffness, voxelise, youngs_modulus_along

__all__ = ["mean_modulus", "plan_volumes"]

CASTING = Recipe(porosity=0.06, pore_radius=120e-6, pore_spread=0.25)
"""Pores of the shipped case ``porous_bracket``."""

MODULUS, RATIO = 71e9, 0.33

SCENE = "Young's modulus of a casting with 6 % of pores"

WAYS = {
    "larger volumes": tuple((size, 1, 24) for size in (0.5e-3, 1e-3, 2e-3)),
    "more volumes": tuple((0.5e-3, count, 24) for count in (1, 4, 16)),
    "smaller voxels": tuple((1e-3, 4, voxels) for voxels in (8, 16, 32)),
}
"""Edge of the volumes, m, their number, and voxels along 1 mm, by what is refined."""
QUICK_WAYS = {name: steps[:2] for name, steps in WAYS.items()}

SAMPLES = 6
"""Independent answers, whose root mean square error counts."""

TRUTH = (1.5e-3, 12, 48)
"""Volumes of the reference."""


def mean_modulus(size: float, count: int, voxels: int, seed: int = 0) -> float:
    """Mean Young's modulus of volumes over all directions of their edges, Pa."""
    found = []
    for k in range(count):
        image = voxelise(CASTING.draw((size,) * 3, seed + k), round(voxels * size / 1e-3))
        C = effective_stiffness(image, MODULUS, RATIO).unwrap()
        found.append(youngs_modulus_along(C, np.eye(3)).mean())
    return float(np.mean(found))


def plan_volumes(*, quick: bool) -> BenchFamily:
    """Plan to find the stiffness of a porous solid by larger, more and finer volumes.

    If quick, two steps of each and two independent answers.

    Notes
    -----
    *Errors* are the root mean square over independent answers, against the mean of larger and
    finer volumes, whose change by coarser voxels is ``error_uncertainty``.
    """
    samples = 2 if quick else SAMPLES
    return BenchFamily(
        [
            Trial(
                SCENE,
                way,
                partial(_answers, step, samples),
                partial(mean_modulus, 0.5e-3, 1, 8),
                {"points": round(step[2] * step[0] / 1e-3), "realisations": step[1]},
            )
            for way, steps in (QUICK_WAYS if quick else WAYS).items()
            for step in steps
        ],
        judge_by(_truth),
        title="stiffness of a porous solid: error against run time",
        packages=("numba",),
    )


def _answers(step: tuple[float, int, int], samples: int) -> list[float]:
    """Answers with pores of their own."""
    size, count, voxels = step
    return [mean_modulus(size, count, voxels, seed=1000 * (k + 1)) for k in range(samples)]


def _truth(scene: str, answers: list[float]) -> tuple[float, float]:
    """Modulus of the reference, and its change by coarser voxels."""
    size, count, voxels = TRUTH
    exact = mean_modulus(size, count, voxels)
    return exact, abs(mean_modulus(size, count, voxels // 2) / exact - 1.0)
