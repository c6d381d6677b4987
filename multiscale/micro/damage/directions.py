"""Normals of planes: a refined icosahedron, the directions of a lattice, and a tensor fit."""

from itertools import product
from math import gcd

import numpy as np

from multiscale.errors import CaseError

__all__ = ["fit_tensor", "lattice_directions", "miller_indices", "sphere_directions"]

LARGEST_INDEX = 12
"""Largest Miller index of a plane that counts as closed."""


def sphere_directions(level: int) -> np.ndarray:
    """Spread normals evenly over half a sphere, by halving the edges of an icosahedron.

    Examples
    --------
    >>> [len(sphere_directions(level)) for level in range(4)]
    [6, 21, 81, 321]
    """
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = [
        np.roll([0.0, a, b * golden], k) for k in range(3) for a, b in product((-1, 1), repeat=2)
    ]
    points = np.array(corners) / np.hypot(1.0, golden)
    for _ in range(level):
        distance = np.linalg.norm(points[:, None] - points[None], axis=2)
        # the five or six neighbours of a corner; lengths of edges differ by less than a half
        nearest = np.sort(distance, axis=1)[:, 1:2]
        near = np.triu(distance < 1.4 * np.minimum(nearest, nearest.T), k=1)
        i, j = np.nonzero(near)
        middle = points[i] + points[j]
        points = np.concatenate([points, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
    return _one_of_each_pair(points)


def lattice_directions(size: tuple[float, float, float], largest: int = 2) -> np.ndarray:
    """List the normals of the lattice planes of a periodic box."""
    span = range(-largest, largest + 1)
    indices = [m for m in product(span, repeat=3) if gcd(*m) == 1]
    indices.sort(key=lambda m: sum(abs(k) for k in m))
    normals = np.array(indices, dtype=float) / size
    return _one_of_each_pair(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def miller_indices(normal: np.ndarray, size: tuple[float, float, float]) -> tuple[int, int, int]:
    """Find the Miller indices of a normal in a periodic box.

    The normal may have any length but zero.
    """
    ratio = normal * np.asarray(size)
    ratio = ratio / np.abs(ratio).max()
    for multiple in range(1, LARGEST_INDEX + 1):
        rounded = np.rint(multiple * ratio)
        if np.abs(multiple * ratio - rounded).max() < 1e-7 * multiple:
            h, k, l_ = (int(m) for m in rounded)
            return (h, k, l_)
    raise CaseError(
        f"a plane with the normal {np.array2string(normal, precision=4)} does not close in a "
        f"periodic box of {size} m within indices of {LARGEST_INDEX}; leave out closed=True or "
        f"take a lattice direction"
    )


def fit_tensor(normals: np.ndarray, values: np.ndarray) -> np.ndarray:
    r"""Second-order tensor nearest to a function of the normal."""
    x, y, z = normals.T
    columns = np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y], axis=1)
    a, b, c, d, e, f = np.linalg.lstsq(columns, values, rcond=None)[0]
    return np.array([[a, f, e], [f, b, d], [e, d, c]])


def _one_of_each_pair(points: np.ndarray) -> np.ndarray:
    """Keep one of x and -x, and one of equal points, in their order."""
    kept: list[np.ndarray] = []
    for point in points:
        x, y, z = np.round(point, 9)
        if z < 0 or (z == 0 and (y < 0 or (y == 0 and x < 0))):
            point = -point
        if not kept or np.abs(np.array(kept) @ point).max() < 1.0 - 1e-9:
            kept.append(point)
    return np.array(kept)
