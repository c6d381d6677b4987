r"""Matrix-free elastic stiffness of the layered cell: trilinear hexahedra, one pass per layer.

Displacements and forces are arrays of shape ``(nx, layers, 3, ny)``: the node plane at the clamped
base is left out, and y runs fastest so that the kernel works on contiguous batches of elements.
"""

from collections.abc import Callable

import numba
import numpy as np

from multiscale.micro.graph_mesh import GraphMesh
from multiscale.micro.hexahedron import (
    BATCH,
    X,
    Y,
    Z,
    differences,
    differences_transposed,
    element_geometry,
    gather,
    lateral_heights,
    scatter,
)
from multiscale.numerics.compiled import compiled

__all__ = ["stiffness_operator"]


@compiled(fastmath=True)
def _mean_dilatation(grad, geometry, mean, volume, lanes):  # type: ignore[no-untyped-def]
    """Volume average of the divergence over each element."""
    for v in range(lanes):
        mean[v], volume[v] = 0.0, 0.0
    for qx in range(2):
        for qy in range(2):
            for qz in range(2):
                rx = (2 * qy + qz) * BATCH
                ry = (4 + 2 * qx + qz) * BATCH
                rz = (8 + 2 * qx + qy) * BATCH
                rt = (2 * qx + qy) * BATCH
                for v in range(lanes):
                    height = geometry[rt + v]
                    slope_x, slope_y = geometry[rx + 4 * BATCH + v], geometry[ry + 4 * BATCH + v]
                    by_z = grad[rz + 24 * BATCH + v] - slope_x * grad[rz + v]
                    by_z -= slope_y * grad[rz + 12 * BATCH + v]
                    mean[v] += height * (grad[rx + v] + grad[ry + 12 * BATCH + v]) + by_z
                    volume[v] += height
    for v in range(lanes):
        mean[v] /= volume[v]


@compiled(fastmath=True)
def _forces(  # type: ignore[no-untyped-def]
    grad, flux, geometry, lame, shear, mean, mean_dilatation, area, lanes
):
    """Stress at the eight Gauss points, pulled back to the edge derivatives.

    ``geometry`` holds, for each lane, the element height at the four lateral Gauss points
    (rows 0-3), the slopes of the node surfaces in x at (qy, qz) (rows 4-7) and in y at
    (qx, qz) (rows 8-11). ``grad`` and ``flux`` have 12 rows for each component. With
    ``mean_dilatation`` the divergence is replaced by its ``mean`` over the element (B-bar).
    """
    for k in range(36 * BATCH):
        flux[k] = 0.0
    for qx in range(2):
        for qy in range(2):
            for qz in range(2):
                rx = (2 * qy + qz) * BATCH
                ry = (4 + 2 * qx + qz) * BATCH
                rz = (8 + 2 * qx + qy) * BATCH
                rt = (2 * qx + qy) * BATCH
                for v in range(lanes):
                    height = geometry[rt + v]
                    slope_x, slope_y = geometry[rx + 4 * BATCH + v], geometry[ry + 4 * BATCH + v]
                    inverse = 1.0 / height
                    uz = grad[rz + v] * inverse
                    vz = grad[rz + 12 * BATCH + v] * inverse
                    wz = grad[rz + 24 * BATCH + v] * inverse
                    ux, uy = grad[rx + v] - slope_x * uz, grad[ry + v] - slope_y * uz
                    vx = grad[rx + 12 * BATCH + v] - slope_x * vz
                    vy = grad[ry + 12 * BATCH + v] - slope_y * vz
                    wx = grad[rx + 24 * BATCH + v] - slope_x * wz
                    wy = grad[ry + 24 * BATCH + v] - slope_y * wz
                    weight = area * height
                    trace = ux + vy + wz
                    dilatation = mean[v] if mean_dilatation else trace
                    mu = weight * shear[v]
                    pressure = weight * lame[v] * dilatation + mu * (dilatation - trace) / 1.5
                    xx = pressure + 2.0 * mu * ux
                    yy = pressure + 2.0 * mu * vy
                    zz = pressure + 2.0 * mu * wz
                    xy, yz, xz = mu * (uy + vx), mu * (vz + wy), mu * (uz + wx)
                    flux[rx + v] += xx
                    flux[ry + v] += xy
                    flux[rz + v] += (xz - slope_x * xx - slope_y * xy) * inverse
                    flux[rx + 12 * BATCH + v] += xy
                    flux[ry + 12 * BATCH + v] += yy
                    flux[rz + 12 * BATCH + v] += (yz - slope_x * xy - slope_y * yy) * inverse
                    flux[rx + 24 * BATCH + v] += xz
                    flux[ry + 24 * BATCH + v] += yz
                    flux[rz + 24 * BATCH + v] += (zz - slope_x * xz - slope_y * yz) * inverse


