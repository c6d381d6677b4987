"""Matrix-free elastic stiffness of the layered cell: trilinear hexahedra, from the base up.

Displacements and forces are arrays of shape ``(nx, layers, 3, ny)`` without the clamped base. The
*rows* of a node plane serve the elements below and above it: for each component the derivative
along x at the Gauss points :math:`q_y` and along y at :math:`q_x`, and the value at the four
:math:`(q_x, q_y)`. The derivative along an edge direction is the same at both Gauss points of it.
"""

from collections.abc import Callable

import numpy as np

from multiscale.executors import run_ranges
from multiscale.micro.layer import GraphMesh
from multiscale.numerics.compiled import compiled

BATCH = 32  # elements along y in a batch: its arrays fit into the first two caches
X, Y, Z = 4 * BATCH, 2 * BATCH, BATCH  # distances of corner values along x, y and z
NEAR, FAR = 0.5 + 0.5 / np.sqrt(3.0), 0.5 - 0.5 / np.sqrt(3.0)  # linear shape functions

ROWS = 8 * BATCH  # values of a component on a node plane
EDGES = 12 * BATCH  # edge derivatives of a component in an element
STRIPS = 8  # fewest consecutive strips of elements on a thread
LEAST = 7000  # fewest elements for a thread


@compiled(fastmath=True, forceinline=True)
def shape_functions(like):  # type: ignore[no-untyped-def]
    """:data:`NEAR` and :data:`FAR` in the precision of an array."""
    return like.dtype.type(NEAR), like.dtype.type(FAR)


@compiled(fastmath=True)
def differences(nodes, grad, d, e, f, scale, lanes):  # type: ignore[no-untyped-def]
    """Edge derivative along nodes ``d`` apart at the Gauss points of the other two directions."""
    for v in range(lanes):
        a = scale * (nodes[d + v] - nodes[v])
        b = scale * (nodes[d + f + v] - nodes[f + v])
        p, q = NEAR * a + FAR * b, FAR * a + NEAR * b
        a = scale * (nodes[d + e + v] - nodes[e + v])
        b = scale * (nodes[d + e + f + v] - nodes[e + f + v])
        r, s = NEAR * a + FAR * b, FAR * a + NEAR * b
        grad[v], grad[BATCH + v] = NEAR * p + FAR * r, NEAR * q + FAR * s
        grad[2 * BATCH + v], grad[3 * BATCH + v] = FAR * p + NEAR * r, FAR * q + NEAR * s


@compiled(fastmath=True)
def differences_transposed(grad, nodes, d, e, f, scale, lanes):  # type: ignore[no-untyped-def]
    """Add the transpose of :func:`differences` to ``nodes``."""
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


