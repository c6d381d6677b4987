r"""Bodies, states and equations of cells with friction, large strain or two bodies.

The contact forces are the internal forces :math:`f(u)` at the surface. With the pressure force
:math:`p = -n \cdot f`, the gap :math:`g`, the slip :math:`w` of the step tangential to the obstacle
and the projection :math:`\Pi` onto the disc of radius :math:`\mu p` [1]_,

.. math::
    p = \max(0,\, p - \rho_n g), \qquad
    f_t = \Pi_{\mu p}(f_t - \rho_t w),    \tag{1}

in the current configuration: eqs (4)-(5) of the source with Coulomb friction.

.. [1] P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353-375,
   doi:10.1016/0045-7825(91)90022-X.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy.sparse import csr_array

from multiscale.convergence import Status
from multiscale.micro.finite.surfaces import Meeting, OppositeSide
from multiscale.micro.path import Target

LARGEST_SHARE = 0.9999  # bound on the share, for a finite resistance across the slip
UNLOADED = 1e-3  # least scale of residuals over the largest contact forces so far


@dataclass(frozen=True, eq=False)
class BodyResponse:
    """Response of a body, or of all bodies of a scene, to a displacement at the end of a step."""

    force: np.ndarray  # internal forces, N, in the shape of the displacement
    tangent: Callable[[np.ndarray], np.ndarray]  # times a displacement, N; until the next response
    state: Callable[[], Any] = lambda: None  # internal variables at the end of the step
    least_dilatation: float = 1.0  # smallest det F; forces are defined if it is positive
    flowing: float = 0.0  # share of the Gauss points that flow
    matrix: csr_array | None = None  # assembled tangent of a mesh, N/m


Respond = Callable[[np.ndarray], BodyResponse]
"""From the displacement at the end of a step, m, to the response of a body."""


class FiniteBody(Protocol):
    """A deformable body; a layer has displacements of the shape (nx, layers, 3 or 4, ny)."""

    shape: tuple[int, ...]

    def begin(self, state: Any, time_step: float) -> Respond:
        """Begin a time step, s, from internal variables."""

    def rest(self) -> Any:
        """Return the internal variables before any load; None if the body has no state."""
        return None

    def surface(self, displacement: np.ndarray) -> np.ndarray:
        """Return the displacement at the surface, a view of shape (nx, 3, ny)."""
        return displacement[:, -1, :3]


@dataclass(frozen=True, eq=False)
class LinearLayer(FiniteBody):
    """A linear elastic layer."""

    shape: tuple[int, ...]
    stiffness: Callable[[np.ndarray], np.ndarray]  # times a displacement, N

    def begin(self, state: Any, time_step: float) -> Respond:
        """Begin a time step."""
        return lambda u: BodyResponse(self.stiffness(u), self.stiffness)


@dataclass(frozen=True, eq=False)
class CellState:
    """A state of the cell in equilibrium, or the last iterate."""

    displacement: np.ndarray  # of all bodies, m, as a vector
    approach: float  # of the opposite side since the first touch, m
    slide: np.ndarray  # (2,), displacement of the opposite side in its plane, m
    material: tuple[Any, ...]  # internal variables of each body, or None
    force: np.ndarray  # (nx, 3, ny), force of the opposite side on the first body, N
    active: np.ndarray  # (nx, ny), contact nodes
    slipping: np.ndarray  # (nx, ny), contact nodes that slip
    dissipation: float = 0.0  # work of friction since the first state, J
    status: Status = Status.MAX_ITERATIONS
    residuals: tuple[float, ...] = ()  # relative to the contact forces, after each iteration
    linear_iterations: int = 0
    flowing: float = 0.0  # share of the Gauss points that flow
    peak: float = 0.0  # largest norm of the contact forces so far, N
    moved: np.ndarray | None = None  # change of the displacement in the last increment, m
    change: np.ndarray = field(default_factory=lambda: np.zeros(5))
    # changes in the last increment: slide, m, load, N, approach, m, and time, s

    @property
    def load(self) -> float:
        """Vertical load that the contact carries, N."""
        return -float(self.force[:, 2].sum())


class LinearSolver(Protocol):
    """Solver of the linear problems of Newton steps, and of the elastic cell at first contact."""

    def touch(self, gap: np.ndarray, closing: np.ndarray, load: float) -> tuple[np.ndarray, float]:
        """Estimate contact nodes and approach, m, of an open cell under a load, N."""

    def step(self, now: "Iterate", forcing: float, floor: float) -> tuple[np.ndarray, float, int]:
        """Solve for a step to a relative residual: displacement, m, approach, m, iterations."""


@dataclass(frozen=True, eq=False)
class CellScene:
    """Constant data of a path: a body against a rigid side, or two (z of the second points out)."""

    bodies: tuple[FiniteBody, ...]  # 1 or 2
    opposite: OppositeSide
    friction: float  # local coefficient; 0 leaves out all tangential equations
    weights: tuple[float, float]  # rho_n and rho_t of the contact equations, N/m
    solver: LinearSolver

    def split(self, vector: np.ndarray) -> list[np.ndarray]:
        """Return the field of each body, as views."""
        ends = np.cumsum([np.prod(body.shape) for body in self.bodies])[:-1]
        pairs = zip(np.split(vector, ends), self.bodies, strict=True)
        return [values.reshape(body.shape) for values, body in pairs]

    def surfaces(self, vector: np.ndarray) -> list[np.ndarray]:
        """Return the field at the surface of each body, views of shape (nx, 3, ny)."""
        pairs = zip(self.bodies, self.split(vector), strict=True)
        return [body.surface(field) for body, field in pairs]

    def surface(self, vector: np.ndarray) -> np.ndarray:
        """Return the field at the surface of the first body, a view of shape (nx, 3, ny)."""
        return self.surfaces(vector)[0]

    def rest(self) -> CellState:
        """Return the cell before any load."""
        nx, ny = self.opposite.body.heights.shape
        nothing = np.zeros((nx, ny), dtype=bool)
        u = join([np.zeros(body.shape) for body in self.bodies])
        material, force = tuple(body.rest() for body in self.bodies), np.zeros((nx, 3, ny))
        contact = force, nothing, nothing, 0.0, Status.CONVERGED, (0.0,)
        return CellState(u, 0.0, np.zeros(2), material, *contact)

    def begin(self, material: tuple[Any, ...], time_step: float) -> Respond:
        """Begin a time step, s, of all bodies, as a function of vectors."""
        states = zip(self.bodies, material, strict=True)
        steps = [body.begin(state, time_step) for body, state in states]
        sizes = [float(np.prod(body.shape)) for body in self.bodies]

        def respond(u: np.ndarray) -> BodyResponse:
            responses = [step(v) for step, v in zip(steps, self.split(u), strict=True)]

            def tangent(v: np.ndarray) -> np.ndarray:
                pairs = zip(responses, self.split(v), strict=True)
                return join([response.tangent(field) for response, field in pairs])

            return BodyResponse(
                join([response.force for response in responses]),
                tangent,
                lambda: tuple(response.state() for response in responses),
                min(response.least_dilatation for response in responses),
                float(np.average([response.flowing for response in responses], weights=sizes)),
                responses[0].matrix,
            )

        return respond

    def meet(self, u: np.ndarray, approach: float, slide: np.ndarray) -> Meeting:
        """Locate the contact points at a displacement, m, an approach, m, and a slide, (2,), m."""
        return self.opposite.meet(self.surfaces, u, approach, slide)


def join(fields: list[np.ndarray]) -> np.ndarray:
    """Concatenate the fields of all bodies."""
    return np.concatenate([values.reshape(-1) for values in fields])


@dataclass(frozen=True, eq=False)
class Tangential:
    """Tangential contact equations."""

    slip: np.ndarray  # (nx, 3, ny), tangential motion along the obstacle in the increment, m
    direction: np.ndarray  # (2, nx, 3, ny), tangents along and across the trial friction force
    bound: np.ndarray  # (nx, ny), largest friction force, N
    slipping: np.ndarray  # (nx, ny), whether a node slips
    share: np.ndarray  # (nx, ny), bound over trial friction force where a node slips, else 0

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
    r"""Select the nodes that slip, and compute the directions of their slip."""
    trial = tangential - weight * slip
    size = np.linalg.norm(trial, axis=1)
    slipping = active & (size > bound)
    share = np.where(slipping, bound / np.where(size > 0.0, size, 1.0), 0.0)
    sideways = np.zeros_like(trial)  # an arbitrary tangent where the trial force vanishes
    sideways[:, 0], sideways[:, 2] = normal[:, 2], -normal[:, 0]
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    defined = (size > 1e-12 * float(size.max()))[:, None]
    along = np.where(defined, trial / np.maximum(size, 1e-300)[:, None], sideways)
    direction = np.stack([along, np.cross(normal, along, axis=1)])
    return Tangential(slip, direction, bound, slipping, share)


@dataclass(frozen=True, eq=False)
class CellEquations:
    """The equations (1) of an increment."""

    scene: CellScene
    start: CellState
    target: Target  # end of the increment

    @cached_property
    def _respond(self) -> Respond:
        return self.scene.begin(self.start.material, self.target.time_step)

    def at(self, u: np.ndarray, delta: float, active: np.ndarray | None = None) -> "Iterate":
        """Evaluate (1), and select the slipping nodes and, if not given, the contact nodes."""
        return self._with(self._respond(u), u, delta, active)

    def error_at_start(self, delta: float) -> float:
        """Residual of (1) at the start, with unchanged internal forces."""
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
        # contact points, pressure forces and contact nodes
        force = scene.surface(response.force)
        meeting = scene.meet(u, delta, target.slide)
        normal = meeting.normal
        pressure = -np.sum(force * normal, axis=1)
        trial = pressure - scene.weights[0] * meeting.gap
        if active is None:
            active = trial > 0.0
            if target.load and not active.any():  # at least one node carries the load
                active = trial == trial.max()
        # slipping nodes
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
        """Motion along the opposite side since the start, m."""
        start, scene = self.start, self.scene
        return scene.opposite.slip_since(
            scene.surfaces, start.displacement, start.approach, start.slide
        )


@dataclass(frozen=True, eq=False)
class Iterate:
    """The equations at a displacement."""

    equations: CellEquations
    response: BodyResponse
    u: np.ndarray  # m
    delta: float  # approach, m
    meeting: Meeting
    active: np.ndarray  # (nx, ny), contact nodes
    pressure: np.ndarray  # (nx, ny), pressure force p, N
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
        """Contact nodes that stick."""
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
        """Missing change of the vertical contact force, N; 0 at a given approach."""
        if self.target.load is None:
            return 0.0
        return -self.target.load - float(self.contact_force[:, 2].sum())

    @cached_property
    def distance(self) -> np.ndarray:
        """Missing prescribed motions, shape (rows, nx, ny), m."""
        rows = [np.where(self.active, self.meeting.gap, 0.0)]
        if self.friction is not None:
            rows += list(np.where(self.sticking, -self.friction.along(self.friction.slip), 0.0))
        return np.stack(rows)

    @cached_property
    def opens(self) -> bool:
        """Whether a prescribed motion is missing by more than rounding."""
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
        # equilibrium
        balance = self.response.force.copy()
        self.scene.surface(balance)[:] -= self.contact_force
        self.meeting.react(balance, self.contact_force)
        forces = float(np.vdot(balance, balance))
        # friction force of slipping nodes
        off = (
            self.contact_force
            + np.where(self.active, self.pressure, 0.0)[:, None] * self.meeting.normal
        )
        if self.friction is not None:
            off = off - self.friction.bound[:, None] * self.friction.direction[0]
            off = np.where(self.slipping[:, None], off, 0.0)
        forces += float(np.vdot(off, off))
        # prescribed motions, and tension
        weight = np.array([self.scene.weights[0]] + [self.scene.weights[1]] * 2)
        motion = self.distance * weight[: len(self.distance), None, None]
        tension = np.minimum(np.where(self.active, self.pressure, 0.0), 0.0)
        total = np.sqrt(forces + float(np.vdot(motion, motion)) + float(np.vdot(tension, tension)))
        missing = abs(self.missing) / self.target.load if self.target.load else 0.0
        if total == 0.0 and missing == 0.0:
            return 0.0
        return max(total / self.scale if self.scale > 0.0 else 1.0, missing)

    def _exchange(
        self, vector: np.ndarray, turned: np.ndarray | None, more: np.ndarray | float
    ) -> None:
        """Remove contact forces from the surface forces and add their reactions, in place."""
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
