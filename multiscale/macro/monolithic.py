r"""Newton's method for elastic bodies joined by an interface law.

Where line searches would take tiny steps, the bodies take the full step, and the law is linearised
at the next :math:`y` on the law, from the traction :math:`t^*` of its tangent at the jump
:math:`y_0` and the new jump :math:`j` of the bodies, along the stiffness k of the bodies: the local
stage of LATIN.

.. math:: t(y) + k y = t^* + k j, \qquad t^* = t(y_0) + D(y_0) (j - y_0).    \tag{1}
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array, issparse

from multiscale.convergence import Solution, Status, check_limits
from multiscale.errors import ConvergenceError, MultiscaleError
from multiscale.fe.multigrid import joint_matrix
from multiscale.laws.interface_law import InterfaceLaw, Response
from multiscale.macro.flexible_bodies import SOFT, FlexibleBodies, prepare_flexible
from multiscale.numerics.factorisation import Solve, factorise
from multiscale.numerics.newton import Limits, NewtonRun, enough, join_solutions, step_length

PATIENCE = 30  # iterations without a smaller residual after which the solver stops

FLOOR = 1e-8
"""Stiffness lent to an open or frictionless interface in a singular tangent, relative to the
stiffness of the bodies."""

STIFFEST = 1e8
"""Stiffness of a tangent over the stiffness of the bodies, above which a spring in series softens
it: next to a stiffer tangent, the stiffness of the bodies would be rounded away."""

GROWTH, ROUNDS = 1e4, 8
"""Factor of the residual above which a full step has left the range of the tangent, and steps
without a smaller residual after which the iteration may cycle: a line search follows."""

ATTEMPTS = ((2.8, 1), (1.0, 1), (1.0, 4))
"""Factors of the stiffness of the bodies at a point, and parts in which the load rises, until
Newton's method converges; the state of the laws is that before the step throughout."""

HALVINGS = 6  # limit of reductions of a step of the law and the bodies together
SHARE = 0.1  # sufficient decrease of the residual along a step, relative to a full decrease

UNSURE = 1e-8
"""Largest residual ascribed to rounding: without a limit, a body that moves away would count as in
equilibrium."""

FEW, FULL = 2000, 0.1
"""A matrix is stored as a dense matrix up to this number of unknowns, or above this share of
nonzero entries."""

NO_LINKS, NO_JOINT = np.zeros(0), np.zeros((3, 3, 0))


