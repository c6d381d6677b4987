"""Grains in motion: the error of three closed forms and of a deposit against run time."""

from collections.abc import Iterable
from functools import partial
from shutil import which
from typing import TYPE_CHECKING

import numpy as np

from multiscale.bench import yade
from multiscale.bench.measure import THREADS
from multiscale.bench.trials import BenchFamily, Trial, judge_by

if TYPE_CHECKING:
    from multiscale.macro.granulate import Model

__all__ = ["EXACT", "answer", "plan_grains"]

GRAVITY, RADIUS = 9.81, 0.01  # m/s2, m
HEIGHTS = 1.0 + 0.05 * (np.arange(16) * (np.sqrt(5.0) - 1.0) / 2.0 % 1.0)
"""Heights of the falls of bouncing grains, m: their impacts lie anywhere in a step, as the error of
one grain depends on where."""
RESTITUTION, DURATION = 0.8, 1.0
"""Restitution of the bouncing grains; time of the answer, s, after their first impact."""
FRICTION, SPEED, ROLLED = 0.3, 1.0, 0.3
"""Friction coefficient of the sliding grain; its speed at the start, m/s; time of the answer, s."""
GRAINS, QUICK_GRAINS, SETTLING = 200, 20, 1.0
"""Number of spheres of a deposit, and time of the answer, s."""
DEPOSITS, TRUTH = range(4), range(4, 12)
"""Seeds of the deposits of an answer, and of the others that are its reference."""

BOUNCE, ROLL, DEPOSIT = (
    "mean height of bouncing grains",
    "way of a sliding grain",
    "mean height of four deposits",
)
STEPS, QUICK_STEPS = (8e-3, 4e-3, 2e-3, 1e-3, 5e-4), (4e-3, 2e-3)  # s
COMPLIANCES = {"rigid": 0.0, "compliant": 0.02}


def _bounced() -> float:
    """Mean height at the end, between the first impacts and the second ones, m."""
    first = np.sqrt(2.0 * HEIGHTS / GRAVITY)
    since = DURATION - first
    return float(np.mean(RESTITUTION * GRAVITY * first * since - 0.5 * GRAVITY * since**2))


def _rolled() -> float:
    """Way of a sphere that slides until 5/7 of its speed is left, and then rolls, m."""
    slides = 2.0 * SPEED / (7.0 * FRICTION * GRAVITY)
    way = SPEED * slides - 0.5 * FRICTION * GRAVITY * slides**2
    return way + 5.0 / 7.0 * SPEED * (ROLLED - slides)


EXACT = {BOUNCE: _bounced(), ROLL: _rolled()}  # m


def answer(scene: str, compliance: float, step: float, grains: int = QUICK_GRAINS) -> float:
    """Return the mean height or the way of a scene after steps of a length, m."""
    from multiscale.macro.granulate import ContactLaw, Grains, Model, PlaneWall, simulate_grains

    size = np.array([RADIUS])
    floor = (PlaneWall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),)
    if scene == BOUNCE:
        aside = 20.0 * RADIUS * np.arange(HEIGHTS.size)  # farther than they move in a step
        place = np.column_stack([aside, 0.0 * aside, HEIGHTS + RADIUS])
        grain = Grains(place, np.full(HEIGHTS.size, RADIUS))
        law = ContactLaw(restitution=RESTITUTION, compliance=compliance)
        motion = simulate_grains(Model(grain, floor, law), DURATION, step)
        return float(motion["position"].values[-1, :, 2].mean()) - RADIUS
    if scene == ROLL:
        grain = Grains(np.array([[0.0, 0.0, RADIUS]]), size, velocity=np.array([[SPEED, 0.0, 0.0]]))
        law = ContactLaw(FRICTION, compliance=compliance)
        motion = simulate_grains(Model(grain, floor, law), ROLLED, step)
        return float(motion["position"].values[-1, 0, 0])
    return float(np.mean(_heights(grains, compliance, step, DEPOSITS)))


def _heights(grains: int, compliance: float, step: float, seeds: Iterable[int]) -> list[float]:
    """Heights of deposits after steps of a length, m."""
    from multiscale.macro.granulate import simulate_grains

    motions = [simulate_grains(_heap(grains, one, compliance), SETTLING, step) for one in seeds]
    return [2.0 * float(one["position"].values[-1, :, 2].mean()) for one in motions]


def _heap(grains: int, seed: int, compliance: float = 0.0) -> "Model":
    """Spheres above the floor of a box of 10 cm."""
    from multiscale.macro.granulate import ContactLaw, deposit

    law = ContactLaw(compliance=compliance)
    return deposit(np.full(grains, RADIUS), (0.1, 0.1), law, seed=seed)


def _yade(grains: int) -> float:
    """Mean height of the deposits after YADE, m."""
    heaps = [_heap(grains, seed) for seed in DEPOSITS]
    return float(np.mean([yade.settle(one, SETTLING, threads=THREADS).height for one in heaps]))


def plan_grains(*, quick: bool) -> BenchFamily:
    """Plan to follow grains in ever shorter steps, with rigid and with compliant contacts.

    If quick, two lengths of steps, and a smaller deposit.

    Notes
    -----
    *Errors* are distances from a closed form; for the height of deposits, twice the mean height of
    their grains, from other deposits of rigid grains in the shortest steps. Piles of other
    histories differ by some per cent, whatever the step: two standard errors of the mean over those
    other deposits are the uncertainty. YADE lets the same grains fall where it is installed; its
    time has the two seconds in which it starts for each deposit.
    """
    grains = QUICK_GRAINS if quick else GRAINS
    lengths = QUICK_STEPS if quick else STEPS
    warm_up = partial(answer, DEPOSIT, 0.05, 4e-3)
    trials = [
        Trial(
            scene,
            method,
            partial(answer, scene, compliance, step, grains),
            warm_up,
            {"time_step": step},
        )
        for scene in (BOUNCE, ROLL, DEPOSIT)
        for method, compliance in COMPLIANCES.items()
        for step in lengths
    ]
    by_yade = Trial(
        DEPOSIT,
        "YADE",
        partial(_yade, grains),
        warm_up,
        {"time_step": yade.time_step(_heap(1, 0))},
        left_out="" if which(yade.PROGRAM) else "because it is not installed; apt install yade",
    )
    return BenchFamily(
        [*trials, by_yade],
        judge_by(partial(_truth, min(lengths), grains)),
        title="grains in motion: heights and ways",
        packages=("numba",),
    )


def _truth(step: float, grains: int, scene: str, answers: list[float]) -> tuple[float, float]:
    """Take the closed form, or the mean over deposits and two standard errors of it."""
    if scene in EXACT:
        return EXACT[scene], np.nan
    heights = np.array(_heights(grains, 0.0, step, TRUTH))
    mean = heights.mean()
    return float(mean), float(2.0 * heights.std(ddof=1) / np.sqrt(heights.size) / mean)
