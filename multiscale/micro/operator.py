r"""Matrix-free elastic stiffness of the layered cell: trilinear hexahedra, one pass per layer.

Displacements and forces are arrays of shape ``(nx, layers, 3, ny)``: the node plane at the clamped
base is left out, and y runs fastest so that the kernel works on contiguous batches of elements.

In the reference element the gradient of a trilinear field needs differences along one edge
direction and interpolation along the other two. With Gauss points at :math:`\pm 1/\sqrt 3` both
are products of :math:`2 \times 2` matrices, and the derivative along an edge direction is the same
at both Gauss points of that direction: 12 numbers instead of 24 per component.
"""

from collections.abc import Callable

import numba
import numpy as np

from multiscale.micro.mesh import GraphMesh

__all__ = ["stiffness_operator"]

BATCH = 32  # elements along y in one batch; the arrays of one batch stay in the first-level cache
X, Y, Z = 4 * BATCH, 2 * BATCH, BATCH  # distances of corner values along x, y and z
NEAR, FAR = 0.5 + 0.5 / np.sqrt(3.0), 0.5 - 0.5 / np.sqrt(3.0)  # linear shape functions


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _differences(nodes, grad, d, e, f, scale, lanes):  # type: ignore[no-untyped-def]
    """Edge derivative in one direction at the Gauss points (qe, qf) of the other two.

    ``d``, ``e`` and ``f`` are the distances in ``nodes`` between neighbours along the direction
    of the derivative and along the other two; ``grad`` gets four rows.
    """
    for v in range(lanes):
        a = scale * (nodes[d + v] - nodes[v])
        b = scale * (nodes[d + f + v] - nodes[f + v])
        p, q = NEAR * a + FAR * b, FAR * a + NEAR * b
        a = scale * (nodes[d + e + v] - nodes[e + v])
        b = scale * (nodes[d + e + f + v] - nodes[e + f + v])
        r, s = NEAR * a + FAR * b, FAR * a + NEAR * b
        grad[v], grad[BATCH + v] = NEAR * p + FAR * r, NEAR * q + FAR * s
        grad[2 * BATCH + v], grad[3 * BATCH + v] = FAR * p + NEAR * r, FAR * q + NEAR * s


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _differences_transposed(grad, nodes, d, e, f, scale, lanes):  # type: ignore[no-untyped-def]
    """Add the transpose of :func:`_differences` to ``nodes``."""
    for v in range(lanes):
        p = scale * (NEAR * grad[v] + FAR * grad[2 * BATCH + v])
        q = scale * (NEAR * grad[BATCH + v] + FAR * grad[3 * BATCH + v])
        r = scale * (FAR * grad[v] + NEAR * grad[2 * BATCH + v])
        s = scale * (FAR * grad[BATCH + v] + NEAR * grad[3 * BATCH + v])
        a, b = NEAR * p + FAR * q, FAR * p + NEAR * q
        nodes[v] -= a
        nodes[d + v] += a
        nodes[f + v] -= b
        nodes[d + f + v] += b
        a, b = NEAR * r + FAR * s, FAR * r + NEAR * s
        nodes[e + v] -= a
        nodes[d + e + v] += a
        nodes[e + f + v] -= b
        nodes[d + e + f + v] += b


@numba.njit(cache=True, fastmath=True, error_model="numpy")
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


@numba.njit(cache=True, fastmath=True, error_model="numpy")
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


