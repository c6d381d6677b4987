"""Semismooth Newton on the assembled problem: default for small problems, and oracle."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array, diags_array, issparse

from multiscale.convergence import Solution, Status, check_limits
from multiscale.errors import MultiscaleError
from multiscale.fe.condensation import compliances
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.interface_newton import (
    FLOOR,
    GROWTH,
    PATIENCE,
    ROUNDS,
    face_stiffness,
    go_on_along_law,
    soften_tangent,
    tangent_traction,
)
from multiscale.numerics.factorisation import Solve, factorise
from multiscale.numerics.line_search import enough, step_length
from multiscale.numerics.newton import Limits, NewtonRun

__all__ = ["FlexibleBodies", "InterfaceSolution", "prepare_flexible", "solve_interface"]

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
    flexible: "PreparedBodies | None" = None,
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
    load : ndarray, shape (n,), external force :math:`f`, N
    jump_operator : csr_array, shape (d * points, n)
        :math:`B`, dimensionless: all normal jumps first, then each tangent. Opening positive.
    weight : ndarray, shape (points,), quadrature weights :math:`w`, m²
    law : InterfaceLaw, gives :math:`t` and its tangent, Pa and Pa/m
    start : ndarray, shape (n,), optional, first :math:`u`, m; zero if not given
    jump : ndarray, shape (d, points), optional
        Jump of an earlier solution at the start, m; :math:`B u` if not given.
    state : ndarray, shape (law.n_state, points), optional
        Committed state of the law; zero if not given. It is not changed: commit by
        ``law.respond`` at the solution.
    flexible : PreparedBodies, optional
        Of the same full matrices, for many laws and loads; see :func:`prepare_flexible`.
    max_iterations : int, iteration limit
    tolerance : float
        Bound on the norm of (1) relative to ``norm(load)`` (without load: relative to the first
        residual); dimensionless. What rounding makes unavoidable is allowed for, up to 1e-8.
    callback : callable, optional, called as ``callback(iteration, residual)``

    Returns
    -------
    InterfaceSolution, ``value`` is :math:`u`, shape (n,), m; ``jump`` tells the traction of the law

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
    check_limits(tolerance, max_iterations)
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
    whole = _Whole(stiffness, load, jump_operator, weight, law, state, resistance, flexible)
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
    jump, at : ndarray, shape (d, points), jump of the bodies, and jump on the law, m
    tangent : ndarray, shape (d, d, points)
        Tangent of the law, times the weights of the points, N/m.
    imbalance : float, norm of the forces out of balance with the traction of the law, N
    softened : bool, whether the law is stiffer than its tangent somewhere, so that it must go on
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
    """Equation (1), the stiffness of the bodies per area, Pa/m, and the size of the forces, N.

    Bodies that are prepared tell the direction of tangents that are not softened.
    """

    stiffness: csr_array | np.ndarray
    load: np.ndarray
    jump_operator: csr_array
    weight: np.ndarray
    law: InterfaceLaw
    state: np.ndarray
    resistance: float
    prepared: "PreparedBodies | None" = None
    scale: float = 1.0

    def linearise(self, u: np.ndarray, jump: np.ndarray, at: np.ndarray | None = None) -> _Tangent:
        """Evaluate the law and the imbalance K u + B^T (w t) - f, N.

        The law is taken at the jump of the bodies if no other jump is given, and t is the traction
        of the tangent there.
        """
        at = jump if at is None else at
        own = self.law.respond(at, self.state)
        response = soften_tangent(own, self.resistance)
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
        size = float(norm(self.size @ np.abs(here.value)))
        return min(8.0 * np.finfo(float).eps * size / self.scale, UNSURE)

    @cached_property
    def size(self) -> csr_array | np.ndarray:
        """Magnitudes of the entries of the stiffness, N/m."""
        return abs(self.stiffness)

    def direction(self, here: _Tangent, floor: float = 0.0) -> np.ndarray | None:
        """Newton direction, m; None if the tangent is singular."""
        B, points, tangent = self.jump_operator, self.weight.size, here.tangent
        if floor:
            tangent = tangent.copy()
            for row in range(len(tangent)):
                tangent[row, row] += floor * self.resistance * self.weight
        if self.prepared is not None and not here.softened:
            with suppress(MultiscaleError):
                return self.prepared.direction(B, tangent, -here.gradient)
        i, j, at = np.nonzero(tangent)
        place = (points * i + at, points * j + at)
        weighted = csr_array((tangent[i, j, at], place), shape=(B.shape[0],) * 2)
        matrix = self.stiffness + B.T @ (weighted @ B)  # K + B^T (w D) B
        matrix = csr_array(matrix) if issparse(matrix) else np.asarray(matrix)
        with suppress(MultiscaleError):
            return -factorise(matrix, name="the tangent stiffness")(here.gradient)
        return None


class PreparedBodies(Protocol):
    """Bodies that find Newton directions by a method of their own."""

    def direction(self, B: csr_array, tangent: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Newton direction, m, from the tangent, shape (d, d, points), N/m, and forces, N."""


@dataclass(frozen=True, eq=False)
class FlexibleBodies:
    r"""Bodies held by springs on their interface, whose jumps are the unknowns of a Newton step.

    With the stiffness :math:`\bar K = K + B^T R B` of the bodies and springs :math:`R`, and the
    compliance :math:`C = B \bar K^{-1} B^T`, a direction of the unknowns u and the jumps j is

    .. math::
        (I + C (w D - R))\, j = B \bar K^{-1} r, \qquad u = \bar K^{-1} (r - B^T (w D - R) j),
        \tag{1}

    with the forces out of balance :math:`r`. However stiff the law is, no stiffness of the bodies
    is lost beside it, and the matrix has half the size of :math:`K`.
    """

    solve: Solve
    springs: np.ndarray
    compliance: np.ndarray

    def direction(self, B: csr_array, tangent: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Newton direction (1), m, from the tangent, shape (d, d, points), N/m."""
        change, springs = tangent.copy(), self.springs.reshape(len(tangent), -1)
        for row, spring in enumerate(springs):
            change[row, row] -= spring
        size = 1.0 + np.abs(change).max(axis=0) / springs  # where laws are stiff
        change /= size
        C = self.compliance.reshape(self.springs.size, *springs.shape)
        product = np.zeros(C.shape)
        for row in range(len(tangent)):
            for column in range(len(tangent)):
                product[:, column] += C[:, row] * change[row, column]
        matrix = product.reshape(self.compliance.shape)
        matrix[np.diag_indices(self.springs.size)] += 1.0 / size.ravel()
        solve = factorise(matrix, name="the tangent compliance")
        opened = solve(B @ self.solve(force)).reshape(springs.shape)
        moved = np.einsum("ijp,jp->ip", change, opened).ravel()
        return self.solve(force - B.T @ moved)


def prepare_flexible(
    stiffness: np.ndarray, jump_operator: csr_array, weight: np.ndarray
) -> FlexibleBodies | None:
    """Condense bodies of full matrices onto their interface; None if springs do not hold them.

    Parameters are those of :func:`solve_interface`.
    """
    resistance = face_stiffness(stiffness.diagonal(), jump_operator[: weight.size], weight)
    if not resistance:
        return None
    springs = np.tile(resistance * weight, jump_operator.shape[0] // weight.size)
    held = np.asarray(stiffness + jump_operator.T @ (diags_array(springs) @ jump_operator))
    with suppress(MultiscaleError):
        solve = factorise(held, name="the held bodies")
        return FlexibleBodies(solve, springs, compliances(solve, jump_operator)[0])
    return None
