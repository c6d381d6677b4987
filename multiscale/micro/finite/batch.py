r"""Deformation gradients of a batch of hexahedra, from corner values and back to corner forces.

All numbers of a batch are in one array of rows of :data:`BATCH` lanes, one lane for each element,
so that the compiler recognises overlaps and vectorises every loop over lanes. The constants below
are offsets in this array. Lanes without an element repeat the first element and are not scattered.
Lengths are in m, forces in N, stresses in Pa.

With the parent coordinates :math:`a = (x, y, \zeta)` of the layered mesh the physical gradient is
:math:`\partial_J = T_{aJ} \partial_a`,

.. math::
    T = \begin{pmatrix} 1 & 0 & 0 \\ 0 & 1 & 0 \\ -s_x/h & -s_y/h & 1/h \end{pmatrix},    \tag{1}

with the height :math:`h` of the element and the slopes :math:`s` of its node surfaces. Stresses and
tangents are pulled back with it once, so that a tangent is applied without any geometry.
"""

import math

from multiscale.micro.elastic.hexahedron import (
    BATCH,
    X,
    Y,
    Z,
    differences,
    differences_transposed,
    element_geometry,
    gather,
    lateral_heights,
)
from multiscale.numerics.compiled import compiled

__all__ = [
    "CHANGE",
    "COFACTOR",
    "DEFORMED",
    "DET",
    "DILATED",
    "EDGES",
    "FLUX",
    "GEOMETRY",
    "GRADIENT",
    "LOG",
    "MEAN",
    "METRIC",
    "NODES",
    "PRESSURE",
    "PULLED",
    "SCRATCH",
    "VOLUME",
    "WEIGHT",
    "edge_derivatives",
    "edge_forces",
    "kernel",
    "logarithm",
    "part",
    "point_rows",
    "pull_back",
    "strain_batch",
]

# without ninf and nnan, because callers check for NaN
kernel = compiled(fastmath={"contract", "reassoc", "nsz", "arcp"})
part = compiled(fastmath={"contract", "reassoc", "nsz", "arcp"}, forceinline=True)
"""Kernel that joins its caller, which saves the counting of references to slices."""

NODES = 0  # 24 rows: corner values, component by component
EDGES = NODES + 24 * BATCH  # 36: edge derivatives
FLUX = EDGES + 36 * BATCH  # 36: fluxes conjugate to them
GEOMETRY = FLUX + 36 * BATCH  # 12
LATERAL = GEOMETRY + 12 * BATCH  # 8
GRADIENT = LATERAL + 8 * BATCH  # 72: F at the eight Gauss points
DET = GRADIENT + 72 * BATCH  # 8: det F
WEIGHT = DET + 8 * BATCH  # 8: volume of each Gauss point
VOLUME = WEIGHT + 8 * BATCH  # of the element
MEAN = VOLUME + BATCH  # mean det F
LOG = MEAN + BATCH  # volumetric Kirchhoff stress and its derivative by ln J
CHANGE = LOG + 2 * BATCH  # ln J, of a point or of the mean
COFACTOR = CHANGE + BATCH  # 9: F^-T
PULLED = COFACTOR + 9 * BATCH  # 9: F^-T T^t
DEFORMED = PULLED + 9 * BATCH  # 9: F of the point
METRIC = DEFORMED + 9 * BATCH  # rows of a law
DILATED = METRIC + 91 * BATCH  # 36: flux of the change of volume
PRESSURE = DILATED + 36 * BATCH  # tensile
SCRATCH = PRESSURE + BATCH

NEAR_ONE = 0.03  # squared argument of the series of the logarithm: numbers from 1/4 to 4


@kernel
def edge_derivatives(s, dx, dy):  # type: ignore[no-untyped-def]
    """Differentiate by the parent coordinates from the corner values."""
    for k in range(3):
        w, g = s[NODES + 8 * k * BATCH :], s[EDGES + 12 * k * BATCH :]
        differences(w, g, X, Y, Z, 1.0 / dx, BATCH)
        differences(w, g[4 * BATCH :], Y, X, Z, 1.0 / dy, BATCH)
        differences(w, g[8 * BATCH :], Z, X, Y, 1.0, BATCH)


@kernel
def edge_forces(s, dx, dy):  # type: ignore[no-untyped-def]
    """Corner forces from the flux, the transpose of :func:`edge_derivatives`."""
    for v in range(24 * BATCH):
        s[NODES + v] = 0.0
    for k in range(3):
        w, g = s[NODES + 8 * k * BATCH :], s[FLUX + 12 * k * BATCH :]
        differences_transposed(g, w, X, Y, Z, 1.0 / dx, BATCH)
        differences_transposed(g[4 * BATCH :], w, Y, X, Z, 1.0 / dy, BATCH)
        differences_transposed(g[8 * BATCH :], w, Z, X, Y, 1.0, BATCH)


@kernel
def _mesh_batch(  # type: ignore[no-untyped-def]
    heights, planes, factor, sides, layer, start, lanes, dx, dy, s
):
    """Heights and slopes of the elements of a batch."""
    lateral = s[LATERAL : LATERAL + 8 * BATCH]
    lateral_heights(heights, sides[0], sides[1], start, dx, dy, lateral, lanes)
    for row in range(8):
        for v in range(lanes, BATCH):
            lateral[row * BATCH + v] = lateral[row * BATCH]
    element_geometry(
        lateral,
        planes[layer],
        planes[layer + 1],
        factor[layer],
        factor[layer + 1],
        s[GEOMETRY:],
        BATCH,
    )


