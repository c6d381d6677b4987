r"""Which method a friction problem meets, and when it moves on."""

from collections.abc import Callable
from functools import partial

import numpy as np

from multiscale.nonsmooth.admm import admm
from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.nonsmooth.gauss_seidel import BURST, gauss_seidel
from multiscale.nonsmooth.progress import Progress
from multiscale.nonsmooth.semismooth_newton import semismooth_newton
from multiscale.nonsmooth.split_interior_point import split_interior_point

__all__ = ["run_schedule"]

GAIN = 20.0
"""Factor by which a burst of sweeps has to cut the error to be followed by another."""

FULL, LARGE = 15.0, 200
"""Blocks per contact and contacts beyond which factorising costs as much as many solves."""


def run_schedule(
    problem: ScaledFriction, reaction: np.ndarray, progress: Progress, max_iterations: int = 5000
) -> None:
    """Go from cheap to robust methods until ``progress`` is content.

    The start is already noted; ``max_iterations`` limits each method.

    1. Bursts of Gauss-Seidel sweeps while each cuts the error by 20.
    2. A few Newton steps, unless W is so full that a factorisation outweighs many solves.
    3. Alternating directions with acceleration: one factorisation.
    4. The interior point that keeps the normal apart, finished by Newton's method.
    5. Where W is small, the interior point from other starts.
    6. Alternating directions without acceleration, slow and patient.
    """

    def tried(name: str, method: Callable[..., np.ndarray], limit: int, *options: float) -> bool:
        """Go on by a method from the best answer so far; say whether the problem is solved."""
        progress.trail.append(name)
        best = np.zeros_like(problem.velocity) if progress.best is None else progress.best
        method(problem, best, progress, min(limit, max_iterations), *options)
        return progress.smallest <= progress.target

    newton = partial(tried, "newton", semismooth_newton)

    def alternate(iterations: int, memory: int) -> bool:
        return tried("admm", partial(admm, memory=memory), iterations)

    def split(centre: float) -> bool:  # it starts from the centre of its cones
        progress.trail.append("interior_point")
        split_interior_point(problem, progress, min(60, max_iterations), centre)
        return progress.smallest <= progress.target or newton(15, 1e-10)

    progress.trail.append("gauss_seidel")
    for burst in range(max(1, max_iterations // BURST)):  # 1
        before = progress.residuals[-1]
        reaction = gauss_seidel(problem, reaction, progress, min(BURST, max_iterations))
        if progress.smallest <= progress.target:
            return
        if progress.residuals[-1] > before / GAIN and burst > 0:
            break
    large = problem.friction.size > LARGE
    heavy = large and problem.columns.size > FULL * problem.friction.size
    if not heavy and newton(15, 1e-4):  # 2
        return
    if alternate(60, 10) or split(1.0):  # 3, 4
        return
    if not large and (split(10.0) or split(0.1)):  # 5
        return
    if not alternate(2000, 0):  # 6
        newton(25, 1e-6)