@compiled(parallel=True, fastmath=True)
def _apply(  # type: ignore[no-untyped-def]
    heights, planes, factor, dx, dy, lame, shear, mean_dilatation, u, out
):
    """Add the elastic forces of every element; strips of elements in x in two colours.

    A single point in x or y has itself as neighbour: plane strain. The moduli are given for every
    element, or once along an axis on which they are the same.
    """
    nx, layers, _, ny = u.shape
    along_x, along_y = int(lame.shape[0] > 1), int(lame.shape[2] > 1)
    out[:] = 0.0
    for colour in range(2):
        for pair in numba.prange((nx + 1 - colour) // 2):
            i = 2 * pair + colour
            sides = (i, (i + 1) % nx)
            nodes = np.empty(24 * BATCH)
            grad = np.empty(36 * BATCH)
            flux = np.empty(36 * BATCH)
            geometry = np.empty(12 * BATCH)
            lateral = np.empty(8 * BATCH)
            first, second = np.empty(BATCH), np.empty(BATCH)
            mean, volume = np.empty(BATCH), np.empty(BATCH)
            for start in range(0, ny, BATCH):
                lanes = min(BATCH, ny - start)
                lateral_heights(heights, sides[0], sides[1], start, dx, dy, lateral, lanes)
                for layer in range(layers):
                    element_geometry(
                        lateral,
                        planes[layer],
                        planes[layer + 1],
                        factor[layer],
                        factor[layer + 1],
                        geometry,
                        lanes,
                    )
                    for v in range(lanes):
                        first[v] = lame[i * along_x, layer, (start + v) * along_y]
                        second[v] = shear[i * along_x, layer, (start + v) * along_y]
                    gather(u, sides, layer, start, lanes, nodes)
                    for k in range(3):
                        w, g = nodes[8 * k * BATCH :], grad[12 * k * BATCH :]
                        differences(w, g, X, Y, Z, 1.0 / dx, lanes)
                        differences(w, g[4 * BATCH :], Y, X, Z, 1.0 / dy, lanes)
                        differences(w, g[8 * BATCH :], Z, X, Y, 1.0, lanes)
                    if mean_dilatation:
                        _mean_dilatation(grad, geometry, mean, volume, lanes)
                    area = dx * dy / 8.0
                    _forces(grad, flux, geometry, first, second, mean, mean_dilatation, area, lanes)
                    for k in range(3):
                        w, g = nodes[8 * k * BATCH :], flux[12 * k * BATCH :]
                        w[: 8 * BATCH] = 0.0
                        differences_transposed(g, w, X, Y, Z, 1.0 / dx, lanes)
                        differences_transposed(g[4 * BATCH :], w, Y, X, Z, 1.0 / dy, lanes)
                        differences_transposed(g[8 * BATCH :], w, Z, X, Y, 1.0, lanes)
                    scatter(nodes, sides, layer, start, lanes, out)


def stiffness_operator(
    mesh: GraphMesh, lame: np.ndarray, shear: np.ndarray, *, mean_dilatation: bool = False
) -> Callable[[np.ndarray], np.ndarray]:
    r"""Return the map from displacements to elastic forces, :math:`u \mapsto K u`.

    Parameters
    ----------
    mesh : GraphMesh
    lame, shear : ndarray, shape (layers,) or (nx, layers, ny)
        Lame's parameters of each layer or element, Pa.
    mean_dilatation : bool
        Whether the divergence is averaged over each element (B-bar), against locking of nearly
        incompressible materials.

    Returns
    -------
    callable
        Takes displacements, shape ``(nx, layers, 3, ny)``, m, and returns forces, N.
    """
    heights = np.ascontiguousarray(mesh.surface.heights, dtype=np.float64)
    dx, dy = mesh.surface.spacing
    lame, shear = (
        np.require(value[None, :, None] if value.ndim == 1 else value, float, ["C", "W"])
        for value in (lame, shear)
    )

    def apply(u: np.ndarray) -> np.ndarray:
        out = np.empty_like(u)
        _apply(heights, mesh.planes, mesh.map_factor, dx, dy, lame, shear, mean_dilatation, u, out)
        return out

    return apply