@dataclass(frozen=True)
class InterfaceSolution(Solution):
    """Displacement of bodies, and the jump of their interface, m, summed over the steps."""

    jump: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))  # (d, points), m


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
        :math:`K` of the bodies, N/m, supports already eliminated. It may be singular as long as
        the closed interface supports the bodies.
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
    max_iterations : int, iteration limit; a load that stalls has this many in each further attempt
    tolerance : float
        Bound on the norm of (1) relative to ``norm(load)`` (without load: relative to the first
        residual); dimensionless. Rounding may raise it up to 1e-8.
    callback : callable, optional, called as ``callback(iteration, residual)``

    Returns
    -------
    InterfaceSolution, ``value`` is :math:`u`, shape (n,), m; the law is evaluated at ``jump``

    Raises
    ------
    ValueError
        If the shapes do not agree.

    Notes
    -----
    A Newton step that lowers the derivative of the energy along it is accepted. After any other
    step the law is linearised at a jump that differs from the jump of the bodies, (1) of this
    module, which also works for laws without energy and laws of any stiffness; the residual is
    evaluated with the traction there. A line search for the least energy, from the iterate of the
    smallest residual, follows where a small stiffness supports bodies on an open interface, where
    the residual grows too much, and where it has not fallen for some steps. A load at which the
    iteration stalls is tried again with another stiffness of the bodies, then in parts; the record
    has the residuals of all attempts.
    """
    check_limits(tolerance, max_iterations)
    n, points = stiffness.shape[0], weight.size
    if load.shape != (n,) or jump_operator.shape[1] != n or jump_operator.shape[0] % points:
        raise ValueError(
            f"load ({n},) and jump_operator (d * {points}, {n}) must match stiffness and weight, "
            f"got {load.shape} and {jump_operator.shape}"
        )
    bodies = Assembled(stiffness, load[:, None], jump_operator, weight, np.zeros((n, 0)))
    return bodies.solve(
        law,
        np.ones(1),
        start=start,
        jump=jump,
        state=state,
        max_iterations=max_iterations,
        tolerance=tolerance,
        callback=callback,
    )


LinearSolver = Callable[[csr_array | np.ndarray, csr_array, np.ndarray], Solve]
"""Solver of K + B^T D B from K, B and the tangents D, (d, d, points), N/m."""


def factorise_joined(
    stiffness: csr_array | np.ndarray, jump: csr_array, tangent: np.ndarray
) -> Solve:
    """Factorise the stiffness of bodies with the tangents of their joints."""
    if not jump.shape[0]:
        return factorise(stiffness, name="the stiffness of the structure")
    matrix = stiffness + jump.T @ (joint_matrix(tangent) @ jump)
    full = issparse(matrix) and matrix.nnz > FULL * matrix.shape[0] ** 2
    return factorise(matrix.toarray() if full else matrix, name="the tangent stiffness")


@dataclass(frozen=True, eq=False)
class Assembled:
    """Assembled elastic bodies, prepared for many laws and loads."""

    stiffness: csr_array | np.ndarray  # of all linear elements, (n, n), N/m
    load: np.ndarray | csr_array  # (n, cases), N
    jump: csr_array  # normal jumps of all points, then each tangential jump, (d * points, n)
    weight: np.ndarray  # area of these points, (points,), m²
    motions: np.ndarray  # rigid motions of the bodies, (n, motions), m
    linear: LinearSolver = factorise_joined  # solver of bodies with the tangents of joints

    def solve(
        self,
        law: InterfaceLaw,
        factor: np.ndarray,
        *,
        start: np.ndarray | None = None,
        jump: np.ndarray | None = None,
        state: np.ndarray | None = None,
        max_iterations: int = 100,
        tolerance: float = 1e-10,
        callback: Callable[[int, float], None] | None = None,
    ) -> InterfaceSolution:
        """Solve for the unknowns, m, at factors of the load cases; see :func:`solve_interface`."""
        limits = Limits(max_iterations, tolerance, callback)
        load, points = self.load @ factor, self.weight.size
        # bodies without joints
        if not points:
            u = self._solve(load)
            residual = float(norm(self.stiffness @ u - load)) / (float(norm(load)) or 1.0)
            return InterfaceSolution(u, Status.CONVERGED, (1.0, residual), jump=np.zeros((3, 0)))

        # Newton's method
        u = np.zeros(load.size) if start is None else np.array(start, dtype=float)
        state = np.zeros((law.n_state, points)) if state is None else state
        jump = (self.jump @ u).reshape(-1, points) if jump is None else jump
        bodies = self.flexible or self
        balance = Equilibrium(bodies, bodies.split(load, motions=False), law, state)
        here = balance.place(bodies.split(u), jump)
        balance.scale = float(norm(load)) or balance.size(here.gradient) or 1.0
        # a load that fails rises in parts, from the load with which the start is in balance
        target, begin = balance.load, balance.load + here.gradient
        tries: list[Solution] = []
        for stiffer, parts in ATTEMPTS:
            last, balance.resistance = here, stiffer * bodies.resistance
            for share in np.linspace(0.0, 1.0, parts + 1)[1:]:
                rising = share < 1.0  # the load of a start far from the solution may overflow
                balance.load = begin + share * (target - begin) if rising else target
                run = NewtonRun(limits, PATIENCE)
                last, _ = find_equilibrium(balance, balance.place(last.value, last.at), run)
                tries.append(run.solution(last.value))
                if not run.converged:
                    break
            if run.converged or run.status is Status.MAX_ITERATIONS:
                break  # the limit of the caller holds
        record = join_solutions(tries)
        u = bodies.join(last.value)
        return InterfaceSolution(u, run.status, record.residuals, record.seconds, jump=last.at)

    @cached_property
    def _solve(self) -> Solve:
        return self.linear(self.stiffness, self.jump, NO_JOINT)

    @cached_property
    def resistance(self) -> float:
        """Stiffness of the bodies per area of the interface, Pa/m, from its diagonal."""
        if not self.weight.size:
            return 0.0
        touched = abs(self.jump[: self.weight.size]).T @ self.weight
        diagonal = np.abs(self.stiffness.diagonal())
        return SOFT * float(np.sum(diagonal[touched > 0.0]) / np.sum(touched))

    @cached_property
    def flexible(self) -> FlexibleBodies | None:
        """Bodies condensed onto their jumps; None if sparse, or singular beyond rigid motions."""
        n = self.load.shape[0]
        matrix = csr_array(self.stiffness)
        if n > FEW and matrix.nnz <= FULL * n**2:
            return None
        return prepare_flexible(matrix.toarray(), self.jump, self.weight, self.motions)

    def direction(self, tangent: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Newton direction, m, by factors of the tangent K + B^T (w D) B."""
        return self.linear(self.stiffness, self.jump, tangent)(force)

    def split(self, value: np.ndarray, *, motions: bool = True) -> np.ndarray:
        """Unknowns or forces of the Newton step."""
        return value

    def join(self, value: np.ndarray) -> np.ndarray:
        """Displacement, m."""
        return value


