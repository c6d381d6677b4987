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

from multiscale.micro.finite.scene import BodyResponse, CellScene, CellState, Increment
from multiscale.micro.finite.surfaces import Meeting
from multiscale.micro.path import Target

__all__ = ["CellEquations", "Iterate", "Tangential"]

LARGEST_SHARE = 0.9999  # bound on share, for a finite resistance across the slip
UNLOADED = 1e-3  # least scale of residuals over the largest contact forces so far


@dataclass(frozen=True, eq=False)
class Tangential:
    """Tangential part of the contact equations.

    Attributes
    ----------
    slip : ndarray, shape (nx, 3, ny), tangential motion past the obstacle in the increment, m
    direction : ndarray, shape (2, nx, 3, ny)
        Unit tangents along and across the trial friction force.
    bound : ndarray, shape (nx, ny), largest friction force, N
    slipping : ndarray of bool, shape (nx, ny), whether a node slips
    share : ndarray, shape (nx, ny)
        Bound over trial friction force where a node slips, 0 elsewhere; dimensionless.
    """

    slip: np.ndarray
    direction: np.ndarray
    bound: np.ndarray
    slipping: np.ndarray
    share: np.ndarray

    @cached_property
    def stretch(self) -> np.ndarray:
        """Resistance of a slipping node across its slip, relative to the weight, dimensionless."""
        share = np.minimum(self.share, LARGEST_SHARE)
        return np.asarray(share / (1.0 - share))

    def along(self, vector: np.ndarray) -> np.ndarray:
        """Components of a vector along and across the trial force, shape (2, nx, ny)."""
        return np.asarray(np.sum(self.direction * vector, axis=2))


def evaluate_friction(
    tangential: np.ndarray,
    slip: np.ndarray,
    normal: np.ndarray,
    active: np.ndarray,
    bound: np.ndarray,
    weight: float,
) -> Tangential:
    r"""Find the nodes that slip, and the directions of their slip."""
    pulled = tangential - weight * slip
    size = np.linalg.norm(pulled, axis=1)
    slipping = active & (size > bound)
    share = np.where(slipping, bound / np.where(size > 0.0, size, 1.0), 0.0)
    sideways = np.zeros_like(pulled)  # an arbitrary tangent where the trial force vanishes
    sideways[:, 0], sideways[:, 2] = normal[:, 2], -normal[:, 0]
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    pulls = (size > 1e-12 * float(size.max()))[:, None]
    along = np.where(pulls, pulled / np.maximum(size, 1e-300)[:, None], sideways)
    direction = np.stack([along, np.cross(normal, along, axis=1)])
    return Tangential(slip, direction, bound, slipping, share)


@dataclass(frozen=True, eq=False)
class CellEquations:
    """The equations (1) of one increment.

    Attributes
    ----------
    scene : CellScene
    start : CellState
    target : Target, end of the increment
    """

    scene: CellScene
    start: CellState
    target: Target

    @cached_property
    def increment(self) -> Increment:
        """Time step of the bodies from the state at the start."""
        return self.scene.begin(self.start.material, self.target.time_step)

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
        return self._with(BodyResponse(force, np.zeros_like), u, delta).error

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
        normal = meeting.normal
        pressure = -np.sum(force * normal, axis=1)
        trial = pressure - scene.weights[0] * meeting.gap
        if active is None:
            active = trial > 0.0
            if target.load and not active.any():  # at least one node carries the load
                active = trial == trial.max()
        friction = None
        if scene.friction > 0.0:
            slip = self._slip(u, delta, target.slide)
            friction = evaluate_friction(
                force + pressure[:, None] * normal,
                slip - np.sum(slip * normal, axis=1)[:, None] * normal,
                normal,
                active,
                scene.friction * np.maximum(trial, 0.0),
                scene.weights[1],
            )
        return Iterate(self, response, u, delta, meeting, active, pressure, friction)

    @cached_property
    def _slip(self) -> Callable[[np.ndarray, float, np.ndarray], np.ndarray]:
        """Motion past the opposite side since the start, m."""
        start, scene = self.start, self.scene
        return scene.opposite.slip_since(
            scene.surfaces, start.displacement, start.approach, start.slide
        )


@dataclass(frozen=True, eq=False)
class Iterate:
    """The equations at one displacement.

    Attributes
    ----------
    equations : CellEquations
    response : BodyResponse
    u, delta : ndarray, float, displacement and approach, m
    meeting : Meeting
    active : ndarray of bool, shape (nx, ny), contact nodes
    pressure : ndarray, shape (nx, ny), pressure force p, N
    friction : Tangential or None, none without friction
    """

    equations: CellEquations
    response: BodyResponse
    u: np.ndarray
    delta: float
    meeting: Meeting
    active: np.ndarray
    pressure: np.ndarray
    friction: Tangential | None

    @property
    def scene(self) -> CellScene:
        """Constant data."""
        return self.equations.scene

    @property
    def target(self) -> Target:
        """End of the increment."""
        return self.equations.target

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
        least = UNLOADED * self.equations.start.peak
        norm = max(float(np.linalg.norm(self.contact_force)), least)
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

    def apply(self, x: np.ndarray, shift: float) -> tuple[np.ndarray, float]:
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
