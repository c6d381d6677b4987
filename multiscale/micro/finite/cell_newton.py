"""Newton's iteration over an increment, and a step of a path in increments."""

import logging
from dataclasses import dataclass, replace

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.finite.equations import CellEquations, CellScene, CellState, Iterate
from multiscale.micro.path import Target
from multiscale.numerics.newton import Limits, NewtonRun

logger = logging.getLogger(__name__)

LEAST_DILATATION = 0.05  # smallest det F of an accepted iterate
HALVINGS = 7  # of a Newton step
FORCING = (1e-4, 0.1)  # bounds on the relative tolerance of the linear problem
DIVERGED = 30.0  # ratio of the residual to the smallest residual at which the iteration stops
PATIENCE = 12  # iterations in which the error must halve
SHRINK, GROW = 0.4, 1.7  # factors of the length after a failed and after an easy increment
EASY = 7  # Newton iterations up to which an increment counts as easy
PRESSED = 0.6  # largest increment of :func:`_press`, relative to the largest change of the approach
TOO_FAR = 1.2  # ratio to the largest change of the approach above which an increment is repeated
SMALLEST = 1e-4  # shortest increment, relative to the step of the path
LONGEST = 3.0  # prediction, relative to the last increment
STILL = 1e-6  # relative change of load or approach that counts as zero
MOST = 400  # largest number of increments of a step beyond the fewest
LINEAR = (1_000, 20_000)  # linear iterations allowed in a step: per increment, and in addition


def solve_increment(
    scene: CellScene,
    start: CellState,
    target: Target,
    guess: tuple[np.ndarray, float] | None = None,
    *,
    predicted: tuple[np.ndarray, float] | None = None,
    max_iterations: int = 40,
    tolerance: float = 1e-8,
) -> CellState:
    """Solve a load increment from a state of equilibrium."""
    equations = CellEquations(scene, start, target)
    active, delta = None, start.approach if target.approach is None else target.approach
    if guess is not None:
        active, delta = guess
    # start from the prediction if its residual is smaller than the residual of the last state
    now = None
    if predicted is not None:
        ahead = equations.at(predicted[0], predicted[1] if target.approach is None else delta)
        if ahead.response.least_dilatation > LEAST_DILATATION:
            now = ahead if ahead.error < equations.error_at_start(delta) else None
    if now is None:
        now = equations.at(start.displacement, delta, active)
    run, linear = NewtonRun(Limits(max_iterations, tolerance)), 0
    while run.goes_on(now.error):
        # stop if the error grows, or does not halve any more
        errors = run.residuals
        grown = len(errors) > 5 and errors[-1] > DIVERGED * min(errors)
        late = len(errors) > PATIENCE
        if grown or (late and min(errors[-PATIENCE:]) > 0.5 * min(errors[:-PATIENCE])):
            run.stop(Status.STALLED)
            break
        # solve the linear problem with an accuracy that follows the error, and shorten the step
        forcing = min(FORCING[1], max(FORCING[0], 0.2 * now.error**0.75))
        move, shift, iterations = scene.solver.step(now, forcing, 0.4 * tolerance)
        linear += iterations
        following = _search(equations, now, move, shift)
        if following is None:
            run.stop(Status.STALLED)
            break
        now = following
    load = -float(now.contact_force[:, 2].sum()) - start.load
    return CellState(
        now.u,
        now.delta,
        target.slide,
        now.response.state() if run.converged else start.material,
        now.contact_force,
        now.active,
        now.slipping,
        start.dissipation + now.dissipated,
        run.status,
        tuple(run.residuals),
        linear,
        now.response.flowing,
        max(start.peak, float(np.linalg.norm(now.contact_force))),
        now.u - start.displacement,
        np.array(
            [*(target.slide - start.slide), load, now.delta - start.approach, target.time_step]
        ),
    )


