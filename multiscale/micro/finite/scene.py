"""Scenes of cells with friction, large strain or two bodies, their targets and states."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.finite.constraint import Support
from multiscale.micro.finite.finite_body import FiniteBody
from multiscale.micro.finite.height_obstacle import HeightObstacle, RigidMeeting
from multiscale.micro.finite.two_bodies import PairMeeting, Underside
from multiscale.micro.flat_reference import Reference

__all__ = ["CellScene", "CellState", "Meeting", "RigidScene", "Target"]


Meeting = RigidMeeting | PairMeeting
"""Contact points between the nodes of the body and the opposite side."""


@dataclass(frozen=True, eq=False)
class CellScene(ABC):
    r"""The constant data of a path on a cell.

    Attributes
    ----------
    body : FiniteBody
    obstacle : HeightObstacle or Underside
        The opposite side before deformation.
    friction : float
        Local friction coefficient, dimensionless; 0 leaves out all tangential equations.
    weights : tuple of float
        Weights :math:`\rho_n` and :math:`\rho_t` of the contact equations, N/m.
    """

    body: FiniteBody
    obstacle: HeightObstacle | Underside
    friction: float
    weights: tuple[float, float]

    @property
    @abstractmethod
    def vertical(self) -> tuple[np.ndarray, np.ndarray]:
        """Symbols of the vertical compliance of the surface and of an approximate inverse."""

    @property
    def grid(self) -> tuple[int, int]:
        """Points of the surface."""
        nx, ny = self.obstacle.body.heights.shape
        return nx, ny

    @abstractmethod
    def surface(self, vector: np.ndarray) -> np.ndarray:
        """Part of a displacement or force at the surface, a view of shape (nx, 3, ny)."""

    @abstractmethod
    def meet(self, u: np.ndarray, approach: float, slide: np.ndarray) -> Meeting:
        """Find the contact points at a displacement, m, an approach, m, and a slide, (2,), m."""

    @abstractmethod
    def slip_since(self, start: "CellState") -> Callable[..., np.ndarray]:
        """Return ``slip(u, approach, slide)``, the motion past the opposite side, m."""

    @abstractmethod
    def reference_at(self, meeting: Any) -> Support:
        """Return the reference of the preconditioner at the contact points of a meeting."""


@dataclass(frozen=True, eq=False)
class RigidScene(CellScene):
    """A body against a rigid obstacle.

    Attributes
    ----------
    obstacle : HeightObstacle
    reference : Reference
        Flat cell for the preconditioner.
    """

    obstacle: HeightObstacle
    reference: Reference

    @property
    def vertical(self) -> tuple[np.ndarray, np.ndarray]:
        """Symbols of the vertical compliance of the surface and of an approximate inverse."""
        return self.reference.vertical

    def surface(self, vector: np.ndarray) -> np.ndarray:
        """Part of a displacement or force at the surface, a view of shape (nx, 3, ny)."""
        return np.asarray(vector[:, -1])

    def meet(self, u: np.ndarray, approach: float, slide: np.ndarray) -> RigidMeeting:
        """Find where the body meets the obstacle."""
        return self.obstacle.meet(self.surface(u), approach, slide)

    def slip_since(self, start: "CellState") -> Callable[..., np.ndarray]:
        """Return ``slip(u, approach, slide)``, the motion past the obstacle, m."""

        def slip(u: np.ndarray, approach: float, slide: np.ndarray) -> np.ndarray:
            moved = self.surface(u) - self.surface(start.displacement)
            moved[:, :2] -= (slide - start.slide)[None, :, None]
            moved[:, 2] += approach - start.approach
            return np.asarray(moved)

        return slip

    def reference_at(self, meeting: Any) -> Reference:
        """Return the reference; it is the same everywhere."""
        return self.reference


@dataclass(frozen=True, eq=False)
class Target:
    """End of an increment.

    Attributes
    ----------
    load : float or None
        Vertical load, N; None if the approach is prescribed.
    approach : float or None
        Approach of the obstacle, m; None if the load is prescribed.
    slide : ndarray, shape (2,)
        Displacement of the obstacle in its plane, m.
    time_step : float
        Duration, s.
    """

    load: float | None
    approach: float | None
    slide: np.ndarray
    time_step: float = 0.0


@dataclass(frozen=True, eq=False)
class CellState:
    """A state of the cell in equilibrium, or the last iterate.

    Attributes
    ----------
    displacement : ndarray, shape (nx, layers, 3, ny)
        Displacement of the body, m; a flat vector for two bodies.
    approach : float
        Approach of the obstacle since the first touch, m.
    slide : ndarray, shape (2,)
        Displacement of the obstacle in its plane, m.
    material : Any
        Internal variables of the body; None without any.
    force : ndarray, shape (nx, 3, ny)
        Force of the obstacle on the body, N.
    active : ndarray of bool, shape (nx, ny)
        Contact nodes.
    slipping : ndarray of bool, shape (nx, ny)
        Contact nodes that slip.
    dissipation : float
        Work of friction since the first state, J.
    status : Status
        Why the Newton iteration stopped.
    residuals : tuple of float
        Forces out of balance and violations of contact after each Newton iteration, relative to
        the contact forces.
    linear_iterations : int
        Linear iterations of the increment.
    flowing : float
        Share of the Gauss points that flow, 0 to 1.
    peak : float
        Largest norm of the contact forces so far, N.
    """

    displacement: np.ndarray
    approach: float
    slide: np.ndarray
    material: Any
    force: np.ndarray
    active: np.ndarray
    slipping: np.ndarray
    dissipation: float = 0.0
    status: Status = Status.MAX_ITERATIONS
    residuals: tuple[float, ...] = ()
    linear_iterations: int = 0
    flowing: float = 0.0
    peak: float = 0.0

    @property
    def load(self) -> float:
        """Vertical load that the contact carries, N."""
        return -float(self.force[:, 2].sum())