@compiled(fastmath=True)
def lateral_heights(heights, i, i1, start, dx, dy, lateral, lanes):  # type: ignore[no-untyped-def]
    """Surface heights (rows 0-3) and slopes (x: rows 4-5, y: rows 6-7) at the Gauss points."""
    ny = heights.shape[1]
    for v in range(lanes):
        j, j1 = start + v, (start + v + 1) % ny
        h00, h01, h10, h11 = heights[i, j], heights[i, j1], heights[i1, j], heights[i1, j1]
        p, q = NEAR * h00 + FAR * h10, NEAR * h01 + FAR * h11
        r, s = FAR * h00 + NEAR * h10, FAR * h01 + NEAR * h11
        lateral[v], lateral[BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q
        lateral[2 * BATCH + v], lateral[3 * BATCH + v] = NEAR * r + FAR * s, FAR * r + NEAR * s
        p, q = (h10 - h00) / dx, (h11 - h01) / dx
        lateral[4 * BATCH + v], lateral[5 * BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q
        p, q = (h01 - h00) / dy, (h11 - h10) / dy
        lateral[6 * BATCH + v], lateral[7 * BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q


@compiled(fastmath=True)
def element_geometry(lateral, z0, z1, f0, f1, geometry, lanes):  # type: ignore[no-untyped-def]
    """Element heights and slopes of the vertical map z = Z + phi h at the Gauss points."""
    real = geometry.dtype.type
    near, far = real(NEAR * f0 + FAR * f1), real(FAR * f0 + NEAR * f1)
    thickness, stretch = real(z1 - z0), real(f1 - f0)
    for q in range(4):
        height, slope, to = q * BATCH, (4 + q) * BATCH, (4 + 2 * q) * BATCH
        for v in range(lanes):
            geometry[height + v] = thickness + stretch * lateral[height + v]
            geometry[to + v] = near * lateral[slope + v]
            geometry[to + BATCH + v] = far * lateral[slope + v]


@compiled(fastmath=True)
def gather(field, sides, layer, start, lanes, nodes):  # type: ignore[no-untyped-def]
    """Corner values of a strip of elements between two planes, by components; the base is fixed."""
    ny = field.shape[3]
    for k in range(3):
        for a in range(2):
            for c in range(2):
                low = (8 * k + 4 * a + c) * BATCH
                high = low + 2 * BATCH
                if layer + c == 0:
                    for v in range(BATCH):
                        nodes[low + v] = 0.0
                        nodes[high + v] = 0.0
                else:
                    row = field[sides[a], layer + c - 1, k]
                    for v in range(lanes):
                        nodes[low + v] = row[start + v]
                    for v in range(lanes - 1):
                        nodes[high + v] = row[start + v + 1]
                    nodes[high + lanes - 1] = row[(start + lanes) % ny]
                    for v in range(lanes, BATCH):
                        nodes[low + v], nodes[high + v] = nodes[low], nodes[high]


@compiled(fastmath=True)
def scatter(nodes, sides, layer, start, lanes, out):  # type: ignore[no-untyped-def]
    """Add corner forces to a field, the transpose of :func:`gather`."""
    ny = out.shape[3]
    for k in range(3):
        for a in range(2):
            for c in range(2):
                low = (8 * k + 4 * a + c) * BATCH
                high = low + 2 * BATCH
                if layer + c > 0:
                    row = out[sides[a], layer + c - 1, k]
                    near, far = row[start:], row[start + 1 :]  # slices: loops are vectorised
                    for v in range(lanes):
                        near[v] += nodes[low + v]
                    for v in range(lanes - 1):
                        far[v] += nodes[high + v]
                    row[(start + lanes) % ny] += nodes[high + lanes - 1]


@compiled(fastmath=True)
def _plane_rows(plane, sides, start, lanes, per_x, per_y, line, rows):  # type: ignore[no-untyped-def]
    """Derive and interpolate a field of shape (nx, 3, ny) at the lateral Gauss points."""
    ny = plane.shape[2]
    NEAR, FAR = shape_functions(rows)
    last = (start + lanes) % ny
    far = line[BATCH + 1 :]
    for k in range(3):
        near_row, far_row = plane[sides[0], k], plane[sides[1], k]
        for v in range(lanes):
            line[v], far[v] = near_row[start + v], far_row[start + v]
        line[lanes], far[lanes] = near_row[last], far_row[last]
        to = rows[k * ROWS :]
        for v in range(lanes):
            a, b, c, d = line[v], line[v + 1], far[v], far[v + 1]
            p, q = per_x * (c - a), per_x * (d - b)
            to[v], to[BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q
            p, q = per_y * (b - a), per_y * (d - c)
            to[2 * BATCH + v], to[3 * BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q
            p, q = NEAR * a + FAR * c, NEAR * b + FAR * d
            to[4 * BATCH + v], to[5 * BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q
            p, q = FAR * a + NEAR * c, FAR * b + NEAR * d
            to[6 * BATCH + v], to[7 * BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q


@compiled(fastmath=True)
def _add_plane(rows, sides, start, lanes, per_x, per_y, line, plane):  # type: ignore[no-untyped-def]
    """Add nodal forces to a field of shape (nx, 3, ny), the transpose of :func:`_plane_rows`."""
    ny = plane.shape[2]
    NEAR, FAR = shape_functions(rows)
    last = (start + lanes) % ny
    far, next_line = line[BATCH + 1 :], line[2 * BATCH + 2 :]
    next_far = line[3 * BATCH + 3 :]
    for k in range(3):
        of = rows[k * ROWS :]
        for v in range(lanes):
            p = per_x * (NEAR * of[v] + FAR * of[BATCH + v])
            q = per_x * (FAR * of[v] + NEAR * of[BATCH + v])
            r = per_y * (NEAR * of[2 * BATCH + v] + FAR * of[3 * BATCH + v])
            s = per_y * (FAR * of[2 * BATCH + v] + NEAR * of[3 * BATCH + v])
            e = NEAR * of[4 * BATCH + v] + FAR * of[5 * BATCH + v]
            f = FAR * of[4 * BATCH + v] + NEAR * of[5 * BATCH + v]
            g = NEAR * of[6 * BATCH + v] + FAR * of[7 * BATCH + v]
            h = FAR * of[6 * BATCH + v] + NEAR * of[7 * BATCH + v]
            line[v] = NEAR * e + FAR * g - p - r
            far[v] = FAR * e + NEAR * g + p - s
            next_line[v + 1] = NEAR * f + FAR * h - q + r
            next_far[v + 1] = FAR * f + NEAR * h + q + s
        near_row, far_row = plane[sides[0], k], plane[sides[1], k]
        next_line[0], next_far[0] = 0.0, 0.0
        for v in range(lanes):
            near_row[start + v] += line[v] + next_line[v]
        for v in range(lanes):  # a separate loop: the same row if nx = 1
            far_row[start + v] += far[v] + next_far[v]
        near_row[last] += next_line[lanes]
        far_row[last] += next_far[lanes]


@compiled(fastmath=True)
def _edge_derivatives(low, up, grad, lanes):  # type: ignore[no-untyped-def]
    """Compute twelve edge derivatives of each component from the rows below and above elements."""
    NEAR, FAR = shape_functions(grad)
    for k in range(3):
        a, b, to = low[k * ROWS :], up[k * ROWS :], grad[k * EDGES :]
        for r in range(4):
            slope, value, along = r * BATCH, (4 + r) * BATCH, (8 + r) * BATCH
            for v in range(lanes):
                to[2 * slope + v] = NEAR * a[slope + v] + FAR * b[slope + v]
                to[2 * slope + BATCH + v] = FAR * a[slope + v] + NEAR * b[slope + v]
                to[along + v] = b[value + v] - a[value + v]


@compiled(fastmath=True)
def _add_edge_fluxes(flux, low, up, lanes):  # type: ignore[no-untyped-def]
    """Add to the rows below the elements and set the rows above: the transpose."""
    NEAR, FAR = shape_functions(flux)
    for k in range(3):
        of, a, b = flux[k * EDGES :], low[k * ROWS :], up[k * ROWS :]
        for r in range(4):
            slope, value, along = r * BATCH, (4 + r) * BATCH, (8 + r) * BATCH
            for v in range(lanes):
                a[slope + v] += NEAR * of[2 * slope + v] + FAR * of[2 * slope + BATCH + v]
                b[slope + v] = FAR * of[2 * slope + v] + NEAR * of[2 * slope + BATCH + v]
                a[value + v] -= of[along + v]
                b[value + v] = of[along + v]


@compiled(fastmath=True)
def _mean_dilatation(grad, geometry, mean, volume, lanes):  # type: ignore[no-untyped-def]
    """Volume average of the divergence over each element."""
    twice = mean.dtype.type(2.0)
    mean[:], volume[:] = 0.0, 0.0
    for qx in range(2):
        for qy in range(2):
            x, y = 2 * qy * BATCH, (4 + 2 * qx) * BATCH
            t = (2 * qx + qy) * BATCH
            z = 8 * BATCH + t
            for v in range(lanes):
                height = geometry[t + v]
                slope_x = geometry[x + 4 * BATCH + v] + geometry[x + 5 * BATCH + v]
                slope_y = geometry[y + 4 * BATCH + v] + geometry[y + 5 * BATCH + v]
                lateral = grad[x + v] + grad[x + BATCH + v]
                lateral += grad[y + EDGES + v] + grad[y + EDGES + BATCH + v]
                by_z = twice * grad[z + 2 * EDGES + v] - slope_x * grad[z + v]
                mean[v] += height * lateral + by_z - slope_y * grad[z + EDGES + v]
                volume[v] += twice * height
    for v in range(lanes):
        mean[v] /= volume[v]


@compiled(fastmath=True, forceinline=True)
def _add_stress(x, y, grad, flux, by_z, slopes, law):  # type: ignore[no-untyped-def]
    """Add the stress at a Gauss point to the fluxes in x and y; return the fluxes along z."""
    uz, vz, wz = by_z
    slope_x, slope_y = slopes
    lame, shear, bulk, mean = law
    ux, uy = grad[x] - slope_x * uz, grad[y] - slope_y * uz
    vx, vy = grad[x + EDGES] - slope_x * vz, grad[y + EDGES] - slope_y * vz
    wx, wy = grad[x + 2 * EDGES] - slope_x * wz, grad[y + 2 * EDGES] - slope_y * wz
    trace = ux + vy + wz
    pressure = lame * trace + bulk * (mean - trace)
    twice = shear + shear
    xx, yy, zz = pressure + twice * ux, pressure + twice * vy, pressure + twice * wz
    xy, yz, xz = shear * (uy + vx), shear * (vz + wy), shear * (uz + wx)
    flux[x] += xx
    flux[x + EDGES] += xy
    flux[x + 2 * EDGES] += xz
    flux[y] += xy
    flux[y + EDGES] += yy
    flux[y + 2 * EDGES] += yz
    along_x = xz - slope_x * xx - slope_y * xy
    along_y = yz - slope_x * xy - slope_y * yy
    return along_x, along_y, zz - slope_x * xz - slope_y * yz


@compiled(fastmath=True, forceinline=True)
def _column(qx, qy, grad, flux, geometry, moduli, mean, lanes):  # type: ignore[no-untyped-def]
    """Add the fluxes of the two Gauss points above each other at constant (qx, qy)."""
    x, y, z = 2 * qy * BATCH, (4 + 2 * qx) * BATCH, (8 + 2 * qx + qy) * BATCH
    unit = geometry.dtype.type(1.0)
    for v in range(lanes):
        height = geometry[z - 8 * BATCH + v]
        inverse = unit / height
        lame, shear, bulk = moduli[v], moduli[BATCH + v], moduli[2 * BATCH + v]
        law = height * lame, height * shear, height * bulk, mean[v]
        by_z = (
            inverse * grad[z + v],
            inverse * grad[z + EDGES + v],
            inverse * grad[z + 2 * EDGES + v],
        )
        w = v + BATCH
        near = geometry[x + 4 * BATCH + v], geometry[y + 4 * BATCH + v]
        far = geometry[x + 4 * BATCH + w], geometry[y + 4 * BATCH + w]
        zu, zv, zw = _add_stress(x + v, y + v, grad, flux, by_z, near, law)
        far_u, far_v, far_w = _add_stress(x + w, y + w, grad, flux, by_z, far, law)
        flux[z + v] = inverse * (zu + far_u)
        flux[z + EDGES + v] = inverse * (zv + far_v)
        flux[z + 2 * EDGES + v] = inverse * (zw + far_w)


@compiled(fastmath=True)
def _fluxes(grad, flux, geometry, moduli, mean, lanes):  # type: ignore[no-untyped-def]
    """Stress at the eight Gauss points, pulled back to the edge derivatives; ``mean``: B-bar."""
    # geometry: element heights at the lateral Gauss points (rows 0-3), slopes in x at (qy, qz)
    # (4-7), in y at (qx, qz) (8-11); grad and flux: along x at (qy, qz), y at (qx, qz), z at (qx,
    # qy)
    for k in range(3):
        flux[k * EDGES : k * EDGES + 8 * BATCH] = 0.0
    # constant offsets: with loops the compiler does not recognise that the rows are disjoint
    _column(0, 0, grad, flux, geometry, moduli, mean, lanes)
    _column(0, 1, grad, flux, geometry, moduli, mean, lanes)
    _column(1, 0, grad, flux, geometry, moduli, mean, lanes)
    _column(1, 1, grad, flux, geometry, moduli, mean, lanes)


@compiled(fastmath=True)
def _apply(  # type: ignore[no-untyped-def]
    first, end_chunk, chunks, last, mesh, lame, shear, blend, u, out
):
    """Elastic forces of the elements in chunks of strips along x."""
    nx, layers, _, ny = u.shape
    heights, planes, factor, dx, dy = mesh
    along_x, along_y = int(lame.shape[0] > 1), int(lame.shape[2] > 1)
    area, real = dx * dy / 8.0, u.dtype
    per_x, per_y = real.type(1.0 / dx), real.type(1.0 / dy)
    for chunk in range(first, end_chunk):
        begin, end = chunk * nx // chunks, (chunk + 1) * nx // chunks
        if last:
            begin = end - 1
        else:
            out[begin:end] = 0.0
            end -= 1
        line = np.empty(4 * (BATCH + 1), real)
        u_rows, f_rows = np.empty((2, 3 * ROWS), real), np.empty((2, 3 * ROWS), real)
        grad, flux = np.empty(3 * EDGES, real), np.empty(3 * EDGES, real)
        geometry, lateral = np.empty(12 * BATCH, real), np.empty(8 * BATCH, real)
        moduli = np.empty(3 * BATCH, real)
        mean, volume = np.zeros(BATCH, real), np.empty(BATCH, real)
        for i in range(begin, end):
            sides = (i, (i + 1) % nx)
            for start in range(0, ny, BATCH):
                lanes = min(BATCH, ny - start)
                lateral_heights(heights, sides[0], sides[1], start, dx, dy, lateral, lanes)
                u_rows[0] = 0.0  # the base is fixed
                for layer in range(layers):
                    low, up = layer % 2, 1 - layer % 2
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
                        at = i * along_x, layer, (start + v) * along_y
                        moduli[v], moduli[BATCH + v] = area * lame[at], area * shear[at]
                        moduli[2 * BATCH + v] = blend * area * (lame[at] + shear[at] / 1.5)
                    _plane_rows(u[:, layer], sides, start, lanes, per_x, per_y, line, u_rows[up])
                    _edge_derivatives(u_rows[low], u_rows[up], grad, lanes)
                    if blend > 0.0:
                        _mean_dilatation(grad, geometry, mean, volume, lanes)
                    _fluxes(grad, flux, geometry, moduli, mean, lanes)
                    _add_edge_fluxes(flux, f_rows[low], f_rows[up], lanes)
                    if layer > 0:
                        below = out[:, layer - 1]
                        _add_plane(f_rows[low], sides, start, lanes, per_x, per_y, line, below)
                top = out[:, layers - 1]
                _add_plane(f_rows[layers % 2], sides, start, lanes, per_x, per_y, line, top)


def stiffness_operator(
    mesh: GraphMesh, lame: np.ndarray, shear: np.ndarray, *, mean_dilatation: bool = False
) -> Callable[..., np.ndarray]:
    r"""Return the map from displacements to elastic forces, :math:`u \mapsto K u`."""
    blend = float(mean_dilatation)
    lame, shear = (
        np.require(value[None, :, None] if value.ndim == 1 else value, float, ["C", "W"])
        for value in (lame, shear)
    )
    arguments = mesh.arrays, lame, shear, blend

    def apply(u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        out = np.empty_like(u) if out is None else out
        nx, layers, _, ny = u.shape
        chunks = max(1, nx // STRIPS)
        for last, strips in ((False, STRIPS), (True, 1)):
            least = -(-LEAST // (strips * layers * ny))
            run_ranges(_apply, chunks, chunks, last, *arguments, u, out, least=least)
        return out

    return apply