@part
def point_rows(q):  # type: ignore[no-untyped-def]
    """Offsets of the derivatives by x, y and zeta at a Gauss point, and of its height."""
    qx, qy, qz = q // 4, (q // 2) % 2, q % 2
    return (
        (2 * qy + qz) * BATCH,
        (4 + 2 * qx + qz) * BATCH,
        (8 + 2 * qx + qy) * BATCH,
        (2 * qx + qy) * BATCH,
    )


@kernel
def _deformation(s, area):  # type: ignore[no-untyped-def]
    """F, det F and weight at the Gauss points, their mean; return the smallest det F."""
    least = 1e300
    for v in range(BATCH):
        s[VOLUME + v], s[MEAN + v] = 0.0, 0.0
    for q in range(8):
        rx, ry, rz, rt = point_rows(q)
        for k in range(3):
            e = EDGES + 12 * k * BATCH
            f = GRADIENT + (9 * q + 3 * k) * BATCH
            for v in range(BATCH):
                by_z = s[e + rz + v] / s[GEOMETRY + rt + v]
                s[f + v] = s[e + rx + v] - s[GEOMETRY + rx + 4 * BATCH + v] * by_z
                s[f + BATCH + v] = s[e + ry + v] - s[GEOMETRY + ry + 4 * BATCH + v] * by_z
                s[f + 2 * BATCH + v] = by_z
            for v in range(BATCH):
                s[f + k * BATCH + v] += 1.0
        f, j, w = GRADIENT + 9 * q * BATCH, DET + q * BATCH, WEIGHT + q * BATCH
        for v in range(BATCH):
            xx, xy, xz = s[f + v], s[f + BATCH + v], s[f + 2 * BATCH + v]
            yx, yy, yz = s[f + 3 * BATCH + v], s[f + 4 * BATCH + v], s[f + 5 * BATCH + v]
            zx, zy, zz = s[f + 6 * BATCH + v], s[f + 7 * BATCH + v], s[f + 8 * BATCH + v]
            det = xx * (yy * zz - yz * zy) - xy * (yx * zz - yz * zx) + xz * (yx * zy - yy * zx)
            weight = area * s[GEOMETRY + rt + v]
            s[j + v], s[w + v] = det, weight
            s[VOLUME + v] += weight
            s[MEAN + v] += weight * det
        for v in range(BATCH):
            if not s[j + v] >= least:
                least = s[j + v]
    for v in range(BATCH):
        s[MEAN + v] /= s[VOLUME + v]
    return least


@kernel
def strain_batch(  # type: ignore[no-untyped-def]
    heights, planes, factor, dx, dy, u, sides, layer, start, lanes, s
):
    """F, det F and weights of a batch under a displacement; return the smallest det F."""
    _mesh_batch(heights, planes, factor, sides, layer, start, lanes, dx, dy, s)
    gather(u, sides, layer, start, lanes, s[NODES:])
    edge_derivatives(s, dx, dy)
    return _deformation(s, dx * dy / 8.0)


@part
def pull_back(s, q):  # type: ignore[no-untyped-def]
    """F^-T and F^-T T^t of (1) at a Gauss point."""
    rx, ry, _, rt = point_rows(q)
    _pull(
        s[GRADIENT + 9 * q * BATCH :],
        s[DET + q * BATCH :],
        s[GEOMETRY + rt :],
        s[GEOMETRY + rx + 4 * BATCH :],
        s[GEOMETRY + ry + 4 * BATCH :],
        s[COFACTOR:],
    )


@part
def _pull(f, det, height, by_x, by_y, out):  # type: ignore[no-untyped-def]
    """Write COFACTOR, PULLED and DEFORMED. A loop over few slices takes its lanes at once."""
    for i in range(3):
        first, second = 3 * ((i + 1) % 3) * BATCH, 3 * ((i + 2) % 3) * BATCH
        row, copy = 3 * i * BATCH, 18 * BATCH + first
        for v in range(BATCH):
            x, y, z = f[first + v], f[first + BATCH + v], f[first + 2 * BATCH + v]
            a, b, c = f[second + v], f[second + BATCH + v], f[second + 2 * BATCH + v]
            out[copy + v], out[copy + BATCH + v], out[copy + 2 * BATCH + v] = x, y, z
            scale = 1.0 / det[v]
            x, y, z = scale * (y * c - z * b), scale * (z * a - x * c), scale * (x * b - y * a)
            out[row + v], out[row + BATCH + v], out[row + 2 * BATCH + v] = x, y, z
            out[row + 9 * BATCH + v], out[row + 10 * BATCH + v] = x, y
            out[row + 11 * BATCH + v] = (z - by_x[v] * x - by_y[v] * y) / height[v]


@kernel
def logarithm(x, out):  # type: ignore[no-untyped-def]
    """Natural logarithm of a row, by the series of atanh if all lanes are near one."""
    far = 0.0
    for v in range(BATCH):
        root = math.sqrt(math.sqrt(x[v]))
        z = (root - 1.0) / (root + 1.0)  # ln x = 8 atanh z
        w = z * z
        series = 1.0 / 15.0 + w * (1.0 / 17.0 + w * (1.0 / 19.0 + w * (1.0 / 21.0 + w / 23.0)))
        series = 1.0 / 9.0 + w * (1.0 / 11.0 + w * (1.0 / 13.0 + w * series))
        series = 1.0 + w * (1.0 / 3.0 + w * (1.0 / 5.0 + w * (1.0 / 7.0 + w * series)))
        out[v] = 8.0 * z * series
        far += 0.0 if w < NEAR_ONE else 1.0
    if far > 0.0:
        for v in range(BATCH):
            out[v] = math.log(x[v])
