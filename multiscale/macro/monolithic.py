"""Semismooth Newton on the assembled problem: default for small problems, and oracle."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array, issparse

from multiscale.convergence import Solution, Status
from multiscale.errors import MultiscaleError
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.interface_newton import (
    FLOOR,
    GROWTH,
    PATIENCE,
    ROUNDS,
    face_stiffness,
    go_on_along_law,
    soften,
    tangent_traction,
)
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.line_search import enough, step_length
from multiscale.numerics.newton import Limits, NewtonRun

__all__ = ["InterfaceSolution", "solve_interface"]

UNSURE = 1e-8
"""Largest residual that rounding excuses."""


@dataclass(frozen=True)
class InterfaceSolution(Solution):
    """Displacement of bodies, and the jumps of their interface.

    Attributes
    ----------
    jump : ndarray, shape (d, points)
        m. It is summed up over the steps, because the difference of both sides rounds: on a law a
        million times as stiff as the bodies, a rounding of displacements is 1e-10 of the traction.
    """

    jump: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


def solve_interface(
    stiffness: csr_array | np.ndarray,
    load: np.ndarray,
    jump_operator: csr_array,
    weight: np.ndarray,
    law: InterfaceLaw,
    *,
    start: np.ndarray | None = None,
    jump: np.ndarray | None = None,
    state: np.ndarray | None = None,
    max_iterations: int = 100,
    tolerance: float = 1e-10,
    callback: Callable[[int, float], None] | None = None,
) -> InterfaceSolution:
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
    jump : ndarray, shape (d, points), optional
        Jump of an earlier solution at the start, m; :math:`B u` if not given.
    state : ndarray, shape (law.n_state, points), optional
        Committed state of the law; zero if not given. It is not changed: commit by
        ``law.respond`` at the solution.
    max_iterations : int
        Iteration limit.
    tolerance : float
        Bound on the norm of (1) relative to ``norm(load)`` (without load: relative to the first
        residual); dimensionless. What rounding makes unavoidable is allowed for, up to 1e-8.
    callback : callable, optional
        Called as ``callback(iteration, residual)``.

    Returns
    -------
    InterfaceSolution
        ``value`` is :math:`u`, shape (n,), m; ``jump`` tells the traction of the law.

    Raises
    ------
    ValueError
        If the shapes do not agree.

    Notes
    -----
    A Newton step that lowers the derivative of the energy along it is taken as it is. After any
    other the law goes on from a jump of its own, (1) of :mod:`multiscale.macro.interface_newton`,
    which laws without energy and laws of any stiffness allow; the residual is that of the traction
    there. The energy tells the length of the
    step, from the iterate of the smallest residual, where a small stiffness holds bodies that an
    open interface leaves loose, where the residual explodes, and where it has not fallen for some
    steps.
    """
    n, points = stiffness.shape[0], weight.size
    if load.shape != (n,) or jump_operator.shape[1] != n or jump_operator.shape[0] % points:
        raise ValueError(
            f"load ({n},) and jump_operator (d * {points}, {n}) must match stiffness and weight, "
            f"got {load.shape} and {jump_operator.shape}"
        )
    u = np.zeros(n) if start is None else np.array(start, dtype=float)
    state = np.zeros((law.n_state, points)) if state is None else state
    jump = (jump_operator @ u).reshape(-1, points) if jump is None else jump
    resistance = face_stiffness(stiffness.diagonal(), jump_operator[:points], weight)
    whole = _Whole(stiffness, load, jump_operator, weight, law, state, resistance)
    scale = float(norm(load)) or float(norm(whole.linearise(u, jump).gradient)) or 1.0
    run = NewtonRun(Limits(max_iterations, tolerance, callback), PATIENCE)
    whole = replace(whole, scale=scale)
    return _iterate(whole, whole.linearise(u, jump), run)


@np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
def _iterate(whole: "_Whole", here: "_Tangent", run: NewtonRun) -> InterfaceSolution:
    """Newton's method from a start; see :func:`solve_interface`."""
    closest = here
    while run.goes_on(whole.residual(here), whole.rounding(here)):
        if here.at is here.jump and not run.since_best:
            closest = here
        direction = whole.direction(here)
        if direction is None and here.at is not here.jump:
            direction = whole.direction(here, FLOOR)
        there = None if direction is None else whole.step(here, direction)
        explodes = there is None or not whole.residual(there) <= GROWTH * run.residuals[-1]
        if there is None or explodes or run.since_best > ROUNDS:
            # from a jump of its own, the law would mislead the search
            direction = whole.direction(closest)
            if direction is None:
                direction = whole.direction(closest, FLOOR)
            if direction is None:
                run.stop(Status.STALLED)
                break
            there = closest = whole.search(closest, direction)
        here = there
    return InterfaceSolution(
        here.value, run.status, tuple(run.residuals), tuple(run.seconds), jump=here.at
    )


