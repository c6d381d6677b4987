r"""Equilibrium of a condensed joint under one load.

The equations are those of :func:`~multiscale.macro.joint.joint_solver.rough_joint`:

.. math::
    j &= R w + C \lambda, \tag{1} \\
    \lambda &= N^T (\omega\, p(N j)), \tag{2} \\
    R^T \lambda &= \ell P. \tag{3}
"""

from functools import partial

import numpy as np

from multiscale.convergence import Solution, Status
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.joint.joint_assembly import CondensedJoint
from multiscale.numerics.line_search import step_length
from multiscale.numerics.newton import Limits, NewtonRun

__all__ = ["respond", "solve_preload", "tangent_stiffness"]

PATIENCE = 30
"""Iterations without a smaller residual after which a load step gives up."""

RAMP = 4.0 ** np.arange(-14, 1)
"""Shares of the preload that are tried in turn if one step does not reach it."""

FLOOR = 1e-8
"""Stiffness lent to an open joint in a singular tangent, relative to that of the blocks."""


def solve_preload(
    model: CondensedJoint,
    law: InterfaceLaw,
    preload: float,
    start: np.ndarray | None,
    limits: Limits,
) -> Solution:
    """Solve in one step, or through smaller loads, where a law is softer, if that fails."""
    solution = _solve_step(model, law, preload, start, limits)
    if solution.converged:
        return solution
    start = None
    for share in RAMP:
        solution = _solve_step(model, law, share * preload, start, limits)
        start = solution.value if solution.converged else start
    return solution


@np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
def _solve_step(
    model: CondensedJoint,
    law: InterfaceLaw,
    preload: float,
    start: np.ndarray | None,
    limits: Limits,
) -> Solution:
    """Newton on (1)-(3), the energy judging each step; the value is (j, w, lambda)."""
    n = model.motion.shape[0]
    load = preload * model.area
    value = _uniform_guess(model, law, preload) if start is None else start
    force, tangent = _contact_force(model, law, value[:n])
    run = NewtonRun(limits, PATIENCE)
    while run.goes_on(_residual(model, value, force, load)):
        direction = _direction(model, value, force, tangent, load)
        if direction is None:
            run.stop(Status.STALLED)
            break
        first = _work(model, value, force, direction, load)
        slope = partial(_slope, model, law, value, direction, load)
        value = value + step_length(slope, first) * direction
        force, tangent = _contact_force(model, law, value[:n])

    return run.solution(value)


