"""Faces of the elements of meshes, for figures of bodies."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

_CORNERS = {
    4: [*combinations(range(4), 3)],
    8: [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
}
"""Corners of the faces of tetrahedra and hexahedra, in the order of VTK."""


@dataclass(frozen=True, eq=False)
class OuterFaces:
    """Faces that belong to a single element."""

    corners: np.ndarray  # (faces, corners of a face), nodes
    element: np.ndarray  # (faces,), in increasing order


def list_faces(corners: np.ndarray) -> np.ndarray:
    """Corners of the faces of every element, shape (elements, faces, corners of a face)."""
    return np.asarray(corners[:, np.array(_CORNERS[corners.shape[1]])])


def outer_faces(corners: np.ndarray) -> OuterFaces:
    """Return the outer faces of elements with ``corners`` of shape (elements, corners)."""
    faces = list_faces(corners)
    every = faces.reshape(-1, faces.shape[2])
    _, first, count = np.unique(
        np.sort(every, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer = np.sort(first[count == 1])
    return OuterFaces(every[outer], outer // faces.shape[1])
