"""Semismooth Newton on the assembled problem: default for small problems, and oracle."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array, issparse

from multiscale.convergence import Solution, Status
from multiscale.errors import MultiscaleError
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.line_search import step_length
from multiscale.numerics.newton import Limits, NewtonRun

__all__ = ["solve_interface"]

PATIENCE = 30
"""Iterations without a smaller residual after which the solver gives up."""

FLOOR = 1e-8
"""Stiffness lent to an open interface in a singular tangent, relative to that of the bodies."""

GROWTH, HALVINGS = 100.0, 40
"""Factor by which a step may raise the residual, and how often it is halved to keep to that: along
a step the energy of a law without potential may fall while its forces grow beyond all numbers."""


@np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
def solve_interface(
    stiffness: csr_array | np.ndarray,
    load: np.ndarray,
    jump_operator: csr_array,
    weight: np.ndarray,
    law: InterfaceLaw,
    *,
    start: np.ndarray | None = None,
    state: np.ndarray | None = None,
    max_iterations: int = 100,
    tolerance: float = 1e-10,
    callback: Callable[[int, float], None] | None = None,
) -> Solution:
    r"""Solve linear elastic bodies joined by an interface law.

    Find :math:`u` such that

    .. math::
        K u + B^T (w\, t(B u)) = f,    \tag{1}

    the static problem (4)-(5) of the source with a law in place of the inequality.

    Parameters
    ----------
    stiffness : csr_array or ndarray, shape (n, n)
        :math:`K` of the bodies, N/m, supports already taken out. It may be singular as long as
        the closed interface holds the bodies.
    load : ndarray, shape (n,)
        External force :math:`f`, N.
    jump_operator : csr_array, shape (d * points, n)
        :math:`B`, dimensionless: all normal jumps first, then each tangent. Opening positive.
    weight : ndarray, shape (points,)
        Quadrature weights :math:`w`, m².
    law : InterfaceLaw
        Gives :math:`t` and its tangent, Pa and Pa/m.
    start : ndarray, shape (n,), optional
        First :math:`u`, m; zero if not given.
    state : ndarray, shape (law.n_state, points), optional
        Committed state of the law; zero if not given. It is not changed: commit by
        ``law.respond`` at the solution.
    max_iterations : int
        Iteration limit.
    tolerance : float
        Bound on the norm of (1) relative to ``norm(load)`` (without load: relative to the first
        residual); dimensionless.
    callback : callable, optional
        Called as ``callback(iteration, residual)``.

    Returns
    -------
    Solution
        ``value`` is :math:`u`, shape (n,), m.

    Raises
    ------
    ValueError
        If the shapes do not agree.

    Notes
    -----
    If the law derives from a convex potential, the derivative of the total energy along a
    Newton step decides the length of the step, so that any start converges. A law without
    potential gets full steps where the energy argument fails. Steps that raise the residual a
    hundredfold are halved.
    """
    n, points = stiffness.shape[0], weight.size
    if load.shape != (n,) or jump_operator.shape[1] != n or jump_operator.shape[0] % points:
        raise ValueError(
            f"load ({n},) and jump_operator (d * {points}, {n}) must match stiffness and weight, "
            f"got {load.shape} and {jump_operator.shape}"
        )
    problem = _Problem(stiffness, load, jump_operator, weight, law, state)
    u = np.zeros(n) if start is None else np.array(start, dtype=float)
    residual, tangent = problem.linearise(u)
    scale = float(norm(load)) or float(norm(residual)) or 1.0
    run = NewtonRun(Limits(max_iterations, tolerance, callback), PATIENCE)
    while run.goes_on(float(norm(residual)) / scale):
        direction = problem.direction(residual, tangent)
        if direction is None:
            run.stop(Status.STALLED)
            break
        there = problem.along(u, direction)
        step = step_length(_slope(there, direction), float(direction @ residual))
        for _ in range(HALVINGS):
            ahead, (residual, tangent) = u + step * direction, there(step)
            if float(norm(residual)) / scale <= GROWTH * run.residuals[-1]:
                break
            step *= 0.5
        u = ahead

    return run.solution(u)


@dataclass(frozen=True)
class _Problem:
    """Equation (1)."""

    stiffness: csr_array | np.ndarray
    load: np.ndarray
    jump_operator: csr_array
    weight: np.ndarray
    law: InterfaceLaw
    state: np.ndarray | None

    def linearise(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual K u + B^T (w t) - f, N, and w times the tangent of the law, N/m."""
        jump = (self.jump_operator @ u).reshape(-1, self.weight.size)
        state = self.state
        if state is None:
            state = np.zeros((self.law.n_state, self.weight.size))
        response = self.law.respond(jump, state)
        force = self.jump_operator.T @ (self.weight * response.traction).ravel()
        return self.stiffness @ u + force - self.load, self.weight * response.tangent

    def along(
        self, u: np.ndarray, direction: np.ndarray
    ) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
        """Return what :meth:`linearise` gives after a step, once for the same step in a row."""
        return lru_cache(maxsize=1)(lambda step: self.linearise(u + step * direction))

    def direction(self, residual: np.ndarray, tangent: np.ndarray) -> np.ndarray | None:
        """Newton direction, m; with a floor under the tangent where it is singular."""
        fallback = None
        for floor in (0.0, FLOOR):
            if floor:
                tangent = tangent.copy()
                tangent[0, 0] += floor * self._body_stiffness() * self.weight
            try:
                solve = factorise(self._matrix(tangent), name="the tangent stiffness")
            except MultiscaleError:
                continue
            direction = -solve(residual)
            if direction @ residual < 0.0:
                return direction
            fallback = direction
        return fallback

    def _matrix(self, tangent: np.ndarray) -> csr_array | np.ndarray:
        """Consistent tangent K + B^T (w D) B, N/m."""
        B, points = self.jump_operator, self.weight.size
        i, j, at = np.nonzero(tangent)
        place = (points * i + at, points * j + at)
        weighted = csr_array((tangent[i, j, at], place), shape=(B.shape[0],) * 2)
        matrix = self.stiffness + B.T @ (weighted @ B)
        return csr_array(matrix) if issparse(matrix) else np.asarray(matrix)

    def _body_stiffness(self) -> float:
        """Stiffness of the bodies per area of the interface, Pa/m."""
        touched = abs(self.jump_operator[: self.weight.size]).T @ self.weight
        diagonal = np.abs(self.stiffness.diagonal())
        return float(np.sum(diagonal[touched > 0.0]) / np.sum(touched))


def _slope(
    there: Callable[[float], tuple[np.ndarray, np.ndarray]], direction: np.ndarray
) -> Callable[[float], float]:
    """Return the derivative of the energy along a direction, J, as a function of the step."""
    return lambda step: float(direction @ there(step)[0])
