"""Named faces of meshes: oriented facets, normals and frames."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError, listed

if TYPE_CHECKING:
    from skfem import Mesh

__all__ = [
    "COINCIDENT",
    "OrientedFace",
    "check_boundary",
    "face_of",
    "facet_normals",
    "nodal_normals",
    "plane_axes",
    "plane_frame",
    "tangent_frames",
]

COINCIDENT = 1e-6
"""Distance of nodes that are one point of an interface, relative to the size of a face."""

STRAIGHT = 1e-6
"""Cosine below one up to which a plane is normal to an axis of the coordinates."""


@dataclass(frozen=True, eq=False)
class OrientedFace:
    """Facets of a named boundary, oriented outwards.

    Attributes
    ----------
    facets : ndarray of int, shape (facets, corners)
        Positions in ``nodes``; seen from outside the body the corners run counter-clockwise (in
        two dimensions: the body lies to the left of the direction from the first to the second).
    nodes : ndarray of int, shape (n,), vertices of the mesh, sorted
    position : ndarray, shape (n, d), of the vertices, m
    """

    facets: np.ndarray
    nodes: np.ndarray
    position: np.ndarray

    @cached_property
    def normals(self) -> np.ndarray:
        """Outward normals of the facets, as long as their area, shape (facets, d), m²."""
        return facet_normals(self.position[self.facets])


def face_of(mesh: "Mesh", boundary: str) -> OrientedFace:
    """Orient the facets of a boundary outwards; refuses one that the mesh does not name."""
    check_boundary(mesh, boundary)
    index = np.asarray(mesh.boundaries[boundary])
    corners = mesh.facets[:, index].T
    inside = mesh.p[:, mesh.t[:, mesh.f2t[0, index]]].mean(axis=1).T
    x = mesh.p.T[corners]
    centre = x.mean(axis=1)
    if mesh.dim() == 3 and corners.shape[1] == 4:  # by their angle around the centre
        n = (centre - inside) / np.linalg.norm(centre - inside, axis=1, keepdims=True)
        arm = x - centre[:, None]
        first = arm[:, 0] - np.sum(arm[:, 0] * n, axis=1, keepdims=True) * n
        ahead, aside = (np.einsum("fcd,fd->fc", arm, axis) for axis in (first, np.cross(n, first)))
        corners = np.take_along_axis(corners, np.argsort(np.arctan2(aside, ahead), axis=1), axis=1)
        x = mesh.p.T[corners]
    outward = np.sum(facet_normals(x) * (centre - inside), axis=1) > 0.0
    corners = np.where(outward[:, None], corners, corners[:, ::-1])
    nodes, local = np.unique(corners, return_inverse=True)
    return OrientedFace(local.reshape(corners.shape), nodes, mesh.p.T[nodes])


def check_boundary(mesh: "Mesh", boundary: str) -> None:
    """Refuse a boundary that the mesh does not name."""
    known = mesh.boundaries or {}
    if boundary not in known:
        raise CaseError(
            f"the mesh has no boundary {boundary!r}; its boundaries are {listed(known)}"
        )


def facet_normals(x: np.ndarray) -> np.ndarray:
    """Area-weighted normals of facets with corners (facets, corners, d), m² (m in 2D)."""
    if x.shape[2] == 2:
        t = x[:, 1] - x[:, 0]
        return np.stack([t[:, 1], -t[:, 0]], axis=1)
    if x.shape[1] == 3:
        return 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    return 0.5 * np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])


def nodal_normals(face: OrientedFace, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Average the facets around each node, moved to x, to unit normals, shape (n, d).

    Components that are not free, on a plane of symmetry, are left out of them.
    """
    normal = np.zeros_like(x)
    facet = facet_normals(x[face.facets])
    for corner in face.facets.T:
        np.add.at(normal, corner, facet)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = np.where(free, normal, 0.0)
    size = np.linalg.norm(along, axis=1, keepdims=True)
    return np.where(size > 0.7, along / np.where(size > 0.0, size, 1.0), normal)


def tangent_frames(normal: np.ndarray) -> np.ndarray:
    """Frames of rows n, t1, t2 from unit normals (n, d): t1 is near x, or near y if n is near x."""
    n, d = normal.shape
    axis = np.zeros((n, d))
    steep = np.abs(normal[:, 0]) > 0.9
    axis[~steep, 0] = 1.0
    axis[steep, 1] = 1.0
    t1 = axis - np.sum(axis * normal, axis=1, keepdims=True) * normal
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    axes = [normal, t1] if d == 2 else [normal, t1, np.cross(normal, t1)]
    return np.asarray(np.stack(axes, axis=1))


def plane_frame(face: OrientedFace, boundary: str) -> np.ndarray:
    """Frame of a plane face of side 2, whose normal looks out of side 1, shape (d, d)."""
    normals = -face.normals / np.linalg.norm(face.normals, axis=1, keepdims=True)
    if np.ptp(normals, axis=0).max() > COINCIDENT:
        raise CaseError(
            f"the boundary {boundary!r} of a joint must be plane; name each plane part by itself"
        )
    normal = normals.mean(axis=0)
    return np.asarray(tangent_frames(normal[None] / np.linalg.norm(normal))[0])


def plane_axes(place: np.ndarray) -> np.ndarray:
    """Find the normal of the plane of points, shape (n, 3), and two axes in it, as rows (3, 3).

    They are the axes of the coordinates, unless the plane is oblique to all of them.
    """
    away = place - place.mean(axis=0)
    normal = np.linalg.eigh(away.T @ away)[1][:, 0]
    across = int(np.argmax(np.abs(normal)))
    first, second = (axis for axis in range(3) if axis != across)
    if np.abs(normal[across]) > 1.0 - STRAIGHT:
        return np.eye(3)[[across, first, second]]
    normal = normal * np.sign(normal[across])
    along = np.eye(3)[first] - normal[first] * normal
    along /= np.linalg.norm(along)
    return np.stack([normal, along, np.cross(normal, along)])
