"""Grains in motion: the error of two closed forms and of a deposit against run time."""

from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np

from multiscale.bench.measure import BenchFamily, Row, Runner, judge

GRAVITY, RADIUS = 9.81, 0.01  # m/s2, m
HEIGHTS = 1.0 + 0.05 * (np.arange(16) * (np.sqrt(5.0) - 1.0) / 2.0 % 1.0)
"""Heights of the falls of bouncing grains, m: their impacts are spread over a step, as the error of
a single grain depends on the place of its impact."""
RESTITUTION, DURATION = 0.8, 1.0
"""Restitution of the bouncing grains; time of the answer, s, after their first impact."""
FRICTION, SPEED, ROLLED = 0.3, 1.0, 0.3
"""Friction coefficient of the sliding grain; its speed at the start, m/s; time of the answer, s."""
DEPOSITS, TRUTH = range(4), range(4, 12)
"""Seeds of the deposits of an answer, and of the deposits that are its reference."""

BOUNCE, ROLL, DEPOSIT = (
    "mean height of bouncing grains",
    "way of a sliding grain",
    "mean height of four deposits",
)
STEPS = (8e-3, 4e-3, 2e-3, 1e-3, 5e-4)  # s
RIGID = (0.0, 0.0)
COMPLIANCES = {"rigid": RIGID, "compliant": (0.02, 0.02), "rigid normals": (0.0, 0.1)}
"""Compliances along and across the normal, dimensionless."""


def _bounced() -> float:
    """Return the mean height at the end, between first and second impacts, m."""
    first = np.sqrt(2.0 * HEIGHTS / GRAVITY)
    since = DURATION - first
    return float(np.mean(RESTITUTION * GRAVITY * first * since - 0.5 * GRAVITY * since**2))


def _rolled() -> float:
    """Return the way of a sphere that slides down to 5/7 of its speed, and then rolls, m."""
    slides = 2.0 * SPEED / (7.0 * FRICTION * GRAVITY)
    way = SPEED * slides - 0.5 * FRICTION * GRAVITY * slides**2
    return way + 5.0 / 7.0 * SPEED * (ROLLED - slides)


EXACT = {BOUNCE: _bounced(), ROLL: _rolled()}  # m


def answer(scene: str, compliance: tuple[float, float], step: float, grains: int = 20) -> float:
    """Return the mean height or the way of a scene after steps of a length, m."""
    from multiscale.macro.granulate import ContactLaw, Grains, Model, PlaneWall, simulate_grains

    floor = (PlaneWall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),)
    along, across = compliance
    if scene == BOUNCE:
        aside = 20.0 * RADIUS * np.arange(HEIGHTS.size)  # farther than they move in a step
        place = np.column_stack([aside, 0.0 * aside, HEIGHTS + RADIUS])
        grain = Grains(place, np.full(HEIGHTS.size, RADIUS))
        law = ContactLaw(restitution=RESTITUTION, compliance=along, tangential_compliance=across)
        motion = simulate_grains(Model(grain, floor, law), DURATION, step)
        return float(motion["position"].values[-1, :, 2].mean()) - RADIUS
    if scene == ROLL:
        place, speed = np.array([[0.0, 0.0, RADIUS]]), np.array([[SPEED, 0.0, 0.0]])
        grain = Grains(place, np.array([RADIUS]), velocity=speed)
        law = ContactLaw(FRICTION, compliance=along, tangential_compliance=across)
        motion = simulate_grains(Model(grain, floor, law), ROLLED, step)
        return float(motion["position"].values[-1, 0, 0])
    return float(np.mean(deposit_heights(grains, compliance, step, DEPOSITS)))


def deposit_heights(
    grains: int, compliance: tuple[float, float], step: float, seeds: Iterable[int]
) -> list[float]:
    """Drop spheres into a box of 10 cm for a second: twice their mean height for each seed."""
    from multiscale.macro.granulate import ContactLaw, deposit, simulate_grains

    along, across = compliance
    radii = np.full(grains, RADIUS)
    law = ContactLaw(compliance=along, tangential_compliance=across)
    heaps = [deposit(radii, (0.1, 0.1), law, seed=seed) for seed in seeds]
    motions = [simulate_grains(heap, 1.0, step) for heap in heaps]
    return [2.0 * float(motion["position"].values[-1, :, 2].mean()) for motion in motions]


@partial(BenchFamily, "grains in motion: heights and ways", packages=("numba",))
def grains(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Follow grains in ever shorter steps, with contacts rigid, compliant, or rigid on normals."""
    grains, steps = (20, STEPS[1:3]) if quick else (200, STEPS)
    for scene in (BOUNCE, ROLL, DEPOSIT):
        rows = [
            run(
                scene,
                method,
                *(answer, scene, compliance, step, grains),
                warm=(DEPOSIT, (0.05, 0.05), 4e-3),
                time_step=step,
            )
            for method, compliance in COMPLIANCES.items()
            for step in steps
        ]
        if scene in EXACT:
            yield judge(rows, EXACT[scene])
            continue
        heights = np.array(deposit_heights(grains, RIGID, min(steps), TRUTH))
        spread = 2.0 * heights.std(ddof=1) / np.sqrt(heights.size) / heights.mean()
        yield judge(rows, float(heights.mean()), float(spread))
