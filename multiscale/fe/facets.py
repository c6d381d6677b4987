"""Contact faces: oriented facets, their nodes and nodal normals."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from skfem import Mesh

__all__ = ["ContactFace", "facet_normals", "nodal_normals", "plane_axes", "surface_of"]

STRAIGHT = 1e-6
"""Cosine below one up to which a plane is normal to an axis of the coordinates."""


@dataclass(frozen=True)
class ContactFace:
    """Facets of a named boundary.

    Attributes
    ----------
    facets : ndarray of int, shape (facets, corners)
        Positions in ``nodes``; seen from outside the body the corners run counter-clockwise (in
        two dimensions: the body lies to the left of the direction from the first to the second).
    nodes : ndarray of int, shape (n,), node numbers in the mesh, sorted
    """

    facets: np.ndarray
    nodes: np.ndarray


def surface_of(mesh: "Mesh", boundary: str) -> ContactFace:
    """Orient the facets of a boundary outwards."""
    index = np.asarray(mesh.boundaries[boundary])
    corners = mesh.facets[:, index].T
    inside = mesh.p[:, mesh.t[:, mesh.f2t[0, index]]].mean(axis=1).T
    x = mesh.p.T[corners]
    centre = x.mean(axis=1)
    if mesh.dim() == 3 and corners.shape[1] == 4:  # by their angle around the centre
        n = (centre - inside) / np.linalg.norm(centre - inside, axis=1, keepdims=True)
        arm = x - centre[:, None]
        first = arm[:, 0] - np.sum(arm[:, 0] * n, axis=1, keepdims=True) * n
        ahead, aside = (np.einsum("fcd,fd->fc", arm, one) for one in (first, np.cross(n, first)))
        corners = np.take_along_axis(corners, np.argsort(np.arctan2(aside, ahead), axis=1), axis=1)
        x = mesh.p.T[corners]
    outward = np.sum(facet_normals(x) * (centre - inside), axis=1) > 0.0
    corners = np.where(outward[:, None], corners, corners[:, ::-1])
    nodes, local = np.unique(corners, return_inverse=True)
    return ContactFace(local.reshape(corners.shape), nodes)


def facet_normals(x: np.ndarray) -> np.ndarray:
    """Area-weighted normals of facets with corners (facets, corners, d), m² (m in 2D)."""
    if x.shape[2] == 2:
        t = x[:, 1] - x[:, 0]
        return np.stack([t[:, 1], -t[:, 0]], axis=1)
    if x.shape[1] == 3:
        return 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    return 0.5 * np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])


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


def nodal_normals(surface: ContactFace, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Average the facets around each node to unit normals, shape (n, d)."""
    normal = np.zeros_like(x)
    facet = facet_normals(x[surface.facets])
    for corner in surface.facets.T:
        np.add.at(normal, corner, facet)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = np.where(free, normal, 0.0)
    size = np.linalg.norm(along, axis=1, keepdims=True)
    return np.where(size > 0.7, along / np.where(size > 0.0, size, 1.0), normal)