@dataclass(frozen=True, eq=False)
class Place:
    """Bodies at some unknowns, and the tangent of the law at the same or another jump."""

    value: np.ndarray  # unknowns, (n,), m
    gradient: np.ndarray  # residual forces with the tangent of the law, (n,), N
    jump: np.ndarray  # of the bodies, (d, points), m, summed over steps: differences would round
    at: np.ndarray  # jump at which the law is evaluated, (d, points), m
    elastic: np.ndarray  # change of tension without slack, (links,), N
    traction: np.ndarray  # of the law, (d, points), Pa
    tangent: np.ndarray  # of the law, times the weights of the points, (d, d, points), N/m
    imbalance: float  # size of the residual forces with the traction of the law, N
    softened: bool  # whether the tangent is softer than the law somewhere


class Equilibrium:
    """Equilibrium of bodies joined by a law under a load: K u + B^T (w t(B u)) = f."""

    def __init__(
        self,
        bodies: Assembled | FlexibleBodies,
        load: np.ndarray,
        law: InterfaceLaw,
        state: np.ndarray,
    ) -> None:
        self.bodies, self.load, self.law, self.state, self.scale = bodies, load, law, state, 1.0
        self.resistance = bodies.resistance
        self.resists, self.descends = bool(np.all(self.resistance > 0.0)), False

    def inner(self, value: np.ndarray, elastic: np.ndarray) -> np.ndarray:
        """Return the forces of bodies and links less the load, N."""
        return np.asarray(self.bodies.stiffness @ value - self.load)

    def stretch(self, direction: np.ndarray) -> np.ndarray:
        """Change of tension without slack along a direction, N."""
        return NO_LINKS

    def size(self, force: np.ndarray) -> float:
        """Norm of forces, N, without the forces on rigid motions, which are sums of them."""
        return float(norm(force[: self.bodies.motions.shape[0]]))

    def largest(self, here: Place) -> float:
        """Size of the forces that cancel in equilibrium, N."""
        return float(norm(self.magnitude @ np.abs(here.value)))

    def dot(self, first: np.ndarray, second: np.ndarray) -> float:
        """Work of forces on a displacement, J."""
        return float(first @ second)

    def anywhere(self, flag: bool) -> bool:
        """Whether a flag is set in any process."""
        return flag

    @cached_property
    def magnitude(self) -> csr_array | np.ndarray:
        """Magnitudes of the entries of the stiffness, N/m."""
        return abs(self.bodies.stiffness)

    def direction(self, here: Place, floor: float = 0.0) -> np.ndarray | None:
        """Newton direction, m; None if the tangent is singular, even with a floor of the law."""
        tangent = here.tangent.copy()
        lent = floor * self.resistance * self.bodies.weight
        tangent[range(len(tangent)), range(len(tangent))] += lent
        with suppress(MultiscaleError):
            return self.bodies.direction(tangent, -here.gradient)
        return None

    def place(
        self,
        value: np.ndarray,
        jump: np.ndarray,
        at: np.ndarray | None = None,
        elastic: np.ndarray = NO_LINKS,
    ) -> Place:
        """Evaluate the law at a jump, by default the jump of the bodies, and the imbalance, N."""
        at = jump if at is None else at
        exact = self.law.respond(at, self.state)
        response = soften_tangent(exact, self.resistance)
        inner = self.inner(value, elastic)
        gradient, fault = (
            inner + self.bodies.jump.T @ (self.bodies.weight * traction).ravel()
            for traction in (tangent_traction(response, at, jump), response.traction)
        )
        return Place(
            value,
            gradient,
            jump,
            at,
            elastic,
            exact.traction,
            self.bodies.weight * response.tangent,
            self.size(fault),
            self.anywhere(response is not exact),
        )

    def residual(self, here: Place) -> float:
        """Imbalance relative to the load."""
        return here.imbalance / self.scale

    def rounding(self, here: Place) -> float:
        """Residual due to rounding where bodies move far on a soft law."""
        return min(8.0 * float(np.finfo(float).eps) * self.largest(here) / self.scale, UNSURE)

    def move(self, here: Place, step: float, direction: np.ndarray) -> Place:
        """Move the bodies by a step, m."""
        opened = (self.bodies.jump @ direction).reshape(here.jump.shape)
        elastic = here.elastic + step * self.stretch(direction)
        return self.place(here.value + step * direction, here.jump + step * opened, elastic=elastic)

    def step(self, here: Place, direction: np.ndarray) -> Place:
        """Full step, after which the law may be linearised at a jump that differs by (1)."""
        there = self.move(here, 1.0, direction)
        first, last = (self.dot(direction, place.gradient) for place in (here, there))
        if (enough(first, last) and not here.softened) or not self.resists:
            return there
        # (1) of this module from the sum t + k y on the law towards that on its tangent
        k, law = self.resistance, self.law
        response = soften_tangent(law.respond(here.at, self.state), k)
        begin = response.traction + k * here.at
        change = tangent_traction(response, here.at, there.jump) + k * there.jump - begin
        best, share = None, 1.0
        for _ in range(HALVINGS):
            following = self.move(here, share, direction) if best else there
            try:
                at = np.asarray(law.resolvent(begin + share * change, k, self.state))
            except ConvergenceError:  # a full step may end where the law overflows
                at = following.jump
            following = self.place(following.value, following.jump, at, following.elastic)
            if self.residual(following) < (1.0 - SHARE * share) * self.residual(here):
                return following
            best, share = best or following, 0.5 * share
        assert best is not None  # the full step
        return best

    def search(self, here: Place, direction: np.ndarray) -> Place:
        """Line search for the least energy."""

        def slope(step: float) -> float:
            return self.dot(direction, self.move(here, step, direction).gradient)

        step = step_length(slope, self.dot(direction, here.gradient))
        return self.move(here, step, direction)


