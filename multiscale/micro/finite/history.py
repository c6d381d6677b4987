"""A path in increments that shrink where Newton's iteration fails and grow where it is easy."""

import logging
from dataclasses import dataclass, replace

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.finite.cell_newton import solve_increment
from multiscale.micro.finite.scene import CellScene, CellState, Target
from multiscale.micro.flat import solve_flat
from multiscale.micro.lateral_fft import filter_surface

__all__ = ["Walk", "rest_state", "walk_step"]

logger = logging.getLogger(__name__)

SHRINK, GROW = 0.4, 1.7
EASY = 7  # Newton iterations
FIRST = 0.2  # of the largest change of the approach, where a load has found no equilibrium
TOO_FAR = 1.2  # times the largest change of the approach: done again in shorter increments
SMALLEST = 1e-4  # of a step of the path
MOST = 400  # increments of a step beyond the fewest: what creeps on in short ones is given up
LINEAR = (1_000, 20_000)  # linear iterations of a step: for each increment, and more


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


def rest_state(scene: CellScene) -> CellState:
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
    scene: CellScene,
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
    state, before, work = start, start, np.zeros(3, dtype=int)
    reached, done, length = 0.0, 0.0, 1.0 / increments
    while reached < 1.0:
        if (spent := _spent(work, increments)) is not None:
            state = replace(state, status=spent)
            break
        share = min(1.0, reached + length)
        share = 1.0 if 1.0 - share < 1e-9 else share
        part = share - reached
        aim = _between(start, target, share, part)
        ahead = _extrapolate(before, state, part / done) if done > 0.0 else None
        found = _increment(scene, state, aim, tolerance, ahead, work)
        moved = abs(found.approach - state.approach)
        if found.status is Status.CONVERGED and moved <= TOO_FAR * largest_approach:
            before, state, done, reached = state, found, part, share
            if len(found.residuals) - 1 <= EASY:
                length = min(1.0 / increments, GROW * part)
            if moved > 0.0:
                length = min(length, part * largest_approach / moved)
        elif found.status is Status.CONVERGED:
            length = part * largest_approach / moved
        elif _presses(start, target, largest_approach):
            state = _press(scene, state, target, largest_approach, tolerance, work, increments)
            wanted = float(target.load or 0.0) - start.load
            carried = (state.load - start.load) / wanted
            reached = 1.0 if state.status is Status.CONVERGED else carried
            break
        else:
            length = SHRINK * part
            if length < SMALLEST:
                state = replace(state, status=found.status)
                break
    count, newton, linear = map(int, work)
    return Walk(state, count, newton, linear, reached)


def _spent(work: np.ndarray, increments: int) -> Status | None:
    """Say which limit of a step was reached: of increments, or of linear iterations."""
    if work[0] >= increments + MOST:
        return Status.MAX_ITERATIONS
    most = LINEAR[0] * max(increments, work[0]) + LINEAR[1]
    return Status.WORK_SPENT if work[2] >= most else None


def _between(start: CellState, target: Target, share: float, part: float) -> Target:
    """Give the target of an increment of length ``part`` that ends at a share of the step."""

    def at(begin: float, end: float | None) -> float | None:
        return None if end is None else begin + share * (end - begin)

    return Target(
        at(start.load, target.load),
        at(start.approach, target.approach),
        start.slide + share * (target.slide - start.slide),
        part * target.time_step,
    )


def _presses(start: CellState, target: Target, largest_approach: float) -> bool:
    """Whether a step changes the load alone, and the body flows."""
    changes = target.load is not None and target.load not in (0.0, start.load)
    return changes and bool(np.isfinite(largest_approach) and np.all(target.slide == start.slide))


def _press(
    scene: CellScene,
    state: CellState,
    target: Target,
    largest_approach: float,
    tolerance: float,
    work: np.ndarray,
    increments: int,
) -> CellState:
    """Move a body that flows until it carries the load of a target.

    Where nothing hardens, more load may find no equilibrium before another asperity touches; a
    smaller gap does.
    """
    load = float(target.load or 0.0)
    sign = 1.0 if load > state.load else -1.0
    before, done, length = state, 0.0, FIRST * largest_approach
    while (status := _spent(work, increments)) is None:
        aim = Target(None, state.approach + sign * length, target.slide)
        ahead = _extrapolate(before, state, length / done) if done > 0.0 else None
        found = _increment(scene, state, aim, tolerance, ahead, work)
        if found.status is Status.CONVERGED and sign * (found.load - load) >= 0.0:
            part = (load - state.load) / (found.load - state.load)
            between = _extrapolate(state, found, part - 1.0)
            found = _increment(scene, state, target, tolerance, between, work)
            if found.status is Status.CONVERGED:
                return found
        if found.status is Status.CONVERGED:
            before, state, done = state, found, length
            if len(found.residuals) - 1 <= EASY:
                length = min(largest_approach, GROW * length)
        else:
            length *= SHRINK
            if length < SMALLEST * largest_approach:
                status = found.status
                break
    return replace(state, status=status)


def _extrapolate(before: CellState, state: CellState, ratio: float) -> tuple[np.ndarray, float]:
    """Go on as in the last increment."""
    u = state.displacement + ratio * (state.displacement - before.displacement)
    return u, state.approach + ratio * (state.approach - before.approach)


def _increment(
    scene: CellScene,
    state: CellState,
    aim: Target,
    tolerance: float,
    ahead: tuple[np.ndarray, float] | None,
    work: np.ndarray,
) -> CellState:
    """Solve one increment and count it; without contact nothing is to be solved."""
    guess = None
    if aim.load != 0.0 and not state.active.any():
        guess = _first_touch(scene, state, aim)
    if aim.load == 0.0 or (guess is not None and not guess[0].any()):
        found = _released(scene, state, aim)
    else:
        found = solve_increment(scene, state, aim, guess, predicted=ahead, tolerance=tolerance)
    work += (1, len(found.residuals) - 1, found.linear_iterations)
    logger.debug(
        "load %.3g N, approach %.4g m: %s in %d iterations, %d linear, error %.1e, flowing %.3f",
        found.load,
        found.approach,
        found.status.name,
        len(found.residuals) - 1,
        found.linear_iterations,
        found.residuals[-1],
        found.flowing,
    )
    return found


def _first_touch(
    scene: CellScene, state: CellState, aim: Target
) -> tuple[np.ndarray, float] | None:
    """Contact nodes of the flat reference, for a cell that touches nothing yet."""
    meeting = scene.meet(state.displacement, 0.0, aim.slide)
    gap, closing = meeting.gap, meeting.normal[:, 2]
    if aim.approach is not None:
        return gap - closing * aim.approach < 0.0, aim.approach
    symbol = scene.vertical[0]
    found = solve_flat(lambda f: filter_surface(f, symbol), gap, closing, load=aim.load)
    return found.value > 0.0, found.approach


def _released(scene: CellScene, state: CellState, aim: Target) -> CellState:
    """Take the obstacle away and bring it back to the first touch, or where it is asked to be."""
    reach = float(np.ptp(scene.obstacle.body.heights)) + abs(state.approach)
    shape = scene.obstacle.shape
    reach += 0.0 if shape is None else float(np.ptp(shape.heights))
    away = replace(aim, load=None, approach=-10.0 * reach)
    free = solve_increment(scene, state, away)
    meeting = scene.meet(free.displacement, 0.0, aim.slide)
    touch = float(np.min(meeting.gap / meeting.normal[:, 2]))
    return replace(free, approach=touch if aim.approach is None else aim.approach)
