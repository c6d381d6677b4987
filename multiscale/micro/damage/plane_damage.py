"""Planes with coordinates of their own."""

from dataclasses import dataclass

import numpy as np

__all__ = ["SectionPlane", "perpendicular"]


@dataclass(frozen=True)
class SectionPlane:
    """A plane with coordinates of its own: x = origin + y @ frame.

    Attributes
    ----------
    origin, normal : ndarray, shape (3,)
        A point, m, and the unit normal.
    frame : ndarray, shape (2, 3)
        Orthonormal; with the normal it is right-handed.
    slab : float
        Thickness of the slab about the plane whose flat cracks count, m.
    """

    origin: np.ndarray
    normal: np.ndarray
    frame: np.ndarray
    slab: float = 0.0

    @staticmethod
    def through(origin: np.ndarray, normal: np.ndarray, slab: float = 0.0) -> "SectionPlane":
        """Choose the coordinates of a plane."""
        return SectionPlane(origin, normal, perpendicular(normal[None])[0], slab)


def perpendicular(unit: np.ndarray) -> np.ndarray:
    """Right-handed frames about unit vectors, shape (n, 3): the other two, shape (n, 2, 3).

    T. Duff et al., J. Comput. Graph. Tech. 6 (2017) 1-8: no square root and no special case.
    """
    x, y, z = unit.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    return np.stack([first, np.stack([b, sign + y * y * a, -y], axis=1)], axis=1)