@numba.njit(parallel=True, cache=True, fastmath=True, error_model="numpy")
def _apply(  # type: ignore[no-untyped-def]
    heights, planes, factor, dx, dy, lame, shear, mean_dilatation, u, out
):
    """Add the elastic forces of every element; strips of elements in x in two colours.

    A single point in x or y has itself as neighbour: plane strain.
    """
    nx, layers, _, ny = u.shape
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
                _lateral_heights(heights, sides[0], sides[1], start, dx, dy, lateral, lanes)
                for layer in range(layers):
                    _geometry(
                        lateral,
                        planes[layer],
                        planes[layer + 1],
                        factor[layer],
                        factor[layer + 1],
                        geometry,
                        lanes,
                    )
                    for v in range(lanes):
                        first[v] = lame[i, layer, start + v]
                        second[v] = shear[i, layer, start + v]
                    for k in range(3):
                        for a in range(2):
                            for c in range(2):
                                low = (8 * k + 4 * a + c) * BATCH
                                high = low + 2 * BATCH
                                if layer + c == 0:
                                    for v in range(lanes):
                                        nodes[low + v] = 0.0
                                        nodes[high + v] = 0.0
                                else:
                                    row = u[sides[a], layer + c - 1, k]
                                    for v in range(lanes):
                                        nodes[low + v] = row[start + v]
                                    for v in range(lanes - 1):
                                        nodes[high + v] = row[start + v + 1]
                                    nodes[high + lanes - 1] = row[(start + lanes) % ny]
                        w, g = nodes[8 * k * BATCH :], grad[12 * k * BATCH :]
                        _differences(w, g, X, Y, Z, 1.0 / dx, lanes)
                        _differences(w, g[4 * BATCH :], Y, X, Z, 1.0 / dy, lanes)
                        _differences(w, g[8 * BATCH :], Z, X, Y, 1.0, lanes)
                    if mean_dilatation:
                        _mean_dilatation(grad, geometry, mean, volume, lanes)
                    area = dx * dy / 8.0
                    _forces(grad, flux, geometry, first, second, mean, mean_dilatation, area, lanes)
                    for k in range(3):
                        w, g = nodes[8 * k * BATCH :], flux[12 * k * BATCH :]
                        w[: 8 * BATCH] = 0.0
                        _differences_transposed(g, w, X, Y, Z, 1.0 / dx, lanes)
                        _differences_transposed(g[4 * BATCH :], w, Y, X, Z, 1.0 / dy, lanes)
                        _differences_transposed(g[8 * BATCH :], w, Z, X, Y, 1.0, lanes)
                        for a in range(2):
                            for c in range(2):
                                low = (8 * k + 4 * a + c) * BATCH
                                high = low + 2 * BATCH
                                if layer + c > 0:
                                    row = out[sides[a], layer + c - 1, k]
                                    for v in range(lanes):
                                        row[start + v] += nodes[low + v]
                                    for v in range(lanes - 1):
                                        row[start + v + 1] += nodes[high + v]
                                    row[(start + lanes) % ny] += nodes[high + lanes - 1]


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _lateral_heights(heights, i, i1, start, dx, dy, lateral, lanes):  # type: ignore[no-untyped-def]
    """Surface heights (rows 0-3) and slopes (x: rows 4-5, y: rows 6-7) at the Gauss points."""
    ny = heights.shape[1]
    for v in range(lanes):
        j, j1 = start + v, (start + v + 1) % ny
        h00, h01, h10, h11 = heights[i, j], heights[i, j1], heights[i1, j], heights[i1, j1]
        p, q, r, s = (
            NEAR * h00 + FAR * h10,
            NEAR * h01 + FAR * h11,
            FAR * h00 + NEAR * h10,
            FAR * h01 + NEAR * h11,
        )
        lateral[v], lateral[BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q
        lateral[2 * BATCH + v], lateral[3 * BATCH + v] = NEAR * r + FAR * s, FAR * r + NEAR * s
        p, q = (h10 - h00) / dx, (h11 - h01) / dx
        lateral[4 * BATCH + v], lateral[5 * BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q
        p, q = (h01 - h00) / dy, (h11 - h10) / dy
        lateral[6 * BATCH + v], lateral[7 * BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _geometry(lateral, z0, z1, f0, f1, geometry, lanes):  # type: ignore[no-untyped-def]
    """Element heights and slopes of the vertical map z = Z + phi h at the Gauss points."""
    near, far = NEAR * f0 + FAR * f1, FAR * f0 + NEAR * f1
    for v in range(lanes):
        for q in range(4):
            geometry[q * BATCH + v] = z1 - z0 + (f1 - f0) * lateral[q * BATCH + v]
        for q in range(4):
            slope = lateral[(4 + q) * BATCH + v]
            geometry[(4 + 2 * q) * BATCH + v] = near * slope
            geometry[(5 + 2 * q) * BATCH + v] = far * slope


def stiffness_operator(
    mesh: GraphMesh, lame: np.ndarray, shear: np.ndarray, *, mean_dilatation: bool = False
) -> Callable[[np.ndarray], np.ndarray]:
    r"""Return the map from displacements to elastic forces, :math:`u \mapsto K u`.

    Parameters
    ----------
    mesh : GraphMesh
        The conforming mesh, clamped at its base.
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
    nx, ny, layers = mesh.shape
    lame, shear = (
        np.broadcast_to(value[:, None] if value.ndim == 1 else value, (nx, layers, ny))
        for value in (lame, shear)
    )

    def apply(u: np.ndarray) -> np.ndarray:
        out = np.empty_like(u)
        _apply(heights, mesh.planes, mesh.map_factor, dx, dy, lame, shear, mean_dilatation, u, out)
        return out

    return apply
