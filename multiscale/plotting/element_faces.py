"""Faces of the elements of meshes, for pictures of bodies."""

from itertools import combinations

import numpy as np

__all__ = ["list_faces", "outer_faces"]

_CORNERS = {
    4: [*combinations(range(4), 3)],
    8: [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
}
"""Corners of the faces of tetrahedra and hexahedra, in the order of VTK."""


def list_faces(corners: np.ndarray) -> np.ndarray:
    """Corners of the faces of every element, shape (elements, faces, corners of a face)."""
    return np.asarray(corners[:, np.array(_CORNERS[corners.shape[1]])])


def outer_faces(corners: np.ndarray) -> np.ndarray:
    """Numbers, element by element, of the faces that belong to one element alone."""
    faces = list_faces(corners)
    every = np.sort(faces.reshape(-1, faces.shape[2]), axis=1)
    _, first, count = np.unique(every, axis=0, return_index=True, return_counts=True)
    return np.asarray(np.sort(first[count == 1]))
