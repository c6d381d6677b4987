"""Open flat cracks in a periodic tetrahedral mesh, wherever they end or meet."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from multiscale.errors import CaseError

__all__ = ["CrackedMesh", "open_cracks"]

OPPOSITE_FACE = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Corners of the face opposite to each corner of a tetrahedron."""

FACE_MARGIN = 1e-7  # distance to a face of the box, relative to its size, that counts as zero


@dataclass(frozen=True)
class CrackedMesh:
    """Tetrahedra of a periodic volume whose cracks are open.

    Attributes
    ----------
    points : ndarray, shape (3, n), corners, m; a crack has two or more corners at one place
    cells : ndarray of int, shape (4, elements), corners of the elements
    periodic : ndarray of int, shape (n,)
        Corners that move alike, up to the mean strain, have the same number.
    front : ndarray of int, corners on the fronts of cracks
    """

    points: np.ndarray
    cells: np.ndarray
    periodic: np.ndarray
    front: np.ndarray


def open_cracks(
    points: np.ndarray, cells: np.ndarray, facets: np.ndarray, size: np.ndarray
) -> CrackedMesh:
    """Duplicate the corners on cracks, so that elements on different sides share none.

    Two elements share a corner if a chain of elements around it leads from one to the other
    through common faces that are no crack. At a front the chain goes around the crack, so that the
    corner is not duplicated. Opposite faces of the box count as common faces, which makes the
    corners periodic and separates the sides of a crack that crosses a face of the box.
    """
    corner = np.arange(cells.size).reshape(cells.shape)  # each corner of each element has a number
    faces = np.concatenate([cells[face] for face in OPPOSITE_FACE], axis=1)
    own = np.concatenate([corner[face] for face in OPPOSITE_FACE], axis=1)
    lower = _lower_twins(points, size)
    faces, facets = _moved(faces, lower), _moved(facets, lower)
    order = np.argsort(faces, axis=0)
    faces, own = np.take_along_axis(faces, order, 0), np.take_along_axis(own, order, 0)

    n = points.shape[1]
    key = _key(faces, n)
    rank = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[rank][1:] == key[rank][:-1])
    same = same[~np.isin(key[rank[same]], _key(np.sort(facets, axis=0), n))]
    ends = own[:, rank[same]].ravel(), own[:, rank[same + 1]].ravel()
    links = coo_array((np.ones(ends[0].size), ends), shape=(cells.size, cells.size))
    moves_with = connected_components(links, directed=False)[1].reshape(cells.shape)

    pair, new = np.unique(
        np.stack([cells.ravel(), moves_with.ravel()]), axis=1, return_inverse=True
    )
    place, periodic = pair
    copies = np.bincount(place, minlength=n)
    front = np.isin(place, facets) & (copies[place] == 1)
    return CrackedMesh(points[:, place], new.reshape(cells.shape), periodic, np.flatnonzero(front))


def _key(faces: np.ndarray, n: int) -> np.ndarray:
    """Combine the three sorted corners of a face in one number."""
    first, second, third = faces.astype(np.int64)
    return np.asarray((first * n + second) * n + third)


def _moved(faces: np.ndarray, lower: list[np.ndarray]) -> np.ndarray:
    """Move faces on the high sides of the box to the low sides."""
    faces = faces.copy()
    for twin in lower:
        high = np.all(twin[faces] >= 0, axis=0)
        faces[:, high] = twin[faces[:, high]]
    return faces


def _lower_twins(points: np.ndarray, size: np.ndarray) -> list[np.ndarray]:
    """Find for each axis the point of the low side opposite each high point, -1 elsewhere."""
    from scipy.spatial import KDTree

    twins = []
    for axis in range(3):
        low = np.flatnonzero(np.abs(points[axis]) < FACE_MARGIN * size[axis])
        high = np.flatnonzero(np.abs(points[axis] - size[axis]) < FACE_MARGIN * size[axis])
        across = np.arange(3) != axis
        distance, nearest = KDTree(points[across][:, low].T).query(points[across][:, high].T)
        if low.size != high.size or np.max(distance, initial=0.0) > 1e-5 * float(size.max()):
            raise CaseError(
                "gmsh meshed opposite faces of the volume differently; change element_size or "
                "move bodies that only just reach a face"
            )
        twin = np.full(points.shape[1], -1)
        twin[high] = low[nearest]
        twins.append(twin)
    return twins