def _search(
    equations: CellEquations, now: Iterate, move: np.ndarray, shift: float
) -> Iterate | None:
    """Shorten a Newton step until no element folds and, if contact is met, the error falls."""
    share, least, best = 1.0, np.inf, 0.0
    for _ in range(HALVINGS):
        trial = equations.at(now.u + share * move, now.delta + share * shift)
        if trial.response.least_dilatation > LEAST_DILATATION:
            if now.opens or trial.error <= (1.0 - 1e-3 * share) * now.error:
                return trial
            if trial.error < least:
                least, best = trial.error, share
        share *= 0.5
    if best == 0.0:
        return None
    # evaluate again, because the tangent belongs to the last evaluated displacement
    return equations.at(now.u + best * move, now.delta + best * shift)


@dataclass(frozen=True, eq=False)
class Walk:
    """Result and cost of a step of the path."""

    state: CellState  # at the end, or the last equilibrium before a failure
    increments: int  # accepted or cut
    newton_iterations: int
    linear_iterations: int
    reached: float  # share of the step that was completed


def walk_step(
    scene: CellScene,
    start: CellState,
    target: Target,
    *,
    increments: int,
    tolerance: float,
    largest_approach: float = np.inf,
) -> Walk:
    """Compute a step of a path in increments."""
    added = 0.0 if target.load in (None, 0.0) else float(target.load or 0.0) - start.load
    # a body flows, and only the load changes
    flows = bool(added and np.isfinite(largest_approach) and np.all(target.slide == start.slide))
    presses = flows and increments == 1 and not start.active.any()
    state, work = start, np.zeros(3, dtype=int)
    reached, length = 0.0, 1.0 / increments
    while reached < 1.0 and not presses:
        if (spent := _spent(work, increments)) is not None:
            state = replace(state, status=spent)
            break
        # try an increment, from a prediction
        share = min(1.0, reached + length)
        share = 1.0 if 1.0 - share < 1e-9 else share
        span = share - reached
        aim = _between(start, target, share, span)
        end = _increment(scene, state, aim, tolerance, _predict(state, aim), work)
        moved = abs(end.approach - state.approach)
        # accept it and lengthen the next increment, or repeat it shorter
        if end.status is Status.CONVERGED and moved <= TOO_FAR * largest_approach:
            state, reached = end, share
            if len(end.residuals) - 1 <= EASY:
                length = min(1.0 / increments, GROW * span)
            if moved > 0.0:
                length = min(length, span * largest_approach / moved)
        elif flows:
            presses = True
        elif end.status is Status.CONVERGED:
            length = span * largest_approach / moved
        else:
            length = SHRINK * span
            if length < SMALLEST:
                state = replace(state, status=end.status)
                break
    # increments of the approach instead of the load
    if presses:
        longest = PRESSED * largest_approach
        state = _press(scene, state, target, longest, tolerance, work, increments)
        carried = (state.load - start.load) / added
        reached = 1.0 if state.status is Status.CONVERGED else carried
    count, newton, linear = map(int, work)
    return Walk(state, count, newton, linear, reached)


def _spent(work: np.ndarray, increments: int) -> Status | None:
    """Return the status if the limit on increments or linear iterations is reached, or None."""
    if work[0] >= increments + MOST:
        return Status.MAX_ITERATIONS
    most = LINEAR[0] * max(increments, work[0]) + LINEAR[1]
    return Status.WORK_SPENT if work[2] >= most else None


def _between(start: CellState, target: Target, share: float, length: float) -> Target:
    """Return the target of an increment of a length that ends at a share of the step."""

    def at(begin: float, end: float | None) -> float | None:
        return None if end is None else begin + share * (end - begin)

    return Target(
        at(start.load, target.load),
        at(start.approach, target.approach),
        start.slide + share * (target.slide - start.slide),
        length * target.time_step,
    )


