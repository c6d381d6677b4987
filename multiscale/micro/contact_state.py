"""Questions to a contact solver and its answers, for every kind of cell."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from multiscale.convergence import Status
from multiscale.micro import averages
from multiscale.micro.contact_area import HALF_SPACE, EdgeLayer, contact_areas
from multiscale.micro.spots import grid_neighbours, spot_averages

__all__ = ["CellProblem", "ContactState", "average_contact", "obstacle_normal", "untouched"]


@dataclass(frozen=True, eq=False)
class CellProblem:
    """How a cell answers a load, and the geometry of its contact nodes.

    Attributes
    ----------
    solve : callable
        ``solve(load=, approach=, start=, tolerance=)`` returns a :class:`ContactState`.
    normal : ndarray
        Unit normals into the obstacle, components along axis 1: shape (nx, 3, ny) for a graph
        cell, (nodes, 3) otherwise.
    surface_height, obstacle_height : ndarray
        Heights of the body before deformation and of the obstacle at first touch, m.
    weight : ndarray, nominal area of each contact node, m2; they add up to the nominal area
    surface_displacement : callable, displacement of the contact nodes, components along axis 1, m
    recover : callable
        ``recover(displacement, active)`` integrates the traction from the Cauchy stress over the
        facets that touch an active node, shape (3,), N; None where there is no stress field.
    cap : float, largest contact force of a node, N
    edges : tuple of EdgeLayer, edges of contact on the grid of nodes, along x and y
    neighbours : callable
        Pairs of contact nodes that are next to each other, shape (2, pairs), counted in their
        order; a periodic grid's if not given.
    field : callable, values on the grid of fields, (nx, ny), from values at contact nodes
    arrange : callable
        Values at contact nodes in the order of this problem, from those in the order of a mesh.
    """

    solve: Callable[..., "ContactState"]
    normal: np.ndarray
    surface_height: np.ndarray
    obstacle_height: np.ndarray
    weight: np.ndarray
    surface_displacement: Callable[[np.ndarray], np.ndarray]
    recover: Callable[[np.ndarray, np.ndarray], np.ndarray] | None
    cap: float = np.inf
    edges: tuple[EdgeLayer, EdgeLayer] = (HALF_SPACE, HALF_SPACE)
    neighbours: Callable[[], np.ndarray] | None = None
    field: Callable[[np.ndarray], np.ndarray] = np.asarray
    arrange: Callable[[np.ndarray], np.ndarray] = np.asarray

    @property
    def nominal_area(self) -> float:
        """Area of the cell's projection on its mean plane, m2."""
        return float(np.sum(self.weight))


def obstacle_normal(slope_x: np.ndarray, slope_y: np.ndarray) -> np.ndarray:
    """Return unit normals into an obstacle from its slopes, components along axis 1."""
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=1)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


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


def untouched(
    shape: tuple[int, ...], gap: np.ndarray, closing: np.ndarray, approach: float | None
) -> ContactState:
    """Return the state without contact forces, at first touch or before it."""
    nothing = np.zeros_like(gap)
    touch = float(np.min(gap / closing))
    delta = touch if approach is None else approach
    return ContactState(
        np.zeros(shape), nothing, delta, nothing > 0.0, nothing, Status.CONVERGED, (0.0,)
    )


def average_contact(
    problem: CellProblem,
    state: ContactState,
    *,
    friction: np.ndarray | None = None,
    weight: np.ndarray | None = None,
    fields: bool,
    spots: bool,
) -> dict[str, Any]:
    """Averages of one converged step, and pressure and vertical gap at every node, (ny, nx)."""
    area, now = problem.nominal_area, problem.weight if weight is None else weight
    moved = problem.surface_displacement(state.displacement)

    def mean(weight: np.ndarray, field: np.ndarray) -> np.ndarray:
        return np.array([np.sum(weight * field[:, k]) / area for k in (2, 0, 1)])

    traction = -mean(state.force, problem.normal)
    if friction is not None:
        traction += averages.average_traction(friction, area)
    real = contact_areas(state.force, now, edges=problem.edges, flowing=state.force >= problem.cap)
    step = {
        "traction": traction,
        "displacement_jump": np.array([-state.approach, 0.0, 0.0]) - mean(problem.weight, moved),
        "mean_gap": averages.mean_gap(
            problem.obstacle_height - state.approach, problem.surface_height + moved[:, 2], now
        ),
        "contact_fraction": max(float(np.sum(real)) / area, 0.0),
    }
    if spots:
        beside = problem.neighbours() if problem.neighbours else grid_neighbours(now.shape)
        by_normal = np.moveaxis(-state.force[:, None] * problem.normal, 1, -1).reshape(-1, 3)
        nodal = by_normal if friction is None else by_normal + friction
        active = state.force.ravel() > 0.0
        step |= spot_averages(nodal, by_normal, real.ravel(), active, beside, area)
    if problem.recover is not None:
        force = problem.recover(state.displacement, state.active)
        step["recovered_traction"] = averages.average_traction(force[None], area)
    if fields:
        deformed = problem.surface_height + moved[:, 2]
        gap = problem.obstacle_height - state.approach - deformed
        closed = state.force > 0.0  # below overhangs the projected area is none, or negative
        pressure = np.zeros_like(state.force)
        np.divide(state.force * problem.normal[:, 2], problem.weight, out=pressure, where=closed)
        step["pressure"], step["gap"] = (problem.field(one).T for one in (pressure, gap))
    return step
