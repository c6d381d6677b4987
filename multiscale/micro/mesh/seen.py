"""The contact face of a mesh as a height map: the uppermost facet above each point of a grid."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from multiscale.fe.facets import surface_of
from multiscale.micro.cell import MeshCell
from multiscale.surfaces.surface import Surface

__all__ = ["Sight", "seen_surface", "sight"]


@dataclass(frozen=True, eq=False)
class Sight:
    """The uppermost facet above every point of a grid.

    Attributes
    ----------
    height : ndarray, shape (nx, ny), height of the contact face, m
    interpolate : csr_array, shape (nx ny, nodes)
        Values at the points of the grid from values at the vertices of the mesh, linear on
        triangles.
    """

    height: np.ndarray
    interpolate: sparse.csr_array


def sight(cell: MeshCell) -> Sight:
    """Look down on the contact face of a cell that has points for its fields."""
    mesh, (nx, ny) = cell.mesh, cell.points or (0, 0)
    face = surface_of(mesh, "top")
    corner = face.nodes[face.facets].T
    triangles = np.hstack([corner[[0, k, k + 1]] for k in range(1, len(corner) - 1)])
    low, high = mesh.p.min(axis=1), mesh.p.max(axis=1)
    axes = [low[k] + (high - low)[k] * np.arange(n) / n for k, n in ((0, nx), (1, ny))]
    height = np.full((nx, ny), -np.inf)
    owner, share = np.zeros((nx, ny, 3), dtype=int), np.zeros((nx, ny, 3))
    near = 1e-9
    for triangle in triangles.T:
        (x0, x1, x2), (y0, y1, y2), z = mesh.p[:, triangle]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-12 * float((high - low)[:2].prod()) / (nx * ny):  # upright
            continue
        margin = near * (high - low)
        pieces = tuple(
            slice(*np.searchsorted(axis, (min(ends) - room, max(ends) + room)))
            for axis, ends, room in zip(axes, ((x0, x1, x2), (y0, y1, y2)), margin[:2], strict=True)
        )
        x, y = np.meshgrid(axes[0][pieces[0]], axes[1][pieces[1]], indexing="ij")
        b = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / area
        c = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / area
        weights = np.stack([1.0 - b - c, b, c], axis=-1)
        over = np.all(weights > -near, axis=-1) & (weights @ z > height[*pieces])
        height[*pieces][over] = (weights @ z)[over]
        owner[*pieces][over], share[*pieces][over] = triangle, weights[over]
    rows = np.repeat(np.arange(nx * ny), 3)
    interpolate = sparse.csr_array(
        (share.ravel(), (rows, owner.ravel())), shape=(nx * ny, mesh.nvertices)
    )
    return Sight(height, interpolate)


def seen_surface(cell: MeshCell) -> Surface:
    """Return the heights of the contact face over their mean plane, from above, on a grid."""
    mesh = cell.mesh
    size = np.ptp(mesh.p, axis=1)
    height = sight(cell).height
    return Surface(height - height.mean(), (float(size[0]), float(size[1])))
