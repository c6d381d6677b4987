r"""The equations of one load increment: geometry, material, contact and friction at once.

Unknowns are the displacement :math:`u` and, if the load is prescribed, the approach
:math:`\delta`. The contact forces are the internal forces :math:`f(u)` at the surface. With the
pressure force :math:`p = -n \cdot f`, the gap :math:`g`, the slip :math:`w` of the step tangential
to the obstacle and :math:`f_t` the tangential part of the force,

.. math::
    p = \max(0,\, p - \rho_n g), \qquad
    f_t = \Pi_{\mu p}(f_t - \rho_t w),    \tag{1}

with the projection :math:`\Pi` onto the disc of radius :math:`\mu p`: eqs (4)-(5) of the source
with Coulomb friction. Normals and slips refer to the current configuration.

References
----------
.. [1] P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353-375,
   doi:10.1016/0045-7825(91)90022-X: the equations (1).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.micro.finite.constraint import Constraint
from multiscale.micro.finite.finite_body import BodyResponse, Increment
from multiscale.micro.finite.scene import CellScene, CellState, Meeting
from multiscale.micro.finite.tangential import Tangential, evaluate_friction
from multiscale.micro.path import Target
from multiscale.numerics.krylov import minimal_residual

__all__ = ["CellEquations", "Iterate"]

LEAST_SPRING = 0.3 / 1.3  # share of the bound above which the preconditioner has a spring
KRYLOV_MEMORY = 1e9  # bytes of the directions of one linear problem
KRYLOV_ITERATIONS = (60, 400)  # bounds on the number of stored directions
UNLOADED = 1e-3  # least scale of residuals over the largest contact forces so far


@dataclass(frozen=True, eq=False)
class CellEquations:
    """The equations (1) of one increment.

    Attributes
    ----------
    scene : CellScene
    increment : Increment, time step of the body from the state at the start
    start : CellState
    target : Target, end of the increment
    """

    scene: CellScene
    increment: Increment
    start: CellState
    target: Target

    def at(self, u: np.ndarray, delta: float, active: np.ndarray | None = None) -> "Iterate":
        """Evaluate (1) and choose the slipping nodes and, if not given, the contact nodes.

        ``u`` and ``delta`` are the displacement and the approach, m; ``active`` has the shape (nx,
        ny).
        """
        return self._with(self.increment.respond(u), u, delta, active)

    def error_at_start(self, delta: float) -> float:
        """Residual of (1) at the start, if the forces inside are still as they were."""
        u, force = self.start.displacement, np.zeros_like(self.start.displacement)
        self.scene.meet(u, delta, self.target.slide).react(force, -self.start.force)
        self.scene.surface(force)[:] += self.start.force
        return self._with(BodyResponse(force, np.zeros_like, 1.0, 0.0), u, delta).error

    def _with(
        self,
        response: BodyResponse,
        u: np.ndarray,
        delta: float,
        active: np.ndarray | None = None,
    ) -> "Iterate":
        scene, target = self.scene, self.target
        force = scene.surface(response.force)
        meeting = scene.meet(u, delta, target.slide)
        pressure = -np.sum(force * meeting.normal, axis=1)
        trial = pressure - scene.weights[0] * meeting.gap
        if active is None:
            active = trial > 0.0
            if target.load and not active.any():  # at least one node carries the load
                active = trial == trial.max()
        friction = None
        if scene.friction > 0.0:
            friction = evaluate_friction(
                force + pressure[:, None] * meeting.normal,
                self._slip(u, delta, meeting.normal),
                meeting.normal,
                active,
                scene.friction * np.maximum(trial, 0.0),
                scene.weights[1],
            )
        floor = UNLOADED * self.start.peak
        return Iterate(
            scene, target, response, u, delta, meeting, active, pressure, friction, floor
        )

    @cached_property
    def _slip_since_start(self) -> Callable[..., np.ndarray]:
        return self.scene.slip_since(self.start)

    def _slip(self, u: np.ndarray, delta: float, normal: np.ndarray) -> np.ndarray:
        """Motion past the obstacle since the start, in the tangential plane."""
        slip = self._slip_since_start(u, delta, self.target.slide)
        return np.asarray(slip - np.sum(slip * normal, axis=1)[:, None] * normal)


@dataclass(frozen=True, eq=False)
class Iterate:
    """The equations at one displacement.

    Attributes
    ----------
    scene : CellScene
    target : Target
    response : BodyResponse
    u, delta : ndarray, float, displacement and approach, m
    meeting : Meeting
    active : ndarray of bool, shape (nx, ny), contact nodes
    pressure : ndarray, shape (nx, ny), pressure force p, N
    friction : Tangential or None, none without friction
    floor : float, smallest scale of the residual, N
    """

    scene: CellScene
    target: Target
    response: BodyResponse
    u: np.ndarray
    delta: float
    meeting: Meeting
    active: np.ndarray
    pressure: np.ndarray
    friction: Tangential | None
    floor: float

    @property
    def slipping(self) -> np.ndarray:
        """Contact nodes that slip."""
        if self.friction is None:
            return np.zeros_like(self.active)
        return self.friction.slipping

    @property
    def sticking(self) -> np.ndarray:
        """Contact nodes held in all directions."""
        return np.asarray(self.active & ~self.slipping)

    @property
    def dissipated(self) -> float:
        """Work of friction in the step, J."""
        if self.friction is None:
            return 0.0
        return -float(np.sum(self.contact_force * self.friction.slip))

    @cached_property
    def contact_force(self) -> np.ndarray:
        """Force of the obstacle on the body, shape (nx, 3, ny), N."""
        force = self.scene.surface(self.response.force)
        return np.asarray(np.where(self.active[:, None], force, 0.0))

    @cached_property
    def scale(self) -> float:
        """Scale of the residual, N: norm of the contact forces, at least of an even load."""
        norm = max(float(np.linalg.norm(self.contact_force)), self.floor)
        if self.target.load is not None:
            return max(norm, self.target.load / float(np.sqrt(self.active.size)))
        return norm

    @cached_property
    def missing(self) -> float:
        """Change of the vertical contact force that balance needs, N; 0 at a given approach."""
        if self.target.load is None:
            return 0.0
        return -self.target.load - float(self.contact_force[:, 2].sum())

    @cached_property
    def constraint(self) -> Constraint:
        """Prescribed motions and springs of the preconditioner."""
        rows, held = self.meeting.normal[None], self.active[None]
        if self.friction is not None:
            rows = np.concatenate([rows, self.friction.direction])
            held = np.stack([self.active, self.sticking, self.sticking])
        spring = np.zeros(held.shape)
        if self.friction is not None:
            strong = self.friction.share > LEAST_SPRING
            spring[2] = np.where(strong, self.scene.weights[1] * self.friction.stretch, 0.0)
        reference = self.scene.reference_at(self.meeting)
        return Constraint(reference, rows, held, spring, carries_load=self.target.load is not None)

    @cached_property
    def distance(self) -> np.ndarray:
        """Steps of the prescribed motions, shape (rows, nx, ny), m."""
        rows = [np.where(self.active, self.meeting.gap, 0.0)]
        if self.friction is not None:
            rows += list(np.where(self.sticking, -self.friction.along(self.friction.slip), 0.0))
        return np.stack(rows)

    @cached_property
    def opens(self) -> bool:
        """Whether a prescribed motion is not met up to rounding."""
        lag = np.abs(self.distance).max()
        return bool(
            lag > 1e-10 * max(abs(self.delta), float(np.abs(self.scene.surface(self.u)).max()), lag)
        )

    @cached_property
    def residual(self) -> np.ndarray:
        """Forces out of balance in the form of the Newton equations, N."""
        residual = self.response.force.copy()
        top = self.scene.surface(residual)
        turned = None
        if self.friction is not None:
            turned = self.friction.stretch * self.friction.along(top)[1]
        self._exchange(residual, turned, 0.0)
        return residual

    @cached_property
    def error(self) -> float:
        """Residual of (1), relative to the contact forces."""
        balance = self.response.force.copy()
        self.scene.surface(balance)[:] -= self.contact_force
        self.meeting.react(balance, self.contact_force)
        forces = float(np.vdot(balance, balance))
        off = (
            self.contact_force
            + np.where(self.active, self.pressure, 0.0)[:, None] * self.meeting.normal
        )
        if self.friction is not None:
            off = off - self.friction.bound[:, None] * self.friction.direction[0]
            off = np.where(self.slipping[:, None], off, 0.0)
        forces += float(np.vdot(off, off))
        weight = np.array([self.scene.weights[0]] + [self.scene.weights[1]] * 2)
        held = self.distance * weight[: len(self.distance), None, None]
        pulled = np.minimum(np.where(self.active, self.pressure, 0.0), 0.0)
        total = np.sqrt(forces + float(np.vdot(held, held)) + float(np.vdot(pulled, pulled)))
        missing = abs(self.missing) / self.target.load if self.target.load else 0.0
        if total == 0.0 and missing == 0.0:
            return 0.0
        return max(total / self.scale if self.scale > 0.0 else 1.0, missing)

    def _exchange(
        self, vector: np.ndarray, turned: np.ndarray | None, more: np.ndarray | float
    ) -> None:
        """Remove the contact forces from the surface forces and add their reactions, in place.

        At a sticking node the contact force is the whole force; at a slipping node its normal
        part, the friction at the bound, the resistance across the slip and the turning of the
        normal.
        """
        top, normal = self.scene.surface(vector), self.meeting.normal
        pushed = np.sum(normal * top, axis=1)
        force = pushed[:, None] * normal + more
        if self.friction is not None and turned is not None:
            along, across = self.friction.direction
            drag = (self.scene.friction * pushed)[:, None] * along + turned[:, None] * across
            force -= np.where(self.slipping[:, None], drag, 0.0)
            force = np.where(self.sticking[:, None], top, force)
        force = np.where(self.active[:, None], force, 0.0)
        top -= force
        self.meeting.react(vector, force)

    def _apply(self, x: np.ndarray, shift: float) -> tuple[np.ndarray, float]:
        """Newton's matrix times a step, N, and the change of the vertical contact force, N."""
        change = self.response.tangent(x)
        top = self.scene.surface(change)
        vertical = float(np.where(self.active, top[:, 2], 0.0).sum())
        pressure = np.where(self.active, self.pressure, 0.0)
        more = self.meeting.turn(x, shift, pressure, self.contact_force, change)
        turned = None
        if self.friction is not None:
            across = self.friction.direction[1]
            moved = np.sum(across * self.meeting.relative(x), axis=1) + across[:, 2] * shift
            turned = self.scene.weights[1] * self.friction.stretch * moved
        self._exchange(change, turned, more)
        return change, vertical

    def newton_step(self, forcing: float, floor: float) -> tuple[np.ndarray, float, int]:
        """Solve the linear problem of a Newton step."""
        shape, size = self.u.shape, self.u.size
        constraint = self.constraint
        weight = 1.0 / np.sqrt(max(int(self.active.sum()), 1))
        carries = constraint.carries_load

        def join(vector: np.ndarray, number: float) -> np.ndarray:
            return np.append(vector.reshape(-1), np.asarray(number, vector.dtype))

        def apply(x: np.ndarray) -> np.ndarray:
            change, vertical = self._apply(x[:size].reshape(shape), x[size])
            return join(change, weight * vertical if carries else 0.0)

        def precondition(r: np.ndarray) -> np.ndarray:
            z, shift = constraint.solve(r[:size].reshape(shape), r[size] / weight)
            return join(z, shift)

        first, shift = constraint.solve(-self.residual, self.missing, self.distance)
        x = join(first, shift)
        rest = join(-self.residual, weight * self.missing if carries else 0.0) - apply(x)
        weights = self.scene.weights[0] * float(np.linalg.norm(self.distance))
        size_now = np.hypot(float(np.linalg.norm(self.residual)), weights)
        goal = max(forcing * size_now, floor * self.scale)
        room = int(KRYLOV_MEMORY / (2 * x.nbytes))
        limit = min(max(room, KRYLOV_ITERATIONS[0]), KRYLOV_ITERATIONS[1])
        norm = float(np.linalg.norm(rest)) or 1.0
        unit = (rest / norm).astype(np.float32)  # enough for the tolerance, in half the memory
        y, iterations = minimal_residual(apply, unit, precondition, goal=goal / norm, room=limit)
        x += norm * y.astype(float)
        return x[:size].reshape(shape), float(x[size]), iterations + 1