@dataclass(frozen=True, eq=False)
class _Tangent:
    """Bodies at some unknowns, with the tangent of the law at a jump that need not be theirs.

    Attributes
    ----------
    value, gradient : ndarray, shape (n,)
        Unknowns, m, and forces out of balance with the tangent, N.
    jump, at : ndarray, shape (d, points)
        Jump of the bodies, and jump on the law, m.
    tangent : ndarray, shape (d, d, points)
        Tangent of the law, times the weights of the points, N/m.
    imbalance : float
        Norm of the forces out of balance with the traction of the law, N.
    softened : bool
        Whether the law is stiffer than its tangent somewhere, so that it must go on.
    """

    value: np.ndarray
    gradient: np.ndarray
    jump: np.ndarray
    at: np.ndarray
    tangent: np.ndarray
    imbalance: float
    softened: bool


@dataclass(frozen=True, eq=False)
class _Whole:
    """Equation (1), the stiffness of the bodies per area, Pa/m, and the size of the forces, N."""

    stiffness: csr_array | np.ndarray
    load: np.ndarray
    jump_operator: csr_array
    weight: np.ndarray
    law: InterfaceLaw
    state: np.ndarray
    resistance: float
    scale: float = 1.0

    def linearise(self, u: np.ndarray, jump: np.ndarray, at: np.ndarray | None = None) -> _Tangent:
        """Evaluate the law and the imbalance K u + B^T (w t) - f, N.

        The law is taken at the jump of the bodies if no other jump is given, and t is the traction
        of the tangent there.
        """
        at = jump if at is None else at
        own = self.law.respond(at, self.state)
        response = soften(own, self.resistance)
        inner = self.stiffness @ u - self.load
        traction = tangent_traction(response, at, jump)
        gradient, fault = (
            inner + self.jump_operator.T @ (self.weight * one).ravel()
            for one in (traction, response.traction)
        )
        tangent = self.weight * response.tangent
        return _Tangent(u, gradient, jump, at, tangent, float(norm(fault)), response is not own)

    def step(self, here: _Tangent, direction: np.ndarray) -> _Tangent:
        """Take a whole step, after which the law may go on from a jump of its own."""
        there = self.move(here, 1.0, direction)
        first, last = (float(direction @ one.gradient) for one in (here, there))
        if enough(first, last) and not here.softened:
            return there
        return self.go_on(here, there)

    def move(self, here: _Tangent, step: float, direction: np.ndarray) -> _Tangent:
        """Take a step of the bodies, m."""
        opened = (self.jump_operator @ direction).reshape(here.jump.shape)
        return self.linearise(here.value + step * direction, here.jump + step * opened)

    def search(self, here: _Tangent, direction: np.ndarray) -> _Tangent:
        """Take the step to the least energy."""

        def slope(step: float) -> float:
            return float(direction @ self.move(here, step, direction).gradient)

        step = step_length(slope, float(direction @ here.gradient))
        return self.move(here, step, direction)

    def go_on(self, tangent: _Tangent, here: _Tangent) -> _Tangent:
        """Let the law go on from the tangent with which the bodies have come here."""
        if not self.resistance:  # nothing resists but the law
            return here
        at = go_on_along_law(self.law, tangent.at, here.jump, self.resistance, self.state)
        return self.linearise(here.value, here.jump, at)

    def residual(self, here: _Tangent) -> float:
        """Norm of (1) relative to the load."""
        return here.imbalance / self.scale

    def rounding(self, here: _Tangent) -> float:
        """Norm that rounding makes unavoidable where bodies move far on a soft law, like (1)."""
        size = float(norm(abs(self.stiffness) @ np.abs(here.value)))
        return min(8.0 * np.finfo(float).eps * size / self.scale, UNSURE)

    def direction(self, here: _Tangent, floor: float = 0.0) -> np.ndarray | None:
        """Newton direction, m; None if the tangent is singular."""
        B, points, tangent = self.jump_operator, self.weight.size, here.tangent
        if floor:
            tangent = tangent.copy()
            for row in range(len(tangent)):
                tangent[row, row] += floor * self.resistance * self.weight
        i, j, at = np.nonzero(tangent)
        place = (points * i + at, points * j + at)
        weighted = csr_array((tangent[i, j, at], place), shape=(B.shape[0],) * 2)
        matrix = self.stiffness + B.T @ (weighted @ B)  # K + B^T (w D) B
        matrix = csr_array(matrix) if issparse(matrix) else np.asarray(matrix)
        with suppress(MultiscaleError):
            return -factorise(matrix, name="the tangent stiffness")(here.gradient)
        return None
