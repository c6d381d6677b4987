"""A path in increments that shrink where Newton's iteration fails and grow where it is easy."""

import logging
from dataclasses import dataclass, replace

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.finite.newton import solve_increment
from multiscale.micro.finite.scene import CellState, Scene, Target
from multiscale.micro.flat import solve_flat
from multiscale.micro.lateral_fft import filter_surface

__all__ = ["Walk", "rest_state", "walk_step"]

logger = logging.getLogger(__name__)

SHRINK, GROW = 0.4, 1.7
EASY = 7  # Newton iterations
TOO_FAR = 1.2  # times the largest change of the approach: done again in shorter increments
SMALLEST = 1e-4  # of a step of the path
MOST = 400  # increments of a step beyond the fewest: what creeps on in short ones is given up


@dataclass(frozen=True, eq=False)
class Walk:
    """A step of the path, and what it took.

    Attributes
    ----------
    state : CellState
        At the end, or where it stopped.
    increments, newton_iterations, linear_iterations : int
        Of increments that were accepted or cut.
    reached : float
        Share of the step that was done.
    """

    state: CellState
    increments: int
    newton_iterations: int
    linear_iterations: int
    reached: float


def rest_state(scene: Scene) -> CellState:
    """Return the cell before any load."""
    nx, ny = scene.grid
    nothing = np.zeros((nx, ny), dtype=bool)
    return CellState(
        np.zeros(scene.body.shape),
        0.0,
        np.zeros(2),
        scene.body.rest(),
        np.zeros((nx, 3, ny)),
        nothing,
        nothing,
        status=Status.CONVERGED,
        residuals=(0.0,),
    )


def walk_step(
    scene: Scene,
    start: CellState,
    target: Target,
    *,
    increments: int,
    tolerance: float,
    largest_approach: float = np.inf,
) -> Walk:
    """Go from one step of a path to the next.

    Parameters
    ----------
    scene : Scene
    start : CellState
    target : Target
        Its load is the total one, also if the step before prescribed the approach.
    increments : int
        Fewest increments.
    tolerance : float
        Of each increment.
    largest_approach : float
        What the approach may change by in one increment, m: for bodies whose answer depends on it.
    """
    begin, state = start, start
    load = -float(start.force[:, 2].sum())
    reached, length = 0.0, 1.0 / increments
    count, newton, linear = 0, 0, 0
    while reached < 1.0:
        if count == increments + MOST:
            state = replace(state, status=Status.MAX_ITERATIONS)
            break
        share = min(1.0, reached + length)
        share = 1.0 if 1.0 - share < 1e-9 else share
        aim = Target(
            None if target.load is None else load + share * (target.load - load),
            None
            if target.approach is None
            else begin.approach + share * (target.approach - begin.approach),
            begin.slide + share * (target.slide - begin.slide),
            (share - reached) * target.time_step,
        )
        found = _increment(scene, state, aim, tolerance)
        count += 1
        newton += len(found.residuals) - 1
        linear += found.linear_iterations
        logger.debug(
            "to %.4f: %s in %d iterations, %d linear, error %.1e, flowing %.3f",
            share,
            found.status.name,
            len(found.residuals) - 1,
            found.linear_iterations,
            found.residuals[-1],
            found.flowing,
        )
        moved = abs(found.approach - state.approach)
        if found.status is Status.CONVERGED and moved <= TOO_FAR * largest_approach:
            state, done = found, share - reached
            reached = share
            if len(found.residuals) - 1 <= EASY:
                length = min(1.0 / increments, GROW * done)
            if moved > 0.0:
                length = min(length, done * largest_approach / moved)
        elif found.status is Status.CONVERGED:
            length = (share - reached) * largest_approach / moved
        else:
            length = SHRINK * (share - reached)
            if length < SMALLEST:
                state = replace(state, status=found.status)
                break
    return Walk(state, count, newton, linear, reached)


def _increment(scene: Scene, state: CellState, aim: Target, tolerance: float) -> CellState:
    """Solve one increment; without contact nothing is to be solved."""
    if aim.load == 0.0:
        return _released(scene, state, aim)
    guess = None
    if not state.active.any():
        guess = _first_touch(scene, state, aim)
        if guess is not None and not guess[0].any():
            return _released(scene, state, aim)
    return solve_increment(scene, state, aim, guess, tolerance=tolerance)


def _first_touch(scene: Scene, state: CellState, aim: Target) -> tuple[np.ndarray, float] | None:
    """Contact nodes of the flat reference, for a cell that touches nothing yet."""
    meeting = scene.meet(state.displacement, 0.0, aim.slide)
    gap, closing = meeting.gap, meeting.normal[:, 2]
    if aim.approach is not None:
        return gap - closing * aim.approach < 0.0, aim.approach
    symbol = scene.vertical[0]
    force, delta, _ = solve_flat(lambda f: filter_surface(f, symbol), gap, closing, load=aim.load)
    return force > 0.0, delta


def _released(scene: Scene, state: CellState, aim: Target) -> CellState:
    """Take the obstacle away and bring it back to the first touch, or where it is asked to be."""
    reach = float(np.ptp(scene.obstacle.body.heights)) + abs(state.approach)
    shape = scene.obstacle.shape
    reach += 0.0 if shape is None else float(np.ptp(shape.heights))
    away = replace(aim, load=None, approach=-10.0 * reach)
    free = solve_increment(scene, state, away)
    meeting = scene.meet(free.displacement, 0.0, aim.slide)
    touch = float(np.min(meeting.gap / meeting.normal[:, 2]))
    return replace(free, approach=touch if aim.approach is None else aim.approach)
