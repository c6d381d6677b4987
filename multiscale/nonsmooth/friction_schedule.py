r"""Which method a friction problem meets, and when it moves on."""

from dataclasses import dataclass

import numpy as np

from multiscale.nonsmooth.admm import admm
from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.nonsmooth.frozen_bound import frozen_bound
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
    problem: ScaledFriction,
    reaction: np.ndarray,
    progress: Progress,
    max_iterations: int = 5000,
) -> None:
    """Go from what is cheap to what is robust until ``progress`` is content.

    Parameters
    ----------
    reaction : ndarray, shape (contacts, 3), start, already noted
    progress : Progress, holds the best answer and the trail
    max_iterations : int, limit of each method

    Notes
    -----
    1. Bursts of Gauss-Seidel sweeps while each cuts the error by 20.
    2. A few Newton steps, unless W is so full that a factorisation outweighs many solves.
    3. Alternating directions with acceleration: one factorisation.
    4. The interior point that keeps the normal apart, finished by Newton's method.
    5. The sequence of problems with known friction bound; where W is small, also damped, and the
       interior point from another start.
    6. Alternating directions without acceleration, slow and patient.
    """
    run = _Schedule(problem, progress, max_iterations)
    if run.sweep(reaction):  # 1
        return
    large = problem.friction.size > LARGE
    heavy = large and problem.columns.size > FULL * problem.friction.size
    if not heavy and run.newton(15, 1e-4):  # 2
        return
    if run.alternate(60, 10) or run.split(1.0) or run.frozen(1.0):  # 3, 4, 5
        return
    if not large and (run.frozen(0.5) or run.split(10.0)):  # 5
        return
    if not run.alternate(2000, 0):  # 6
        run.newton(25, 1e-6)


@dataclass(frozen=True)
class _Schedule:
    """The steps of the schedule; each says whether the problem is solved."""

    problem: ScaledFriction
    progress: Progress
    limit: int

    @property
    def solved(self) -> bool:
        return self.progress.smallest <= self.progress.target

    @property
    def best(self) -> np.ndarray:
        """Best answer so far; zero if none was finite."""
        best = self.progress.best
        return np.zeros_like(self.problem.velocity) if best is None else best

    def sweep(self, reaction: np.ndarray) -> bool:
        self.progress.trail.append("gauss_seidel")
        for burst in range(max(1, self.limit // BURST)):
            before = self.progress.residuals[-1]
            reaction = gauss_seidel(self.problem, reaction, self.progress, min(BURST, self.limit))
            slow = self.progress.residuals[-1] > before / GAIN
            if self.solved or (slow and burst > 0):
                break
        return self.solved

    def newton(self, steps: int, regularisation: float) -> bool:
        self.progress.trail.append("newton")
        steps = min(steps, self.limit)
        semismooth_newton(self.problem, self.best, self.progress, steps, regularisation)
        return self.solved

    def alternate(self, iterations: int, memory: int) -> bool:
        self.progress.trail.append("admm")
        iterations = min(iterations, self.limit)
        admm(self.problem, self.best, self.progress, iterations, memory=memory)
        return self.solved

    def split(self, centre: float) -> bool:
        self.progress.trail.append("interior_point")
        split_interior_point(self.problem, self.progress, min(60, self.limit), centre)
        return self.solved or self.newton(15, 1e-10)

    def frozen(self, relaxation: float) -> bool:
        self.progress.trail.append("frozen_bound")
        turns = min(20, self.limit)
        frozen_bound(self.problem, self.best, self.progress, turns, relaxation)
        return self.solved
