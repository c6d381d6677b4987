"""Section planes with their own coordinates."""

from dataclasses import dataclass

import numpy as np

__all__ = ["SectionPlane", "perpendicular"]


@dataclass(frozen=True)
class SectionPlane:
    """A plane with its own coordinates y: x = origin + y @ frame.

    Attributes
    ----------
    origin : ndarray, shape (3,), a point of the plane, m
    normal : ndarray, shape (3,), unit normal
    frame : ndarray, shape (2, 3), orthonormal directions in the plane, right-handed with the normal
    slab : float, thickness of the slab about the plane whose flat cracks count, m
    """

    origin: np.ndarray
    normal: np.ndarray
    frame: np.ndarray
    slab: float = 0.0

    @staticmethod
    def through(origin: np.ndarray, normal: np.ndarray, slab: float = 0.0) -> "SectionPlane":
        """Choose the directions in the plane through a point, m, with a unit normal."""
        return SectionPlane(origin, normal, perpendicular(normal[None])[0], slab)


def perpendicular(unit: np.ndarray) -> np.ndarray:
    """Complete unit vectors (n, 3) to right-handed frames; the two other vectors, (n, 2, 3).

    References
    ----------
    .. [1] T. Duff et al., J. Comput. Graph. Tech. 6 (2017) 1-8: no square root and no special case.
    """
    x, y, z = unit.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    frame = np.empty((len(unit), 2, 3))
    frame[:, 0, 0], frame[:, 0, 1], frame[:, 0, 2] = (
        1.0 + sign * x * x * a,
        sign * x * y * a,
        -sign * x,
    )
    frame[:, 1, 0], frame[:, 1, 1], frame[:, 1, 2] = x * y * a, sign + y * y * a, -y
    return frame
