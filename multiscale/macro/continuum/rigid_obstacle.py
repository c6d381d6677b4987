"""Rigid obstacles: signed distance and normal."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.continuum.body import Value

__all__ = [
    "RigidCylinder",
    "RigidGraph",
    "RigidObstacle",
    "RigidPlane",
    "RigidSphere",
    "obstacle_motion",
]


class RigidObstacle(ABC):
    """A rigid surface that moves without turning; every obstacle takes a ``motion``.

    Attributes
    ----------
    motion : sequence of Value
        Displacement of the obstacle, m: a number per component, multiplied by the time of the
        step, or a function ``motion(position, time)``; at rest if empty.
    """

    motion: Sequence[Value] = ()

    @abstractmethod
    def distance(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance (m, negative inside) and outward normal, shape (n, d), of points (n, d).

        The obstacle stands where it was at the start.
        """


@dataclass(frozen=True)
class RigidPlane(RigidObstacle):
    """A half-space.

    Parameters
    ----------
    point, normal : sequence of float
        A point of the plane, m, and its normal out of the obstacle, to the body; of any length.
    """

    point: Sequence[float]
    normal: Sequence[float]
    motion: Sequence[Value] = ()

    def __post_init__(self) -> None:
        _check_direction(self.normal, "the normal of a plane")

    def distance(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance along the normal."""
        n = np.asarray(self.normal) / np.linalg.norm(self.normal)
        return (x - np.asarray(self.point)) @ n, np.broadcast_to(n, x.shape)


@dataclass(frozen=True)
class RigidSphere(RigidObstacle):
    """A ball; in two dimensions a disc.

    Parameters
    ----------
    centre : sequence of float, m
    radius : float, m
    """

    centre: Sequence[float]
    radius: float
    motion: Sequence[Value] = ()

    def __post_init__(self) -> None:
        _check_radius(self.radius)

    def distance(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance from the centre less the radius."""
        return _from_centre(x - np.asarray(self.centre), self.radius)


@dataclass(frozen=True)
class RigidCylinder(RigidObstacle):
    """An endless round bar in three dimensions.

    Parameters
    ----------
    point, axis : sequence of float, a point of the axis, m, and its direction, of any length
    radius : float, m
    """

    point: Sequence[float]
    axis: Sequence[float]
    radius: float
    motion: Sequence[Value] = ()

    def __post_init__(self) -> None:
        _check_radius(self.radius)
        _check_direction(self.axis, "the axis of a cylinder")

    def distance(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance from the axis less the radius."""
        axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
        arm = x - np.asarray(self.point)
        return _from_centre(arm - np.outer(arm @ axis, axis), self.radius)


@dataclass(frozen=True)
class RigidGraph(RigidObstacle):
    """All that lies above a height (or below it).

    Parameters
    ----------
    height, slope : callable
        Height of the surface over the lateral positions, shape (d - 1, n), m, and its derivatives,
        shape (d - 1, n), dimensionless.
    above : bool, default True, whether the obstacle lies above its surface

    Notes
    -----
    The distance is that to the tangent plane over (or under) the point: exact in contact.
    """

    height: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]
    above: bool = True
    motion: Sequence[Value] = ()

    def distance(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance to the tangent plane."""
        lateral = x[:, :-1].T
        slope = np.broadcast_to(self.slope(lateral), lateral.shape)
        normal = np.concatenate([slope, -np.ones((1, len(x)))]).T
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        side = 1.0 if self.above else -1.0
        gap = side * (x[:, -1] - self.height(lateral)) * normal[:, -1]
        return gap, side * normal


def obstacle_motion(obstacle: RigidObstacle, dim: int, time: float) -> np.ndarray:
    """Displacement of an obstacle at a time, shape (dim,), m."""
    if not obstacle.motion:
        return np.zeros(dim)
    if len(obstacle.motion) != dim:
        raise CaseError(
            f"the motion of an obstacle needs {dim} components, got {len(obstacle.motion)}"
        )
    origin = np.zeros((dim, 1))
    values = [v(origin, time) if callable(v) else v * time for v in obstacle.motion]
    motion = np.array([float(np.ravel(np.asarray(v))[0]) for v in values])
    if not np.all(np.isfinite(motion)):
        raise CaseError(f"the motion of an obstacle is NaN or infinite at time {time:g}")
    return motion


def _from_centre(arm: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Distance and normal from the vectors to the centre."""
    length = np.linalg.norm(arm, axis=1, keepdims=True)
    return length[:, 0] - radius, arm / np.where(length > 0.0, length, 1.0)


def _check_radius(radius: float) -> None:
    if not (radius > 0.0 and np.isfinite(radius)):
        raise CaseError(f"the radius of an obstacle must be positive (m), got {radius}")


def _check_direction(vector: Sequence[float], what: str) -> None:
    length = float(np.linalg.norm(vector))
    if not (length > 0.0 and np.isfinite(length)):
        raise CaseError(f"{what} needs a direction, got {tuple(vector)}")
