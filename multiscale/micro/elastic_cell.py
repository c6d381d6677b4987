"""Cells of linear elastic bodies: questions to a contact solver, and its answers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.averages import ContactSurface, to_components
from multiscale.micro.contact_area import HALF_SPACE, EdgeLayer
from multiscale.micro.path import Target
from multiscale.micro.step_loop import Step

__all__ = ["ContactState", "ElasticCell", "at_first_touch", "obstacle_normal", "untouched"]


@dataclass(frozen=True)
class ContactState:
    """A solution of a contact problem, or the last iterate.

    Attributes
    ----------
    displacement : ndarray
        m.
    force : ndarray, contact forces, N
    approach : float
        m, counted from the first touch.
    active : ndarray of bool, contact nodes
    reference_force : ndarray
        Contact forces of the problem with :math:`K_0` in place of :math:`K`, N.
    status : Status
    residuals : tuple of float
        Norm of the forces out of balance over the norm of the contact forces, after each
        active-set iteration.
    linear_iterations : int
        Conjugate-gradient iterations in all.
    """

    displacement: np.ndarray
    force: np.ndarray
    approach: float
    active: np.ndarray
    reference_force: np.ndarray
    status: Status = Status.MAX_ITERATIONS
    residuals: tuple[float, ...] = ()
    linear_iterations: int = 0


@dataclass(frozen=True, eq=False)
class ElasticCell:
    """Model of a linear elastic cell: each step is solved, from the state of the one before.

    Attributes
    ----------
    solve : callable
        ``solve(load=, approach=, start=, tolerance=)`` returns a :class:`ContactState`.
    normal : ndarray, shape (nx, 3, ny) or (nodes, 3), unit normals into the obstacle
    surface_height, obstacle_height : ndarray
        Heights of the body before deformation and of the obstacle at first touch, m.
    node_area : ndarray, nominal area of each contact node, m2; they add up to the nominal area
    surface_displacement : callable, displacement of the contact nodes, components along axis 1, m
    recover : callable, optional
        ``recover(displacement, active)`` integrates the traction from the Cauchy stress over the
        facets that touch an active node, shape (3,), N.
    cap : float, largest contact force of a node, N
    edges : tuple of EdgeLayer, edges of contact on the grid of nodes, along x and y
    arrange : callable, contact surface with its nodes in the order in which it is averaged
    """

    solve: Callable[..., ContactState]
    normal: np.ndarray
    surface_height: np.ndarray
    obstacle_height: np.ndarray
    node_area: np.ndarray
    surface_displacement: Callable[[np.ndarray], np.ndarray]
    recover: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    cap: float = np.inf
    edges: tuple[EdgeLayer, EdgeLayer] = (HALF_SPACE, HALF_SPACE)
    arrange: Callable[[ContactSurface], ContactSurface] = lambda surface: surface
    remembers: ClassVar[bool] = False

    @property
    def area(self) -> float:
        """Area of the cell's projection on its mean plane, m2."""
        return float(np.sum(self.node_area))

    def rest(self) -> ContactState:
        """Return the state without load."""
        return self.solve(load=0.0)

    def step(self, state: ContactState, target: Target, tolerance: float) -> Step[ContactState]:
        """Solve for a target; a failed step leaves the state as it was."""
        answer = self.solve(
            load=target.load, approach=target.approach, start=state, tolerance=tolerance
        )
        cost = {
            "active_set_iterations": len(answer.residuals),
            "linear_iterations": answer.linear_iterations,
        }
        if answer.status is Status.CONVERGED:
            return Step(answer, cost)
        counts = (
            f"{len(answer.residuals)} active sets and {answer.linear_iterations} linear iterations"
        )
        return Step(state, cost, f"{counts}: {answer.status.value}")

    def surface(self, state: ContactState) -> ContactSurface:
        """Contact surface of a state."""
        moved = self.surface_displacement(state.displacement)
        gap = self.obstacle_height - state.approach - (self.surface_height + moved[:, 2])
        mean = [np.sum(self.node_area * moved[:, k]) for k in range(3)]
        recover = self.recover
        surface = ContactSurface(
            -state.force[:, None] * self.normal,
            self.normal,
            state.force,
            gap,
            self.node_area,
            self.node_area,
            np.array([-state.approach, 0.0, 0.0]) - to_components(np.array(mean)) / self.area,
            float(np.sum(self.node_area * gap)) / self.area,
            edges=self.edges,
            flowing=self.cap < np.inf and state.force >= self.cap,
            recovered_force=recover and recover(state.displacement, state.active),
        )
        return self.arrange(surface)


def at_first_touch(
    heights: np.ndarray, obstacle: np.ndarray | float = 0.0
) -> tuple[np.ndarray, float]:
    """Heights of an obstacle that touches a surface, and how far it is raised, m."""
    distance = float(np.max(heights - obstacle))
    return np.broadcast_to(obstacle + distance, heights.shape), distance


def obstacle_normal(slope_x: np.ndarray, slope_y: np.ndarray) -> np.ndarray:
    """Return unit normals into an obstacle from its slopes, components along axis 1."""
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=1)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def untouched(
    shape: tuple[int, ...], gap: np.ndarray, closing: np.ndarray, approach: float | None
) -> ContactState:
    """Return the state without contact forces, at first touch or before it."""
    nothing, rest = np.zeros_like(gap), np.broadcast_to(0.0, shape)  # takes no memory
    delta = float(np.min(gap / closing)) if approach is None else approach
    return ContactState(rest, nothing, delta, nothing > 0.0, nothing, Status.CONVERGED, (0.0,))