def _contact_force(
    model: CondensedJoint, law: InterfaceLaw, jump: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nodal force (2), N, and the stiffness of the law at the points times weight, N/m."""
    pressure, stiffness = respond(law, model.operator @ jump)
    return model.operator.T @ (model.weight * pressure), model.weight * stiffness


def respond(law: InterfaceLaw, normal_jump: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pressure (Pa) and stiffness (Pa/m) of the law for normal jumps, m."""
    jump = np.zeros((3, normal_jump.size))
    jump[0] = normal_jump
    response = law.respond(jump, np.zeros((law.n_state, normal_jump.size)))
    return -response.traction[0], response.tangent[0, 0]


def _direction(
    model: CondensedJoint, value: np.ndarray, force: np.ndarray, tangent: np.ndarray, load: float
) -> np.ndarray | None:
    """Newton direction of (1)-(3); with a floor under the tangent where it is singular."""
    j, w, contact = model.split(value)
    floor = FLOOR * model.solid_stiffness * model.weight
    for added in (0.0, floor):
        K = _interface_matrix(model, tangent + added)
        rhs = np.concatenate(
            [
                model.compliance @ force - j,  # (1) with the new force (2)
                load * model.arm - model.motion.T @ force,  # (3)
            ]
        )
        solution = _solve_tangent(model, K, rhs)
        if solution is None:
            continue
        jump_step, w_new = np.split(solution, [j.size])
        direction = np.concatenate([jump_step, w_new - w, force - K @ jump_step - contact])
        if _work(model, value, force, direction, load) < 0.0 or added is floor:
            return direction
    return None


def _interface_matrix(model: CondensedJoint, tangent: np.ndarray) -> np.ndarray:
    """Tangent of the interface on nodal jumps, N/m."""
    return np.asarray(model.operator.T @ (tangent[:, None] * model.operator))


def _solve_tangent(model: CondensedJoint, K: np.ndarray, rhs: np.ndarray) -> np.ndarray | None:
    """Solve for the change of the jump and the new motion; None if the joint is loose."""
    n, m = model.motion.shape
    reaction = -model.motion.T @ K
    scale = 1.0 / (np.abs(reaction).max() or 1.0)  # so that all rows are in metres
    matrix = np.block(
        [
            [np.eye(n) + model.compliance @ K, -model.motion],
            [scale * reaction, np.zeros((m, m))],
        ]
    )
    if not np.all(np.isfinite(matrix)):
        return None
    try:
        solution = np.linalg.solve(matrix, np.concatenate([rhs[:n], scale * rhs[n:]]))
    except np.linalg.LinAlgError:
        return None
    return solution if np.all(np.isfinite(solution)) else None


def _work(
    model: CondensedJoint, value: np.ndarray, force: np.ndarray, direction: np.ndarray, load: float
) -> float:
    """Differentiate the total energy along a direction that respects (1), J."""
    _, _, contact = model.split(value)
    jump_step, w_step, _ = model.split(direction)
    unbalanced = load * model.arm - model.motion.T @ contact
    return float(jump_step @ (contact - force) + w_step @ unbalanced)


def _slope(
    model: CondensedJoint,
    law: InterfaceLaw,
    value: np.ndarray,
    direction: np.ndarray,
    load: float,
    step: float,
) -> float:
    """Differentiate the total energy at a step along a direction, J."""
    trial = value + step * direction
    force, _ = _contact_force(model, law, model.split(trial)[0])
    return _work(model, trial, force, direction, load)


def _residual(model: CondensedJoint, value: np.ndarray, force: np.ndarray, load: float) -> float:
    """Largest fault in (1), relative to its terms, and in (2) and (3), relative to the load."""
    j, w, contact = model.split(value)
    rigid, elastic = model.motion @ w, model.compliance @ contact
    scale = max(np.abs(j).max(), np.abs(rigid).max(), np.abs(elastic).max()) or 1.0
    compatibility = np.abs(j - rigid - elastic).max() / scale  # (1)
    law = np.abs(contact - force).sum() / load  # (2)
    balance = np.abs(model.motion.T @ contact - load * model.arm).max() / load  # (3)
    return float(max(compatibility, law, balance))


def _uniform_guess(model: CondensedJoint, law: InterfaceLaw, preload: float) -> np.ndarray:
    """Start from a uniform pressure: the jump that the law gives it, and (1)."""
    scale = preload / model.solid_stiffness

    def excess(jump: float) -> float:
        return float(respond(law, np.array([jump]))[0][0]) - preload

    first = excess(0.0)
    if first < 0.0:
        jump = -scale * step_length(lambda step: excess(-step * scale), first)
    else:
        jump = scale * step_length(lambda step: -excess(step * scale), -first)
    contact = model.operator.T @ (model.weight * preload)
    elastic = model.compliance @ contact
    w = np.linalg.lstsq(model.motion, jump - elastic)[0]
    return np.concatenate([model.motion @ w + elastic, w, contact])


def tangent_stiffness(
    model: CondensedJoint, law: InterfaceLaw, value: np.ndarray, ratio: float = 1.0
) -> float:
    """Consistent linearisation of (1)-(3): change of pressure over change of approach, Pa/m.

    The stiffness of the law is multiplied by a ratio: that of unloading over loading, for a
    preload that begins to fall.
    """
    j, _, _ = model.split(value)
    K = _interface_matrix(model, ratio * _contact_force(model, law, j)[1])
    change = _solve_tangent(model, K, np.concatenate([np.zeros(j.size), model.arm]))
    if change is None:
        return float("nan")
    return 1.0 / (-model.area * float(model.arm @ change[j.size :]))
