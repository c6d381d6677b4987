"""Bodies of a granulate: grains, and plane and round walls."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from multiscale.errors import CaseError, require

PLANE, CYLINDER = 0, 1  # kinds of walls in arrays of all walls


@dataclass(frozen=True)
class Grains:
    """Rigid spheres, or discs that move in a plane.

    Parameters
    ----------
    position : ndarray, shape (grains, 3)
        Centres, m. Discs have the same y.
    radius : ndarray, shape (grains,), radii, m
    density : float or ndarray, shape (grains,), density, kg/m3
    velocity, spin : ndarray, shape (grains, 3), optional
        Velocities, m/s, and angular velocities, rad/s; zero if not given.
    thickness : float, optional, thickness of discs, m; the grains are spheres if it is not given

    Raises
    ------
    CaseError
        If a size or density is not positive, a vector is not finite, or discs leave their plane.
    """

    position: np.ndarray
    radius: np.ndarray
    density: float | np.ndarray = 2600.0
    velocity: np.ndarray | None = None
    spin: np.ndarray | None = None
    thickness: float | None = None

    def __post_init__(self) -> None:
        position = np.atleast_2d(np.asarray(self.position, dtype=float))
        shape = position.shape
        if len(shape) != 2 or shape[1] != 3 or shape[0] == 0:
            raise CaseError(f"position must have shape (grains, 3), got {shape}")
        fields = {
            "position": position,
            "radius": np.broadcast_to(np.asarray(self.radius, dtype=float), shape[:1]).copy(),
            "density": np.broadcast_to(np.asarray(self.density, dtype=float), shape[:1]).copy(),
        }
        for name in ("velocity", "spin"):
            given = getattr(self, name)
            fields[name] = np.zeros(shape) if given is None else np.asarray(given, dtype=float)
            if fields[name].shape != shape:
                raise CaseError(f"{name} must have shape {shape}, got {fields[name].shape}")
        for name, unit in (("radius", "m"), ("density", "kg/m3")):
            wrong = ~((fields[name] > 0.0) & np.isfinite(fields[name]))
            if wrong.any():
                i = int(np.argmax(wrong))
                raise CaseError(
                    f"{name} of grain {i} must be positive ({unit}), got {fields[name][i]:g}"
                )
        for name in ("position", "velocity", "spin"):
            wrong = ~np.isfinite(fields[name]).all(axis=1)
            if wrong.any():
                raise CaseError(f"{name} of grain {int(np.argmax(wrong))} must be finite")
        if self.thickness is not None:
            y = position[:, 1]
            require("thickness of discs", self.thickness, "(0, inf)", "m")
            out = (y != y[0]) | (fields["velocity"][:, 1] != 0.0)
            out |= np.any(fields["spin"][:, ::2], axis=1)
            if out.any():
                raise CaseError(
                    f"disc {int(np.argmax(out))} leaves the plane y = {y[0]:g} m; discs must have "
                    f"the same y, no velocity along y and spin only about y"
                )
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        """Number of grains."""
        return len(self.radius)

    @property
    def planar(self) -> bool:
        """Whether the grains are discs."""
        return self.thickness is not None

    @property
    def volume(self) -> np.ndarray:
        """Volumes, shape (grains,), m3."""
        if self.thickness is None:
            return np.asarray(4.0 / 3.0 * np.pi * self.radius**3)
        return np.asarray(np.pi * self.radius**2 * self.thickness)

    @property
    def mass(self) -> np.ndarray:
        """Masses, shape (grains,), kg."""
        return np.asarray(self.density * self.volume)

    @property
    def inertia(self) -> np.ndarray:
        """Moments of inertia about the axis of rotation, shape (grains,), kg m2."""
        return np.asarray((0.5 if self.planar else 0.4) * self.mass * self.radius**2)

    def moved(
        self, position: np.ndarray, velocity: np.ndarray, spin: np.ndarray | None = None
    ) -> Self:
        """Return the same grains with another motion, without spin if none is given."""
        return replace(self, position=position, velocity=velocity, spin=spin)


@dataclass(frozen=True)
class Wall:
    """Common parameters of plane and round walls.

    Parameters
    ----------
    point : array_like, shape (3,), point on the plane or the axis, m
    direction : array_like, shape (3,), normal towards the grains, or axis; of any length
    velocity : array_like, shape (3,)
        Prescribed velocity, m/s; of a loaded plane only the in-plane components are prescribed.
    friction : float, optional
        Coefficient against grains, dimensionless; the coefficient of the grains if not given.
    """

    point: tuple[float, float, float]
    direction: tuple[float, float, float]
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    friction: float | None = None

    def __post_init__(self) -> None:
        for name in ("point", "direction", "velocity"):
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != (3,) or not np.all(np.isfinite(value)):
                raise CaseError(f"{name} of a wall must be three finite numbers, got {value}")
        if not np.any(np.asarray(self.direction)):
            raise CaseError("direction of a wall must not be zero; give its normal or its axis")
        if self.friction is not None:
            require("friction of a wall", self.friction, "[0, inf)")

    @property
    def unit(self) -> np.ndarray:
        """Unit vector of the direction."""
        direction = np.asarray(self.direction, dtype=float)
        return np.asarray(direction / np.linalg.norm(direction))

    @property
    def mobility(self) -> float:
        """Inverse of the mass along the direction, 1/kg; zero if the motion is prescribed."""
        return 0.0

    @property
    def acceleration(self) -> np.ndarray:
        """Acceleration without grains, shape (3,), m/s2."""
        return np.zeros(3)

    @property
    def bore(self) -> float:
        """Inner radius of a pipe, m; zero for a plane."""
        return 0.0

    def holds(self, gravity: np.ndarray) -> bool:
        """Whether the wall supports grains against gravity."""
        return float(self.unit @ gravity) < 0.0


@dataclass(frozen=True)
class PlaneWall(Wall):
    """Infinite plane: fixed, moved with a velocity, or loaded along its normal.

    Parameters
    ----------
    mass : float, mass of a loaded plane, kg; infinite if the plane is fixed or moved
    force : float
        Force on a loaded plane along its normal, N: positive presses it against the grains.

    Raises
    ------
    CaseError
        If the mass is not positive, or a force is not finite or acts on an infinite mass.
    """

    mass: float = np.inf
    force: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require("mass of a wall", self.mass, "(0, inf]", "kg")
        require("force on a wall", self.force, "(-inf, inf)", "N")
        if self.force and np.isinf(self.mass):
            raise CaseError(f"a wall of infinite mass must not have a force, got {self.force:g} N")

    @property
    def mobility(self) -> float:
        """Inverse of the mass, 1/kg."""
        return 1.0 / self.mass

    @property
    def acceleration(self) -> np.ndarray:
        """Acceleration by the force, m/s2."""
        return self.force / self.mass * self.unit


@dataclass(frozen=True)
class CylinderWall(Wall):
    """Inside of an infinite round pipe.

    Parameters
    ----------
    radius : float, inner radius, m; refused if it is not positive
    """

    radius: float = np.nan

    def __post_init__(self) -> None:
        super().__post_init__()
        require("radius of a cylinder", self.radius, "(0, inf)", "m")

    @property
    def bore(self) -> float:
        """Radius, m."""
        return self.radius

    def holds(self, gravity: np.ndarray) -> bool:
        """Whether the pipe is not parallel to gravity."""
        along = abs(float(self.unit @ gravity))
        return along < (1.0 - 1e-9) * float(np.linalg.norm(gravity))


def box(
    low: Sequence[float] | np.ndarray,
    high: Sequence[float] | np.ndarray,
    *,
    friction: float | None = None,
) -> tuple[PlaneWall, ...]:
    """Return the planes of a box.

    Parameters
    ----------
    low, high : array_like, shape (3,), corners, m; infinite where the box is open
    friction : float, optional
        Coefficient against grains, dimensionless; the coefficient of the grains if not given.

    Returns
    -------
    tuple of PlaneWall, planes in the order of the axes, low before high; refused if they cross
    """
    planes = []
    for a in range(3):
        if not low[a] < high[a]:
            raise CaseError(
                f"the walls cross along {'xyz'[a]}: low {low[a]:g} m is not below high "
                f"{high[a]:g} m"
            )
        for corner, sign in ((low, 1.0), (high, -1.0)):
            if np.isfinite(corner[a]):
                x, y, z = np.eye(3)[a].tolist()
                at = float(corner[a])
                planes.append(
                    PlaneWall(
                        (at * x, at * y, at * z), (sign * x, sign * y, sign * z), friction=friction
                    )
                )
    return tuple(planes)
