"""Newton's iteration over one load increment."""

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.finite.equations import CellEquations, Iterate
from multiscale.micro.finite.scene import CellScene, CellState
from multiscale.micro.path import Target
from multiscale.numerics.newton import Limits, NewtonRun

__all__ = ["solve_increment"]

LEAST_DILATATION = 0.05  # smallest det F of an accepted iterate
HALVINGS = 7  # of a Newton step
FORCING = (1e-4, 0.1)  # bounds on the relative tolerance of the linear problem
DIVERGED = 30.0  # ratio of the residual to the smallest one at which the iteration stops
PATIENCE = 12  # iterations in which the error has to halve


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
    """Solve one load increment from a state of equilibrium."""
    step = scene.body.begin(start.material, target.time_step)
    equations = CellEquations(scene, step, start, target)
    active, delta = None, start.approach if target.approach is None else target.approach
    if guess is not None:
        active, delta = guess
    now = None
    if predicted is not None:
        ahead = equations.at(predicted[0], predicted[1] if target.approach is None else delta)
        if ahead.response.least_dilatation > LEAST_DILATATION:
            now = ahead if ahead.error < equations.error_at_start(delta) else None
    if now is None:
        now = equations.at(start.displacement, delta, active)
    run, linear = NewtonRun(Limits(max_iterations, tolerance)), 0
    while run.goes_on(now.error):
        errors = run.residuals
        grown = len(errors) > 5 and errors[-1] > DIVERGED * min(errors)
        late = len(errors) > PATIENCE
        if grown or (late and min(errors[-PATIENCE:]) > 0.5 * min(errors[:-PATIENCE])):
            run.stop(Status.STALLED)
            break
        forcing = min(FORCING[1], max(FORCING[0], 0.2 * now.error**0.75))
        move, shift, iterations = scene.newton_step(now, forcing, 0.4 * tolerance)
        linear += iterations
        found = _search(equations, now, move, shift)
        if found is None:
            run.stop(Status.STALLED)
            break
        now = found
    load = -float(now.contact_force[:, 2].sum()) - start.load
    return CellState(
        now.u,
        now.delta,
        target.slide,
        step.finish(now.u) if run.converged else start.material,
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
        found = equations.at(now.u + share * move, now.delta + share * shift)
        if found.response.least_dilatation > LEAST_DILATATION:
            if now.opens or found.error <= (1.0 - 1e-3 * share) * now.error:
                return found
            if found.error < least:
                least, best = found.error, share
        share *= 0.5
    if best == 0.0:
        return None
    # evaluate again, because the tangent belongs to the last evaluated displacement
    return equations.at(now.u + best * move, now.delta + best * shift)
