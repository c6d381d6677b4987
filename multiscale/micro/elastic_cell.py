"""Model of linear elastic cells: calls of a contact solver, and averages of its solution."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.averages import ContactSurface, to_components
from multiscale.micro.contact_area import HALF_SPACE, EdgeLayer
from multiscale.micro.path import Step, Target


@dataclass(frozen=True)
class ContactState:
    """A solution of a contact problem, or the last iterate."""

    displacement: np.ndarray  # m
    force: np.ndarray  # contact forces, N
    approach: float  # counted from the first touch, m
    active: np.ndarray  # contact nodes
    reference_force: np.ndarray  # contact forces of the problem with K_0 in place of K, N
    status: Status = Status.MAX_ITERATIONS
    residuals: tuple[float, ...] = ()  # relative residual force after each iteration
    linear_iterations: int = 0


@dataclass(frozen=True, eq=False)
class ElasticCell:
    """Model of a linear elastic cell; each step starts from the previous state."""

    solve: Callable[..., ContactState]  # solve(load=, approach=, start=, tolerance=)
    normal: np.ndarray  # (nx, 3, ny) or (nodes, 3), unit normals into the obstacle
    surface_height: np.ndarray  # of the body before deformation, m
    obstacle_height: np.ndarray  # at first touch, m
    node_area: np.ndarray  # nominal area of each contact node, m2
    surface_displacement: Callable[[np.ndarray], np.ndarray]  # of the nodes, components in axis 1
    recover: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None  # stress to force, N
    cap: float = np.inf  # largest contact force of a node, N
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
        """Solve for a target; a failed step returns the previous state."""
        solution = self.solve(
            load=target.load, approach=target.approach, start=state, tolerance=tolerance
        )
        cost = {
            "active_set_iterations": len(solution.residuals),
            "linear_iterations": solution.linear_iterations,
        }
        if solution.status is Status.CONVERGED:
            return Step(solution, cost)
        counts = (
            f"{cost['active_set_iterations']} active sets and {cost['linear_iterations']} linear "
            f"iterations"
        )
        return Step(state, cost, f"{counts}: {solution.status.value}")

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
