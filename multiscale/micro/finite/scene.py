"""Scenes of cells with friction, large strain or two bodies, their targets and states."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.finite.constraint import Support
from multiscale.micro.finite.finite_body import FiniteBody
from multiscale.micro.finite.height_obstacle import HeightObstacle, RigidMeeting
from multiscale.micro.finite.two_bodies import PairMeeting, Underside
from multiscale.micro.flat import solve_flat
from multiscale.micro.flat_reference import Reference
from multiscale.micro.lateral_fft import SurfaceFilter

if TYPE_CHECKING:
    from multiscale.micro.finite.equations import Iterate

__all__ = [
    "CellScene",
    "CellState",
    "GraphScene",
    "Meeting",
    "RigidScene",
    "touch_flat",
]


Meeting = RigidMeeting | PairMeeting
"""Contact points between the nodes of the body and the opposite side."""


@dataclass(frozen=True, eq=False)
class CellScene(ABC):
    r"""The constant data of a path on a cell.

    Attributes
    ----------
    body : FiniteBody
    obstacle : HeightObstacle or Underside, the opposite side before deformation
    friction : float
        Local friction coefficient, dimensionless; 0 leaves out all tangential equations.
    weights : tuple of float
        Weights :math:`\rho_n` and :math:`\rho_t` of the contact equations, N/m.
    """

    body: FiniteBody
    obstacle: HeightObstacle | Underside
    friction: float
    weights: tuple[float, float]

    @abstractmethod
    def first_touch(
        self, gap: np.ndarray, closing: np.ndarray, load: float
    ) -> tuple[np.ndarray, float]:
        """Estimate contact nodes and approach, m, of an open cell under a load, N."""

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

    def reference_at(self, meeting: Any) -> Support:
        """Return the reference of the preconditioner at the contact points of a meeting."""
        raise TypeError(f"{type(self).__name__} takes Newton steps without a reference")

    def newton_step(
        self, now: "Iterate", forcing: float, floor: float
    ) -> tuple[np.ndarray, float, int]:
        """Solve the linear problem of a Newton step; see :meth:`Iterate.newton_step`."""
        return now.newton_step(forcing, floor)


def touch_flat(
    compliance: SurfaceFilter, gap: np.ndarray, closing: np.ndarray, load: float
) -> tuple[np.ndarray, float]:
    """Contact nodes and approach, m, of a flat cell with its vertical compliance."""
    found = solve_flat(compliance, gap, closing, load=load)
    return found.value > 0.0, found.approach


@dataclass(frozen=True, eq=False)
class RigidScene(CellScene):
    """A body against a rigid obstacle.

    Attributes
    ----------
    obstacle : HeightObstacle
    """

    obstacle: HeightObstacle

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


@dataclass(frozen=True, eq=False)
class GraphScene(RigidScene):
    """A layer whose top is a graph, against a rigid obstacle.

    Attributes
    ----------
    reference : Reference, flat cell for the preconditioner
    """

    reference: Reference

    def first_touch(
        self, gap: np.ndarray, closing: np.ndarray, load: float
    ) -> tuple[np.ndarray, float]:
        """Press the flat cell."""
        return touch_flat(self.reference.vertical[0], gap, closing, load)

    def surface(self, vector: np.ndarray) -> np.ndarray:
        """Part of a displacement or force at the surface, a view of shape (nx, 3, ny)."""
        return np.asarray(vector[:, -1, :3])

    def reference_at(self, meeting: Any) -> Reference:
        """Return the reference; it is the same everywhere."""
        return self.reference


@dataclass(frozen=True, eq=False)
class CellState:
    """A state of the cell in equilibrium, or the last iterate.

    Attributes
    ----------
    displacement : ndarray, shape (nx, layers, 3, ny)
        Displacement of the body, m; a flat vector for two bodies.
    approach : float, approach of the obstacle since the first touch, m
    slide : ndarray, shape (2,), displacement of the obstacle in its plane, m
    material : Any, internal variables of the body; None without any
    force : ndarray, shape (nx, 3, ny), force of the obstacle on the body, N
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
    moved: np.ndarray | None = None
    change: np.ndarray = field(default_factory=lambda: np.zeros(5))

    @property
    def load(self) -> float:
        """Vertical load that the contact carries, N."""
        return -float(self.force[:, 2].sum())
