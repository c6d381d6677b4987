"""Bodies, targets and states of cells with friction, large strain or two bodies."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from scipy.sparse import csr_array

from multiscale.convergence import Status
from multiscale.micro.finite.surfaces import Meeting, OppositeSide

__all__ = [
    "BodyResponse",
    "CellScene",
    "CellState",
    "FiniteBody",
    "Increment",
    "LinearSolver",
    "linear_body",
    "rest_state",
]


@dataclass(frozen=True, eq=False)
class BodyResponse:
    """Response of a body, or of all bodies of a scene, to a displacement.

    Attributes
    ----------
    force : ndarray, internal forces, N, in the shape of the displacement
    tangent : callable
        ``tangent(v)``, their derivative times a displacement v, N; valid until the next response of
        the body is computed.
    least_dilatation : float
        Smallest det F of all Gauss points, dimensionless. The forces are undefined unless it is
        positive.
    flowing : float, share of the Gauss points that flow, 0 to 1
    matrix : csr_array, optional
        The tangent as a matrix, of a body that assembles one, N/m.
    """

    force: np.ndarray
    tangent: Callable[[np.ndarray], np.ndarray]
    least_dilatation: float = 1.0
    flowing: float = 0.0
    matrix: csr_array | None = None


@dataclass(frozen=True, eq=False)
class Increment:
    """One step in time from a known state.

    Attributes
    ----------
    respond : callable
        ``respond(displacement)``, displacement in m, returns a :class:`BodyResponse`.
    finish : callable
        ``finish(displacement)`` returns the internal variables at the end of the step.
    """

    respond: Callable[[np.ndarray], BodyResponse]
    finish: Callable[[np.ndarray], Any]


def layer_top(displacement: np.ndarray) -> np.ndarray:
    """Surface of a layer of shape (nx, layers, 3 or 4, ny), a view of shape (nx, 3, ny)."""
    return displacement[:, -1, :3]


@dataclass(frozen=True, eq=False)
class FiniteBody:
    """A deformable body.

    Attributes
    ----------
    shape : tuple of int, of its displacement: (nx, layers, 3 or 4, ny) of a layer
    begin : callable
        ``begin(state, time_step)``, time step in s, returns an :class:`Increment`.
    rest : callable
        ``rest()`` returns the internal variables before any load; None for a body without any.
    surface : callable
        ``surface(displacement)``, its part at the surface, a view of shape (nx, 3, ny).
    """

    shape: tuple[int, ...]
    begin: Callable[[Any, float], Increment]
    rest: Callable[[], Any]
    surface: Callable[[np.ndarray], np.ndarray] = layer_top


def linear_body(apply: Callable[[np.ndarray], np.ndarray], shape: tuple[int, ...]) -> FiniteBody:
    """Return a linear elastic layer, with ``apply(u)`` its stiffness times a displacement, N."""
    increment = Increment(lambda u: BodyResponse(apply(u), apply), lambda u: None)
    return FiniteBody(shape, lambda state, time_step: increment, lambda: None)


@dataclass(frozen=True, eq=False)
class CellState:
    """A state of the cell in equilibrium, or the last iterate.

    Attributes
    ----------
    displacement : ndarray, displacements of all bodies, m, as a vector
    approach : float, approach of the opposite side since the first touch, m
    slide : ndarray, shape (2,), displacement of the opposite side in its plane, m
    material : tuple, internal variables of each body; None for a body without any
    force : ndarray, shape (nx, 3, ny), force of the opposite side on the first body, N
    active : ndarray of bool, shape (nx, ny), contact nodes
    slipping : ndarray of bool, shape (nx, ny), contact nodes that slip
    dissipation : float, work of friction since the first state, J
    status : Status, why the Newton iteration stopped
    residuals : tuple of float
        Forces out of balance and violations of contact after each Newton iteration, relative to
        the contact forces.
    linear_iterations : int, linear iterations of the increment
    flowing : float, share of the Gauss points that flow, 0 to 1
    peak : float, largest norm of the contact forces so far, N
    moved : ndarray or None, change of the displacement in the last increment, m
    change : ndarray, shape (5,)
        Changes of slide, m, load, N, approach, m, and time, s, in the last increment.
    """

    displacement: np.ndarray
    approach: float
    slide: np.ndarray
    material: tuple[Any, ...]
    force: np.ndarray
    active: np.ndarray
    slipping: np.ndarray
    dissipation: float = 0.0
    status: Status = Status.MAX_ITERATIONS
    residuals: tuple[float, ...] = ()
    linear_iterations: int = 0
    flowing: float = 0.0
    peak: float = 0.0
    moved: np.ndarray | None = None
    change: np.ndarray = field(default_factory=lambda: np.zeros(5))

    @property
    def load(self) -> float:
        """Vertical load that the contact carries, N."""
        return -float(self.force[:, 2].sum())


class LinearSolver(Protocol):
    """Solves the linear problems of Newton steps, and the elastic cell for a first estimate."""

    def touch(self, gap: np.ndarray, closing: np.ndarray, load: float) -> tuple[np.ndarray, float]:
        """Estimate contact nodes and approach, m, of an open cell under a load, N."""

    def step(self, now: Any, forcing: float, floor: float) -> tuple[np.ndarray, float, int]:
        """Solve for a step from an iterate: displacement, m, approach, m, and linear iterations.

        ``forcing`` is the tolerance relative to the residual, ``floor`` relative to its scale.
        """


@dataclass(frozen=True, eq=False)
class CellScene:
    r"""The constant data of a path on a cell: one body against a rigid side, or two bodies.

    Vectors contain the displacements of, or the forces on, all bodies. The second body is in its
    own frame, in which z points out of its surface.

    Attributes
    ----------
    bodies : tuple of FiniteBody, one or two
    opposite : OppositeSide
    friction : float
        Local friction coefficient, dimensionless; 0 leaves out all tangential equations.
    weights : tuple of float
        Weights :math:`\rho_n` and :math:`\rho_t` of the contact equations, N/m.
    solver : LinearSolver
    """

    bodies: tuple[FiniteBody, ...]
    opposite: OppositeSide
    friction: float
    weights: tuple[float, float]
    solver: LinearSolver

    def split(self, vector: np.ndarray) -> list[np.ndarray]:
        """Return the field of each body, as views."""
        ends = np.cumsum([np.prod(body.shape) for body in self.bodies])[:-1]
        parts = zip(np.split(vector, ends), self.bodies, strict=True)
        return [part.reshape(body.shape) for part, body in parts]

    def surfaces(self, vector: np.ndarray) -> list[np.ndarray]:
        """Return the field at the surface of each body, views of shape (nx, 3, ny)."""
        parts = zip(self.bodies, self.split(vector), strict=True)
        return [body.surface(part) for body, part in parts]

    def surface(self, vector: np.ndarray) -> np.ndarray:
        """Return the field at the surface of the first body, a view of shape (nx, 3, ny)."""
        return self.surfaces(vector)[0]

    def begin(self, material: tuple[Any, ...], time_step: float) -> Increment:
        """Begin a time step, s, of all bodies, as a function of vectors."""
        states = zip(self.bodies, material, strict=True)
        steps = [body.begin(state, time_step) for body, state in states]
        sizes = [float(np.prod(body.shape)) for body in self.bodies]

        def respond(u: np.ndarray) -> BodyResponse:
            responses = [step.respond(v) for step, v in zip(steps, self.split(u), strict=True)]

            def tangent(v: np.ndarray) -> np.ndarray:
                parts = zip(responses, self.split(v), strict=True)
                return join([response.tangent(part) for response, part in parts])

            return BodyResponse(
                join([response.force for response in responses]),
                tangent,
                min(response.least_dilatation for response in responses),
                float(np.average([response.flowing for response in responses], weights=sizes)),
                responses[0].matrix,
            )

        def finish(u: np.ndarray) -> tuple[Any, ...]:
            return tuple(step.finish(v) for step, v in zip(steps, self.split(u), strict=True))

        return Increment(respond, finish)

    def meet(self, u: np.ndarray, approach: float, slide: np.ndarray) -> Meeting:
        """Find the contact points at a displacement, m, an approach, m, and a slide, (2,), m."""
        return self.opposite.meet(self.surfaces, u, approach, slide)


def join(fields: list[np.ndarray]) -> np.ndarray:
    """Concatenate the fields of all bodies."""
    return np.concatenate([part.reshape(-1) for part in fields])


def rest_state(scene: CellScene) -> CellState:
    """Return the cell before any load."""
    nx, ny = scene.opposite.body.heights.shape
    nothing = np.zeros((nx, ny), dtype=bool)
    return CellState(
        join([np.zeros(body.shape) for body in scene.bodies]),
        0.0,
        np.zeros(2),
        tuple(body.rest() for body in scene.bodies),
        np.zeros((nx, 3, ny)),
        nothing,
        nothing,
        status=Status.CONVERGED,
        residuals=(0.0,),
    )
