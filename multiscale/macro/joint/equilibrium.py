"""Equilibrium of a condensed joint under one load, (1)-(3) of :func:`.joint_solver.rough_joint`."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from multiscale.convergence import Solution, Status
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.interface_newton import FLOOR, PATIENCE
from multiscale.macro.joint.joint_assembly import CondensedJoint
from multiscale.numerics.line_search import step_length
from multiscale.numerics.newton import Limits, NewtonRun

__all__ = ["respond", "solve_preload", "tangent_stiffness"]

RAMP = 4.0 ** np.arange(-14, 1)
"""Shares of the preload that are tried in turn if one step does not reach it."""


def solve_preload(
    model: CondensedJoint,
    law: InterfaceLaw,
    preload: float,
    start: np.ndarray | None,
    limits: Limits,
) -> Solution:
    """Solve (1)-(3) in one step, or through smaller loads, where a law is softer, if that fails.

    The value is (j, w, lambda).
    """

    def solve(preload: float, start: np.ndarray | None) -> Solution:
        first = _uniform_guess(model, law, preload) if start is None else start
        return _find_equilibrium(_Pressed(model, law, preload * model.area), first, limits)

    solution = solve(preload, start)
    if solution.converged:
        return solution
    start = None
    for share in RAMP:
        solution = solve(share * preload, start)
        start = solution.value if solution.converged else start
    return solution


@dataclass(frozen=True, eq=False)
class _Iterate:
    """Equations (1)-(3) at a value (j, w, lambda): their imbalance, the force (2), its tangent."""

    value: np.ndarray
    gradient: np.ndarray
    force: np.ndarray
    tangent: np.ndarray


@dataclass(frozen=True, eq=False)
class _Pressed:
    """Equations (1)-(3) under a load, N.

    The energy belongs to directions that respect (1): its gradient has no part of lambda.
    """

    model: CondensedJoint
    law: InterfaceLaw
    load: float

    def linearise(self, value: np.ndarray) -> _Iterate:
        """Nodal force (2), N, and the stiffness of the law at the points times weight, N/m."""
        model = self.model
        j, _, contact = model.split(value)
        pressure, stiffness = respond(self.law, model.operator @ j)
        force = model.operator.T @ (model.weight * pressure)
        unbalanced = self.load * model.arm - model.motion.T @ contact
        gradient = np.concatenate([contact - force, unbalanced, np.zeros(j.size)])
        return _Iterate(value, gradient, force, model.weight * stiffness)

    def residual(self, here: _Iterate) -> float:
        """Largest fault in (1), relative to its terms, and in (2) and (3), relative to the load."""
        j, w, contact = self.model.split(here.value)
        fault, unbalanced, _ = self.model.split(here.gradient)
        rigid, elastic = self.model.motion @ w, self.model.compliance @ contact
        scale = max(np.abs(j).max(), np.abs(rigid).max(), np.abs(elastic).max()) or 1.0
        compatibility = np.abs(j - rigid - elastic).max() / scale  # (1)
        law, balance = np.abs(fault).sum() / self.load, np.abs(unbalanced).max() / self.load
        return float(max(compatibility, law, balance))

    def direction(self, here: _Iterate) -> np.ndarray | None:
        """Newton direction, with a floor under the tangent where it is singular or leads up."""
        found = None
        for floor in (0.0, FLOOR):
            direction = self._solve(here, floor)
            if direction is not None and direction @ here.gradient < 0.0:
                return direction
            found = found if direction is None else direction
        return found

    def search(self, here: _Iterate, way: np.ndarray) -> _Iterate:
        """Go along a direction to the least energy."""
        there = lru_cache(maxsize=1)(lambda step: self.linearise(here.value + step * way))
        first = float(way @ here.gradient)
        return there(step_length(lambda step: float(way @ there(step).gradient), first))

    def _solve(self, here: _Iterate, floor: float) -> np.ndarray | None:
        """Newton direction of (1)-(3), the tangent raised by a share of the bodies' stiffness."""
        model = self.model
        j, w, contact = model.split(here.value)
        K = _interface_matrix(model, here.tangent + floor * model.solid_stiffness * model.weight)
        rhs = np.concatenate(
            [
                model.compliance @ here.force - j,  # (1) with the new force (2)
                self.load * model.arm - model.motion.T @ here.force,  # (3)
            ]
        )
        solution = _solve_tangent(model, K, rhs)
        if solution is None:
            return None
        jump_step, w_new = np.split(solution, [j.size])
        return np.concatenate([jump_step, w_new - w, here.force - K @ jump_step - contact])


@np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
def _find_equilibrium(equations: _Pressed, start: np.ndarray, limits: Limits) -> Solution:
    """Solve (1)-(3) from any start: the energy, which is convex, tells the length of each step."""
    here, run = equations.linearise(start), NewtonRun(limits, PATIENCE)
    while run.goes_on(equations.residual(here)):
        direction = equations.direction(here)
        if direction is None:
            run.stop(Status.STALLED)
            break
        here = equations.search(here, direction)
    return run.solution(here.value)


def respond(law: InterfaceLaw, normal_jump: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pressure (Pa) and stiffness (Pa/m) of the law for normal jumps, m."""
    jump = np.zeros((3, normal_jump.size))
    jump[0] = normal_jump
    response = law.respond(jump, np.zeros((law.n_state, normal_jump.size)))
    return -response.traction[0], response.tangent[0, 0]


def _interface_matrix(model: CondensedJoint, tangent: np.ndarray) -> np.ndarray:
    """Tangent of the interface on nodal jumps, N/m."""
    return np.asarray(model.operator.T @ (tangent[:, None] * model.operator))


def _solve_tangent(model: CondensedJoint, K: np.ndarray, rhs: np.ndarray) -> np.ndarray | None:
    """Solve for the change of the jump and the new motion; None if the joint is loose."""
    n, m = model.motion.shape
    reaction = -model.motion.T @ K
    scale = 1.0 / (np.abs(reaction).max() or 1.0)  # so that all rows are in metres
    matrix = np.block(
        [[np.eye(n) + model.compliance @ K, -model.motion], [scale * reaction, np.zeros((m, m))]]
    )
    if not np.all(np.isfinite(matrix)):
        return None
    try:
        solution = np.linalg.solve(matrix, np.concatenate([rhs[:n], scale * rhs[n:]]))
    except np.linalg.LinAlgError:
        return None
    return solution if np.all(np.isfinite(solution)) else None


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

    The stiffness of the law is multiplied by a ratio: unloading over loading, for a
    preload that begins to fall.
    """
    j, _, _ = model.split(value)
    stiffness = model.weight * respond(law, model.operator @ j)[1]
    K = _interface_matrix(model, ratio * stiffness)
    change = _solve_tangent(model, K, np.concatenate([np.zeros(j.size), model.arm]))
    if change is None:
        return float("nan")
    return 1.0 / (-model.area * float(model.arm @ change[j.size :]))
