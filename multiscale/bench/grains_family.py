"""Grains in motion: the error of three closed forms and of a deposit against run time."""

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
HEIGHT, RESTITUTION, DURATION = 1.0, 0.8, 1.2
"""Height of the fall of a bouncing grain, m; its restitution; time of the answer, s."""
FRICTION, SPEED, ROLLED = 0.3, 1.0, 0.3
"""Friction coefficient of the sliding grain; its speed at the start, m/s; time of the answer, s."""
GRAINS, QUICK_GRAINS, SETTLING = 200, 20, 0.5
"""Number of spheres of a deposit, and time of the answer, s."""

BOUNCE, ROLL, DEPOSIT = (
    "height of a bouncing grain",
    "way of a sliding grain",
    "height of a deposit",
)
STEPS, QUICK_STEPS = (8e-3, 4e-3, 2e-3, 1e-3, 5e-4), (4e-3, 2e-3)  # s
FINEST = 8.0
"""Length of the shortest step over the length of the steps of the reference of a deposit."""
COMPLIANCES = {"rigid": 0.0, "compliant": 0.02}


def _bounced() -> float:
    """Height at the end, between the first impact and the second or after, m."""
    first = np.sqrt(2.0 * HEIGHT / GRAVITY)
    begin, speed = first, RESTITUTION * GRAVITY * first
    while begin + 2.0 * speed / GRAVITY < DURATION:
        begin += 2.0 * speed / GRAVITY
        speed *= RESTITUTION
    since = DURATION - begin
    return float(speed * since - 0.5 * GRAVITY * since**2)


def _rolled() -> float:
    """Way of a sphere that slides until 5/7 of its speed is left, and then rolls, m."""
    slides = 2.0 * SPEED / (7.0 * FRICTION * GRAVITY)
    way = SPEED * slides - 0.5 * FRICTION * GRAVITY * slides**2
    return way + 5.0 / 7.0 * SPEED * (ROLLED - slides)


EXACT = {BOUNCE: _bounced(), ROLL: _rolled()}  # m


def answer(scene: str, compliance: float, step: float, grains: int = QUICK_GRAINS) -> float:
    """Return the height or way of a scene after steps of a length, m."""
    from multiscale.macro.granulate import ContactLaw, Grains, Model, PlaneWall, simulate_grains

    size = np.array([RADIUS])
    floor = (PlaneWall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),)
    if scene == BOUNCE:
        grain = Grains(np.array([[0.0, 0.0, HEIGHT + RADIUS]]), size)
        law = ContactLaw(restitution=RESTITUTION, compliance=compliance)
        motion = simulate_grains(Model(grain, floor, law), DURATION, step)
        return float(motion["position"].values[-1, 0, 2]) - RADIUS
    if scene == ROLL:
        grain = Grains(np.array([[0.0, 0.0, RADIUS]]), size, velocity=np.array([[SPEED, 0.0, 0.0]]))
        law = ContactLaw(FRICTION, compliance=compliance)
        motion = simulate_grains(Model(grain, floor, law), ROLLED, step)
        return float(motion["position"].values[-1, 0, 0])
    motion = simulate_grains(_heap(grains, compliance), SETTLING, step)
    return 2.0 * float(motion["position"].values[-1, :, 2].mean())


def _heap(grains: int, compliance: float = 0.0) -> "Model":
    """Spheres above the floor of a box of 10 cm."""
    from multiscale.macro.granulate import ContactLaw, deposit

    return deposit(np.full(grains, RADIUS), (0.1, 0.1), ContactLaw(compliance=compliance))


def _yade(grains: int) -> float:
    """Height of the deposit after YADE, m."""
    return yade.settle(_heap(grains), SETTLING, threads=THREADS).height


def plan_grains(*, quick: bool) -> BenchFamily:
    """Plan to follow grains in ever shorter steps, with rigid and with compliant contacts.

    If quick, two lengths of steps, and a smaller deposit.

    Notes
    -----
    *Errors* are distances from a closed form; for the height of a deposit, twice the mean height of
    its grains, the distance from rigid contact in much shorter steps. Piles of other histories
    differ, so that the deposit is not known better than the distance of both references. YADE lets
    the same grains fall where it is installed; its time has the two seconds in which it starts.
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
        {"time_step": yade.time_step(_heap(1))},
        left_out="" if which(yade.PROGRAM) else "because it is not installed; apt install yade",
    )
    return BenchFamily(
        [*trials, by_yade],
        judge_by(partial(_truth, min(lengths) / FINEST, grains)),
        title="grains in motion: heights and ways",
        packages=("numba",),
    )


def _truth(step: float, grains: int, scene: str, answers: list[float]) -> tuple[float, float]:
    """Take the closed form, or the height in very short steps and its distance from compliance."""
    if scene in EXACT:
        return EXACT[scene], np.nan
    rigid, compliant = (answer(scene, a, step, grains) for a in COMPLIANCES.values())
    return rigid, abs(compliant / rigid - 1.0)
