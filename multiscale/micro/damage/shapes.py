"""Cavities and flat cracks as arrays of bodies, and their sections with planes.

Bodies have centres, shape (n, 3), m. Radii and lengths, m, are one for all bodies or one each,
shape (n,); directions, shape (3,) or (n, 3), may have any length but zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.damage.section_plane import SectionPlane, perpendicular

if TYPE_CHECKING:
    from multiscale.micro.damage.planar import Ellipses

__all__ = [
    "Cracks",
    "Cylinders",
    "Ellipsoids",
    "Mapped",
    "Shapes",
    "cylinders",
    "ellipsoids",
    "penny_cracks",
    "spheres",
]

NEGLIGIBLE = 1e-9  # ratio of a length to the size of its body below which it counts as zero


@dataclass(frozen=True)
class Mapped:
    """Bodies centre + root @ w, abs(w) <= 1.

    Attributes
    ----------
    centre : ndarray, shape (n, 3)
    root : ndarray, shape (n, 3, 3), or (n, 3, 2) of flat bodies, columns are the semi-axes, m
    """

    centre: np.ndarray
    root: np.ndarray

    @property
    def reach(self) -> np.ndarray:
        """Half lengths of their boxes, m."""
        return np.asarray(np.linalg.norm(self.root, axis=2))

    def take(self, index: np.ndarray, shift: np.ndarray) -> Self:
        """Pick bodies, moved by a shift of shape (3,) or (picked, 3), m."""
        return type(self)(self.centre[index] + shift, self.root[index])


class Ellipsoids(Mapped):
    """Ellipsoidal cavities."""

    @property
    def volume(self) -> np.ndarray:
        """Volumes, shape (n,), m³."""
        return np.asarray(4.0 / 3.0 * np.pi * np.abs(np.linalg.det(self.root)))

    def section(self, plane: SectionPlane) -> "Ellipses":
        """Return ellipses: in the unit ball the plane is (R^T n) . w = -d."""
        distance = (self.centre - plane.origin) @ plane.normal
        support = np.einsum("nij,i->nj", self.root, plane.normal)
        height = np.linalg.norm(support, axis=1)
        cut = np.abs(distance) < height
        c, R, m = self.centre[cut], self.root[cut], support[cut] / height[cut, None]
        s = -distance[cut] / height[cut]
        circle = np.sqrt((1.0 - s) * (1.0 + s))[:, None, None] * perpendicular(m)
        centre = (c - plane.origin + np.einsum("nij,nj->ni", R, s[:, None] * m)) @ plane.frame.T
        return _ellipses(centre, np.einsum("ai,nij,nkj->nak", plane.frame, R, circle))

    def contains(self, k: int, points: np.ndarray, thickness: float) -> np.ndarray:
        """Whether points lie in body k."""
        away = points - self.centre[k].reshape(3, *(1,) * (points.ndim - 1))
        w = np.tensordot(np.linalg.inv(self.root[k]), away, axes=1)
        return np.asarray(np.sum(w**2, axis=0) <= 1.0)


@dataclass(frozen=True)
class Cylinders:
    """Circular cylindrical cavities.

    Attributes
    ----------
    centre : ndarray, shape (n, 3)
    axis : ndarray, shape (n, 3), unit vectors
    radius : ndarray, shape (n,)
    half_length : ndarray, shape (n,)
        Half lengths, m; infinite for cylinders through the whole volume.
    """

    centre: np.ndarray
    axis: np.ndarray
    radius: np.ndarray
    half_length: np.ndarray

    @property
    def reach(self) -> np.ndarray:
        """Half lengths of their boxes, m."""
        across = np.sqrt(np.maximum(0.0, 1.0 - self.axis**2))
        along = np.where(self.axis == 0.0, 0.0, np.abs(self.axis)) > 0.0
        length = np.where(along, np.abs(self.axis), 1.0) * self.half_length[:, None]
        return np.asarray(self.radius[:, None] * across + np.where(along, length, 0.0))

    def take(self, index: np.ndarray, shift: np.ndarray) -> "Cylinders":
        """Pick bodies, moved by a shift."""
        return Cylinders(
            self.centre[index] + shift,
            self.axis[index],
            self.radius[index],
            self.half_length[index],
        )

    def section(self, plane: SectionPlane) -> "Ellipses":
        """Return ellipses between the two lines in which the plane meets the ends."""
        distance = (self.centre - plane.origin) @ plane.normal
        cosine = self.axis @ plane.normal
        slope = self.axis @ plane.frame.T
        above = np.einsum("ni,ni->n", self.axis, self.centre - plane.origin)
        steep = np.hypot(slope[:, 0], slope[:, 1]) > NEGLIGIBLE
        along = np.abs(cosine) < 1e-6  # the section is a strip, taken as a very long ellipse
        cut = np.where(along, np.abs(distance) < self.radius, True)
        cut &= steep | (np.abs(above) <= self.half_length)

        safe = np.where(along, 1.0, cosine)
        e = perpendicular(self.axis) * self.radius[:, None, None]
        tilt = np.einsum("nki,i->nk", e, plane.normal) / safe[:, None]
        e = e - tilt[:, :, None] * self.axis[:, None, :]
        root = np.einsum("ai,nki->nak", plane.frame, e)
        centre = (self.centre - plane.origin) @ plane.frame.T
        width = np.sqrt(np.maximum(0.0, self.radius**2 - distance**2))
        long = 1e6 * self.radius[:, None] * slope
        length = np.maximum(np.hypot(slope[:, 0], slope[:, 1]), np.finfo(float).tiny)
        across = np.stack([-slope[:, 1], slope[:, 0]], axis=1) / length[:, None]
        strip_root = np.stack([long, width[:, None] * across], axis=2)
        root = np.where(along[:, None, None], strip_root, root)
        centre = np.where(along[:, None], centre, centre - (distance / safe)[:, None] * slope)

        size = np.where(steep, np.hypot(slope[:, 0], slope[:, 1]), 1.0)
        low, high = (above - self.half_length) / size, (above + self.half_length) / size
        capped = steep & np.isfinite(self.half_length)
        strip = np.column_stack(
            [
                np.where(capped[:, None], slope / size[:, None], 0.0),
                np.where(capped, low, -np.inf),
                np.where(capped, high, np.inf),
            ]
        )
        return _ellipses(centre[cut], root[cut], strip[cut])

    def contains(self, k: int, points: np.ndarray, thickness: float) -> np.ndarray:
        """Whether points lie in body k."""
        away = points - self.centre[k].reshape(3, *(1,) * (points.ndim - 1))
        along = np.tensordot(self.axis[k], away, axes=1)
        across = np.sum(away**2, axis=0) - along**2
        return np.asarray((across <= self.radius[k] ** 2) & (np.abs(along) <= self.half_length[k]))


class Cracks(Mapped):
    """Flat elliptic cracks."""

    @property
    def normal(self) -> np.ndarray:
        """Unit normals, shape (n, 3)."""
        across = np.cross(self.root[:, :, 0], self.root[:, :, 1])
        return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))

    @property
    def area(self) -> np.ndarray:
        """Areas, shape (n,), m²."""
        across = np.cross(self.root[:, :, 0], self.root[:, :, 1])
        return np.asarray(np.pi * np.linalg.norm(across, axis=1))

    def section(self, plane: SectionPlane) -> "Ellipses":
        """Project the cracks that meet the slab of the plane on it, with area A abs(n . m)."""
        distance = np.abs((self.centre - plane.origin) @ plane.normal)
        height = np.linalg.norm(np.einsum("nij,i->nj", self.root, plane.normal), axis=1)
        size = self.reach.max(axis=1)
        meets = distance <= 0.5 * plane.slab + height + NEGLIGIBLE * size
        root = np.einsum("ai,nij->naj", plane.frame, self.root)
        meets &= np.abs(np.linalg.det(root)) * np.pi > NEGLIGIBLE * self.area
        centre = (self.centre - plane.origin) @ plane.frame.T
        return _ellipses(centre[meets], root[meets])

    def contains(self, k: int, points: np.ndarray, thickness: float) -> np.ndarray:
        """Whether points lie within half a thickness of crack k."""
        away = points - self.centre[k].reshape(3, *(1,) * (points.ndim - 1))
        w = np.tensordot(np.linalg.pinv(self.root[k]), away, axes=1)
        above = np.tensordot(self.normal[k], away, axes=1)
        # only one of two layers of points at the same distance counts
        near = (above > -0.5 * thickness * (1.0 + NEGLIGIBLE)) & (
            above <= 0.5 * thickness * (1 - NEGLIGIBLE)
        )
        return np.asarray((np.sum(w**2, axis=0) <= 1.0) & near)


Shapes = Ellipsoids | Cylinders | Cracks


def spheres(centre: np.ndarray, radius: float | np.ndarray) -> Ellipsoids:
    """Spherical cavities; centres, shape (n, 3), m, and radii, m, which must be positive."""
    centre = _points(centre)
    radius = _positive("radius", radius, len(centre))
    return Ellipsoids(centre, radius[:, None, None] * np.eye(3))


def ellipsoids(
    centre: np.ndarray, semi_axes: np.ndarray, rotation: np.ndarray | None = None
) -> Ellipsoids:
    """Ellipsoidal cavities.

    Parameters
    ----------
    centre, semi_axes : ndarray, shape (n, 3)
        m.
    rotation : ndarray, shape (n, 3, 3), optional
        Columns are the directions of the semi-axes; along x, y and z if not given.

    Raises
    ------
    CaseError
        If a semi-axis is not positive.
    """
    centre = _points(centre)
    axes = np.broadcast_to(np.asarray(semi_axes, dtype=float), centre.shape)
    for k in range(3):
        _positive("semi-axis", axes[:, k], len(centre))
    turn = np.broadcast_to(np.eye(3) if rotation is None else rotation, (len(centre), 3, 3))
    return Ellipsoids(centre, turn * axes[:, None, :])


def cylinders(
    centre: np.ndarray,
    axis: np.ndarray | Sequence[float],
    radius: float | np.ndarray,
    length: float | np.ndarray = np.inf,
) -> Cylinders:
    """Circular cylindrical cavities; an infinite length goes through the whole volume.

    Parameters
    ----------
    centre, axis : ndarray, shape (n, 3), m, and of any length
    radius, length : float or ndarray, shape (n,), m

    Raises
    ------
    CaseError
        If a radius or a length is not positive or an axis is zero.
    """
    centre = _points(centre)
    return Cylinders(
        centre,
        _directions("axis", axis, len(centre)),
        _positive("radius", radius, len(centre)),
        0.5 * _positive("length", length, len(centre), infinite=True),
    )


def penny_cracks(
    centre: np.ndarray, normal: np.ndarray | Sequence[float], radius: float | np.ndarray
) -> Cracks:
    """Circular flat cracks; a radius that is not positive and a normal of zero are refused.

    Parameters
    ----------
    centre, normal : ndarray, shape (n, 3), m, and of any length
    radius : float or ndarray, shape (n,), m
    """
    centre = _points(centre)
    radius = _positive("radius", radius, len(centre))
    across = perpendicular(_directions("normal", normal, len(centre)))
    return Cracks(centre, np.swapaxes(across, 1, 2) * radius[:, None, None])


def _ellipses(centre: np.ndarray, root: np.ndarray, strip: np.ndarray | None = None) -> "Ellipses":
    """Plane sets whose roots have a positive determinant."""
    from multiscale.micro.damage.planar import Ellipses

    turned = root[:, 0, 0] * root[:, 1, 1] < root[:, 0, 1] * root[:, 1, 0]
    root = np.where(turned[:, None, None], root[:, :, ::-1], root) if turned.any() else root
    if strip is None:
        strip = np.empty((len(centre), 4))
        strip[:] = 0.0, 0.0, -np.inf, np.inf
    return Ellipses(centre, root, strip)


def _points(centre: np.ndarray) -> np.ndarray:
    points = np.atleast_2d(np.asarray(centre, dtype=float))
    if points.size == 0:
        return np.empty((0, 3))
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"centres must have shape (n, 3), got {points.shape}")
    if not np.all(np.isfinite(points)):
        raise CaseError("the centres of bodies must be finite (m)")
    return points


def _positive(
    name: str, value: float | np.ndarray, n: int, *, infinite: bool = False
) -> np.ndarray:
    """Return one positive number for each body."""
    values = np.broadcast_to(np.asarray(value, dtype=float), (n,))
    wrong = ~(values > 0.0) | (np.isinf(values) & (not infinite))
    if wrong.any():
        k = int(np.argmax(wrong))
        raise CaseError(
            f"the {name} of a body must be positive{'' if infinite else ' and finite'} (m), "
            f"got {values[k]:g} for body {k}"
        )
    return values


def _directions(name: str, value: np.ndarray | Sequence[float], n: int) -> np.ndarray:
    """Return one unit vector for each body."""
    vectors = np.broadcast_to(np.asarray(value, dtype=float), (n, 3))
    size = np.linalg.norm(vectors, axis=1)
    if not np.all((size > 0.0) & np.isfinite(size)):
        raise CaseError(f"the {name} of a body must be a direction, got {vectors[np.argmin(size)]}")
    return np.asarray(vectors / size[:, None])
