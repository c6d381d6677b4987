"""What is solved on a cell beyond linear elasticity, where a step goes, and its states."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.finite.constraint import Support
from multiscale.micro.finite.finite_body import FiniteBody
from multiscale.micro.finite.height_obstacle import HeightObstacle, RigidMeeting
from multiscale.micro.flat_reference import Reference
from multiscale.surfaces.surface import Surface

__all__ = ["CellScene", "CellState", "Meeting", "Opponent", "RigidScene", "Target"]


class Meeting(Protocol):
    """Where the nodes of the body meet what is opposite."""

    @property
    def gap(self) -> np.ndarray:
        """Distance along the normal, shape (nx, ny), m; negative where the body is inside."""

    @property
    def normal(self) -> np.ndarray:
        """Unit normals out of the body, shape (nx, 3, ny)."""

    def relative(self, vector: np.ndarray) -> np.ndarray:
        """Motion of the nodes against what is opposite, but for its base, shape (nx, 3, ny)."""

    def react(self, vector: np.ndarray, force: np.ndarray) -> None:
        """Add to internal forces what contact forces on the nodes leave on the other side."""

    def turn(
        self, x: np.ndarray, shift: float, pressure: np.ndarray, force: np.ndarray, out: np.ndarray
    ) -> np.ndarray | float:
        """Find how a step turns pressure forces; add to ``out`` how it moves their points."""


class Opponent(Protocol):
    """What is opposite, before deformation."""

    @property
    def body(self) -> Surface:
        """Surface of the body, whose nodes carry the contact."""

    @property
    def shape(self) -> Surface | None:
        """Underside of what is opposite; flat if None."""

    @property
    def distance(self) -> float:
        """Offset of the underside's heights at first touch, m."""

    def mean_height(self, approach: float) -> float:
        """Mean height of the underside, m."""


@dataclass(frozen=True, eq=False)
class CellScene(ABC):
    r"""What does not change along a path.

    Attributes
    ----------
    body : Body
    obstacle : Opponent
    friction : float
        Local friction coefficient; 0 leaves out everything tangential.
    weights : tuple of float
        :math:`\rho_n` and :math:`\rho_t`, N/m.
    """

    body: FiniteBody
    obstacle: Opponent
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
        """Find where the body meets what is opposite."""

    @abstractmethod
    def slip_since(self, start: "CellState") -> Callable[..., np.ndarray]:
        """Return ``slip(u, approach, slide)``, the motion past what is opposite, m."""

    @abstractmethod
    def reference_at(self, meeting: Any) -> Support:
        """Return the reference for the preconditioner where both meet."""


@dataclass(frozen=True, eq=False)
class RigidScene(CellScene):
    """A body against a rigid obstacle.

    Attributes
    ----------
    obstacle : Obstacle
    reference : Reference
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
    """Where an increment ends: the load (N) or the approach (m), the slide (m) and its duration."""

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
        m.
    approach : float
        m.
    slide : ndarray, shape (2,)
        Of the obstacle, m.
    material : Any
        Internal variables of the body; None without any.
    force : ndarray, shape (nx, 3, ny)
        Of the obstacle on the body, N.
    active, slipping : ndarray of bool, shape (nx, ny)
        Contact nodes, and those of them that slip.
    dissipation : float
        Work of friction since the first state, J.
    status : Status
    residuals : tuple of float
        Forces out of balance and violations of contact, relative to the contact forces.
    linear_iterations : int
    flowing : float
        Share of the Gauss points that flow.
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