def _press(
    scene: CellScene,
    state: CellState,
    target: Target,
    longest: float,
    tolerance: float,
    work: np.ndarray,
    increments: int,
) -> CellState:
    """Raise the approach of a flowing body, by ``longest``, m, at most, until it carries a load."""
    load = float(target.load or 0.0)
    sign = 1.0 if load > state.load else -1.0
    length = longest
    while (status := _spent(work, increments)) is None:
        aim = Target(None, state.approach + sign * length, target.slide)
        end = _increment(scene, state, aim, tolerance, _predict(state, aim), work)
        # the load lies within the increment: interpolate, and prescribe the load
        if end.status is Status.CONVERGED and sign * (end.load - load) >= 0.0:
            share = (load - state.load) / (end.load - state.load)
            between = _extrapolate(end, share - 1.0)
            end = _increment(scene, state, target, tolerance, between, work)
            if end.status is Status.CONVERGED:
                return end
        if end.status is Status.CONVERGED:
            state = end
            if len(end.residuals) - 1 <= EASY:
                length = min(longest, GROW * length)
        else:
            length *= SHRINK
            if length < SMALLEST * longest:
                status = end.status
                break
    return replace(state, status=status)


def _predict(state: CellState, aim: Target) -> tuple[np.ndarray, float] | None:
    """Extrapolate the last increment, if the target lies in the same direction."""
    if aim.approach is None:
        added, last, present = float(aim.load or 0.0) - state.load, state.change[2], state.load
    else:
        added, last, present = aim.approach - state.approach, state.change[3], state.approach
    # slide, load or approach, and time: the first of them that changed decides
    changes = (
        (aim.slide - state.slide, state.change[:2], 0.0),
        (np.array([added]), np.array([last]), STILL * abs(present)),
        (np.array([aim.time_step]), state.change[4:], 0.0),
    )
    for now, before, least in changes:
        if np.linalg.norm(before) > least:
            ratio = float(now @ before) / float(before @ before)
            return _extrapolate(state, ratio) if 0.0 < ratio <= LONGEST else None
    return None


def _extrapolate(state: CellState, ratio: float) -> tuple[np.ndarray, float]:
    """Add a multiple of the last increment to displacement, m, and approach, m."""
    assert state.moved is not None
    return state.displacement + ratio * state.moved, state.approach + ratio * state.change[3]


def _increment(
    scene: CellScene,
    state: CellState,
    aim: Target,
    tolerance: float,
    ahead: tuple[np.ndarray, float] | None,
    work: np.ndarray,
) -> CellState:
    """Solve an increment and add its cost to ``work``; without contact, return a free body."""
    guess = None
    if aim.load != 0.0 and not state.active.any():
        guess = _first_touch(scene, state, aim)
    if aim.load == 0.0 or (guess is not None and not guess[0].any()):
        end = _released(scene, state, aim)
    else:
        end = solve_increment(scene, state, aim, guess, predicted=ahead, tolerance=tolerance)
    work += (1, len(end.residuals) - 1, end.linear_iterations)
    logger.debug(
        "load %.3g N, approach %.4g m: %s in %d iterations, %d linear, error %.1e, flowing %.3f",
        end.load,
        end.approach,
        end.status.name,
        len(end.residuals) - 1,
        end.linear_iterations,
        end.residuals[-1],
        end.flowing,
    )
    return end


def _first_touch(
    scene: CellScene, state: CellState, aim: Target
) -> tuple[np.ndarray, float] | None:
    """Estimate contact nodes and approach, m, of a cell without contact."""
    meeting = scene.meet(state.displacement, 0.0, aim.slide)
    gap, closing = meeting.gap, meeting.normal[:, 2]
    if aim.approach is not None:
        return gap - closing * aim.approach < 0.0, aim.approach
    return scene.solver.touch(gap, closing, float(aim.load or 0.0))


def _released(scene: CellScene, state: CellState, aim: Target) -> CellState:
    """Solve for the free body at the target's approach, or at first touch under zero load."""
    reach = float(np.ptp(scene.opposite.body.heights)) + abs(state.approach)
    shape = scene.opposite.shape
    reach += 0.0 if shape is None else float(np.ptp(shape.heights))
    away = replace(aim, load=None, approach=-10.0 * reach)
    free = solve_increment(scene, state, away)
    meeting = scene.meet(free.displacement, 0.0, aim.slide)
    touch = float(np.min(meeting.gap / meeting.normal[:, 2]))
    return replace(
        free, approach=touch if aim.approach is None else aim.approach, change=np.zeros(5)
    )
