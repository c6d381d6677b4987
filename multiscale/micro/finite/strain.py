r"""Strains of a batch of hexahedra: deformation gradients from corner values, logarithmic strain.

All numbers of a batch are rows of :data:`BATCH` lanes, a lane for each element, of one array ``s``,
with the constants below as offsets: separate arrays take 1.7 times as long. Lanes without an
element repeat the first element and are not scattered. With the height :math:`h` of the element and
the slopes :math:`s` of its node surfaces, the physical gradient is
:math:`\partial_J = T_{aJ} \partial_a`; stresses and tangents are pulled back with it once:

.. math::
    T = \begin{pmatrix} 1 & 0 & 0 \\ 0 & 1 & 0 \\ -s_x/h & -s_y/h & 1/h \end{pmatrix}.    \tag{1}

With the trial :math:`b = F C_p^{-1} F^t`, or its root where :math:`Z` is large, by a series,

.. math::
    \tfrac12 \ln b = \operatorname{artanh} Z, \qquad Z = I - 2 (b + I)^{-1}.    \tag{2}
"""

import math
from typing import NamedTuple

from multiscale.micro.elastic.stiffness import (
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

# without ninf and nnan, because callers check for NaN
kernel = compiled(fastmath={"contract", "reassoc", "nsz", "arcp"})
inlined = compiled(fastmath={"contract", "reassoc", "nsz", "arcp"}, forceinline=True)
"""Kernel that is inlined into its caller, which saves the counting of references to slices."""

NODES = 0  # 24 rows: corner values, component by component
EDGES = NODES + 24 * BATCH  # 36: edge derivatives
FLUX = EDGES + 36 * BATCH  # 36: fluxes conjugate to them
GEOMETRY = FLUX + 36 * BATCH  # 12: heights and slopes at the Gauss points
LATERAL = GEOMETRY + 12 * BATCH  # 8: heights and slopes of the surface
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
LAW = DEFORMED + 9 * BATCH  # 91: of a law, in large_strain.py, or from FC on and in plastic.py
DILATED = LAW + 91 * BATCH  # 36: flux of the change of volume
PRESSURE = DILATED + 36 * BATCH  # tensile
SCRATCH = PRESSURE + BATCH

NEAR_ONE = 0.03  # squared argument of the series of the logarithm: numbers from 1/4 to 4

# of the logarithmic strain; symmetric tensors have the rows 11, 22, 33, 12, 23, 13
FC = LAW  # 9: F C_p^-1
TRIAL = FC + 9 * BATCH  # 6: b
ROOT = TRIAL + 6 * BATCH  # 6: a root of b
OTHER = ROOT + 6 * BATCH  # 6 and 6: of the iteration of the root
INVERSE = OTHER + 6 * BATCH
TANH = INVERSE + 6 * BATCH  # 6: Z, then 6: its square, and 3: its invariants
STRAIN = TANH + 15 * BATCH  # 15: e, as Z
FACTOR = STRAIN + 15 * BATCH  # 3: of the powers 0, 1, 2 in a polynomial of a tensor
LAST = FACTOR + 3 * BATCH

SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
NEAR = 0.03  # largest Z : Z of the series of artanh
TERMS = 10  # of this series
ROOTS = 20  # enough for any b with eigenvalues that differ in double precision


class Moduli(NamedTuple):
    """Moduli of a law, Pa; the moduli of plastic flow are 0 for an elastic law."""

    shear: float
    volume: float  # of the change of volume
    yield_stress: float = 0.0
    hardening: float = 0.0
    saturation: float = 0.0
    rate: float = 0.0  # of the saturation, dimensionless


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
def _mesh_batch(mesh, sides, layer, start, lanes, s):  # type: ignore[no-untyped-def]
    lateral = s[LATERAL : LATERAL + 8 * BATCH]
    lateral_heights(mesh.heights, sides[0], sides[1], start, mesh.dx, mesh.dy, lateral, lanes)
    for row in range(8):
        for v in range(lanes, BATCH):
            lateral[row * BATCH + v] = lateral[row * BATCH]
    z, factor = mesh.planes, mesh.factor
    bottom, top = factor[layer], factor[layer + 1]
    element_geometry(lateral, z[layer], z[layer + 1], bottom, top, s[GEOMETRY:], BATCH)


@inlined
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
def strain_batch(mesh, u, sides, layer, start, lanes, s):  # type: ignore[no-untyped-def]
    """F, det F and weights of a batch under a displacement; return the smallest det F."""
    _mesh_batch(mesh, sides, layer, start, lanes, s)
    gather(u, sides, layer, start, lanes, s[NODES:])
    edge_derivatives(s, mesh.dx, mesh.dy)
    return _deformation(s, mesh.dx * mesh.dy / 8.0)


@inlined
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


@inlined
def _pull(f, det, height, by_x, by_y, out):  # type: ignore[no-untyped-def]
    """Write COFACTOR, PULLED and DEFORMED; loops over few slices are vectorised."""
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
    """Natural logarithm of a row, by the series of atanh if all lanes are near 1."""
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


@inlined
def trial_strain(s, state):  # type: ignore[no-untyped-def]
    """Elastic left Cauchy-Green tensor of the step without flow."""
    for k in range(3):
        f, out = DEFORMED + 3 * k * BATCH, FC + 3 * k * BATCH
        for v in range(BATCH):
            x, y, z = s[f + v], s[f + BATCH + v], s[f + 2 * BATCH + v]
            xy, yz, xz = state[3, v], state[4, v], state[5, v]
            s[out + v] = x * (1.0 + state[0, v]) + y * xy + z * xz
            s[out + BATCH + v] = x * xy + y * (1.0 + state[1, v]) + z * yz
            s[out + 2 * BATCH + v] = x * xz + y * yz + z * (1.0 + state[2, v])
    for k in range(3):
        i, j = SYMMETRIC[3 + k]
        c, f, out = FC + 3 * k * BATCH, DEFORMED + 3 * k * BATCH, TRIAL + k * BATCH
        g, h = FC + 3 * i * BATCH, DEFORMED + 3 * j * BATCH
        for v in range(BATCH):
            value = s[c + v] * s[f + v] + s[c + BATCH + v] * s[f + BATCH + v]
            s[out + v] = value + s[c + 2 * BATCH + v] * s[f + 2 * BATCH + v]
            value = s[g + v] * s[h + v] + s[g + BATCH + v] * s[h + BATCH + v]
            s[out + 3 * BATCH + v] = value + s[g + 2 * BATCH + v] * s[h + 2 * BATCH + v]


@kernel
def _invert(s, rows, more, out):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric tensor plus a multiple of I; the arguments are offsets of rows."""
    for v in range(BATCH):
        xx, yy, zz = s[rows + v] + more, s[rows + BATCH + v] + more, s[rows + 2 * BATCH + v] + more
        xy, yz, xz = s[rows + 3 * BATCH + v], s[rows + 4 * BATCH + v], s[rows + 5 * BATCH + v]
        a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        scale = 1.0 / (xx * a + xy * b + xz * c)
        s[out + v] = scale * a
        s[out + BATCH + v] = scale * (xx * zz - xz * xz)
        s[out + 2 * BATCH + v] = scale * (xx * yy - xy * xy)
        s[out + 3 * BATCH + v] = scale * b
        s[out + 4 * BATCH + v] = scale * (xy * xz - xx * yz)
        s[out + 5 * BATCH + v] = scale * c


@inlined
def _square(s, tensor):  # type: ignore[no-untyped-def]
    """Write the square of a symmetric tensor and its invariants into the nine rows after it."""
    for v in range(tensor, tensor + BATCH):
        x, y, z = s[v], s[v + BATCH], s[v + 2 * BATCH]
        xy, yz, xz = s[v + 3 * BATCH], s[v + 4 * BATCH], s[v + 5 * BATCH]
        a, b, c = xy * xy, yz * yz, xz * xz
        s[v + 6 * BATCH], s[v + 7 * BATCH] = x * x + a + c, y * y + a + b
        s[v + 8 * BATCH], s[v + 9 * BATCH] = z * z + b + c, xy * (x + y) + xz * yz
        s[v + 10 * BATCH], s[v + 11 * BATCH] = yz * (y + z) + xy * xz, xz * (x + z) + xy * yz
        s[v + 12 * BATCH], s[v + 13 * BATCH] = x + y + z, x * y + y * z + z * x - a - b - c
        s[v + 14 * BATCH] = x * (y * z - b) + xy * (xz * yz - xy * z) + xz * (xy * yz - xz * y)


@inlined
def combine(s, tensor, out):  # type: ignore[no-untyped-def]
    """Write the polynomial with FACTOR of a symmetric tensor with rows of its square."""
    for row in range(3):
        x, y, to = tensor + row * BATCH, tensor + (6 + row) * BATCH, out + row * BATCH
        for v in range(BATCH):
            a, b, c = s[FACTOR + v], s[FACTOR + BATCH + v], s[FACTOR + 2 * BATCH + v]
            s[to + v] = a + b * s[x + v] + c * s[y + v]
            s[to + 3 * BATCH + v] = b * s[x + 3 * BATCH + v] + c * s[y + 3 * BATCH + v]


@compiled(inline="always", fastmath=True)  # offsets become constants
def turn_vectors(s, tensor, vectors, out):  # type: ignore[no-untyped-def]
    """Multiply a symmetric tensor by three vectors; the arguments are offsets of rows."""
    for a in range(3):
        g, to = vectors + a * BATCH, out + a * BATCH
        for v in range(BATCH):
            x, y, z = s[g + v], s[g + 3 * BATCH + v], s[g + 6 * BATCH + v]
            xy, yz = s[tensor + 3 * BATCH + v], s[tensor + 4 * BATCH + v]
            xz = s[tensor + 5 * BATCH + v]
            s[to + v] = s[tensor + v] * x + xy * y + xz * z
            s[to + 3 * BATCH + v] = xy * x + s[tensor + BATCH + v] * y + yz * z
            s[to + 6 * BATCH + v] = xz * x + yz * y + s[tensor + 2 * BATCH + v] * z


@kernel
def _take_root(s):  # type: ignore[no-untyped-def]
    """Square root of ROOT by the iteration of Denman and Beavers, convergent for any b."""
    for k in range(6 * BATCH):
        s[OTHER + k] = 1.0 if k < 3 * BATCH else 0.0
    for _ in range(60):
        _invert(s, ROOT, 0.0, INVERSE)
        _invert(s, OTHER, 0.0, TANH)
        moved = 0.0
        for k in range(6 * BATCH):
            change = 0.5 * (s[TANH + k] - s[ROOT + k])
            s[ROOT + k] += change
            s[OTHER + k] = 0.5 * (s[OTHER + k] + s[INVERSE + k])
            moved = max(moved, abs(change) / (1.0 + abs(s[ROOT + k])))
        if not moved > 1e-9:  # the next error is its square
            break


@kernel
def logarithmic_strain(s):  # type: ignore[no-untyped-def]
    """Deviator of the logarithmic strain and its square, from the trial b."""
    # Z of b, or of a root of b that is close enough to I
    for k in range(6 * BATCH):
        s[ROOT + k] = s[TRIAL + k]
    scale, far = 1.0, 1.0
    for _ in range(ROOTS):
        _invert(s, ROOT, 1.0, TANH)
        for k in range(6 * BATCH):
            s[TANH + k] = (1.0 if k < 3 * BATCH else 0.0) - 2.0 * s[TANH + k]
        _square(s, TANH)
        far = 0.0
        for v in range(BATCH):
            x, y, z = s[TANH + v], s[TANH + BATCH + v], s[TANH + 2 * BATCH + v]
            xy, yz = s[TANH + 3 * BATCH + v], s[TANH + 4 * BATCH + v]
            xz = s[TANH + 5 * BATCH + v]
            size = x * x + y * y + z * z + 2.0 * (xy * xy + yz * yz + xz * xz)
            far += 1.0 if size > NEAR else 0.0
        if far == 0.0:
            break
        _take_root(s)
        scale *= 2.0
    if far > 0.0:  # rounding has made b indefinite: no strain
        scale = math.nan
    for k in range(3 * BATCH):
        s[FACTOR + k] = 0.0
    for term in range(TERMS, 0, -1):  # by Horner's scheme, times Z^2 plus the next number
        number = scale / (2.0 * term - 1.0)
        for v in range(BATCH):
            first, second = s[TANH + 12 * BATCH + v], s[TANH + 13 * BATCH + v]
            third = s[TANH + 14 * BATCH + v]
            a, b, c = s[FACTOR + v], s[FACTOR + BATCH + v], s[FACTOR + 2 * BATCH + v]
            b += first * c
            s[FACTOR + v], s[FACTOR + BATCH + v] = third * b + number, third * c - second * b
            s[FACTOR + 2 * BATCH + v] = a + first * b - second * c
    for v in range(BATCH):  # times Z, without the trace
        first, second = s[TANH + 12 * BATCH + v], s[TANH + 13 * BATCH + v]
        c = s[FACTOR + 2 * BATCH + v]
        a, b = s[FACTOR + v] - second * c, s[FACTOR + BATCH + v] + first * c
        s[FACTOR + v] = -(a * first + b * (first * first - 2.0 * second)) / 3.0
        s[FACTOR + BATCH + v], s[FACTOR + 2 * BATCH + v] = a, b
    combine(s, TANH, STRAIN)
    _square(s, STRAIN)