@np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
def find_equilibrium(
    problem: Equilibrium,
    here: Place,
    run: NewtonRun,
    note: Callable[[Place], object] = lambda here: None,
) -> tuple[Place, Place]:
    """Apply Newton's method from a start; return the last iterate and the closest iterate."""
    closest = best = here
    note(here)
    while run.goes_on(problem.residual(here), problem.rounding(here)):
        if not run.since_best:
            best = here
            closest = here if here.at is here.jump else closest
        # full step; a tangent that is singular at another jump of the law gets a small stiffness
        direction = problem.direction(here)
        if direction is None and here.at is not here.jump:
            direction = problem.direction(here, FLOOR)
        there = None if direction is None else problem.step(here, direction)
        if there is not None and not problem.descends:
            residual, last = problem.residual(there), run.residuals[-1]
            strays = not residual < last and run.since_best > ROUNDS
            there = None if strays or not residual <= GROWTH * last else there
        if there is None:
            # line search, from an iterate with the law at the jump of the bodies
            direction = problem.direction(closest)
            if direction is None:
                direction = problem.direction(closest, FLOOR)
            if direction is None:
                run.stop(Status.STALLED)
                break
            there = closest = problem.search(closest, direction)
        here = there
        note(here)
    return here, best if run.since_best else here


def soften_tangent(response: Response, stiffness: float | np.ndarray) -> Response:
    """Soften the tangent by a spring in series where it is far stiffer than the bodies, Pa/m."""
    most = STIFFEST * float(np.max(stiffness))
    largest = np.abs(response.tangent).max(axis=(0, 1))
    stiff = (most > 0.0) & (largest > most) & np.isfinite(largest)
    if not np.any(stiff):
        return response
    D = np.moveaxis(
        response.tangent[..., stiff] / np.maximum(largest[stiff] / (1e6 * most), 1.0), -1, 0
    )
    tangent = response.tangent.copy()
    tangent[..., stiff] = np.moveaxis(np.linalg.solve(np.eye(D.shape[1]) + D / most, D), 0, -1)
    return replace(response, tangent=tangent)


def tangent_traction(response: Response, at: np.ndarray, jump: np.ndarray) -> np.ndarray:
    """Traction of the tangent of a law at a jump, for another jump, shape (d, points), Pa."""
    change = np.einsum("ijp,jp->ip", response.tangent, jump - at)
    return np.asarray(response.traction + change)
