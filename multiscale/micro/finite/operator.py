r"""Internal forces of the layered cell at large strain, and its tangent, matrix-free.

Displacements and forces are arrays of shape ``(nx, layers, 3, ny)``. The tangent is kept in single
precision: for each Gauss point the 45 numbers of a symmetric matrix between the parent derivatives
of the displacement, and for each element the vector that couples its points through the mean
dilatation. One kernel applies it whatever the law.
"""

import math

import numba
import numpy as np

from multiscale.micro.finite.batch import (
    COFACTOR,
    DET,
    EDGES,
    FLUX,
    LOG,
    MEAN,
    NODES,
    PULLED,
    SCRATCH,
    VOLUME,
    WEIGHT,
    edge_derivatives,
    edge_forces,
    kernel,
    point_rows,
    pull_back,
    strain_batch,
)
from multiscale.micro.finite.neo_hookean import neo_hookean
from multiscale.micro.finite.plastic import plastic, plastic_state
from multiscale.micro.hexahedron import BATCH, gather, scatter

__all__ = [
    "NEO_HOOKEAN",
    "PLASTIC",
    "TANGENT_ROWS",
    "apply_tangent",
    "inverse_strain",
    "respond_cell",
    "update_state",
]

NEO_HOOKEAN, PLASTIC = 0, 1
TANGENT_ROWS = 8 * 45 + 24
COUPLING = 8 * 45
LEAST_DILATATION = 1e-3

parallel_kernel = numba.njit(
    parallel=True,
    cache=True,
    fastmath={"contract", "reassoc", "nsz", "arcp"},
    error_model="numpy",
)


@kernel
def _volume(s, q, modulus, mean_dilatation):  # type: ignore[no-untyped-def]
    """Volumetric Kirchhoff stress of U = modulus / 2 ln^2 J, and its derivative by ln J."""
    j = DET + q * BATCH
    if mean_dilatation:
        for v in range(BATCH):
            s[LOG + v] = modulus * math.log(s[MEAN + v]) / s[MEAN + v] * s[j + v]
            s[LOG + BATCH + v] = s[LOG + v]
    else:
        for v in range(BATCH):
            s[LOG + v], s[LOG + BATCH + v] = modulus * math.log(s[j + v]), modulus


@kernel
def _couple(s, modulus, dx, dy, tangent):  # type: ignore[no-untyped-def]
    """Write the vector whose square is the stiffness against a change of the mean dilatation.

    Where the element has grown by more than e the stiffness would be negative and is left out.
    """
    for k in range(36 * BATCH):
        s[FLUX + k] = 0.0
    for q in range(8):
        pull_back(s, q)
        rx, ry, rz, _ = point_rows(q)
        for k in range(3):
            for a in range(3):
                row = (rx, ry, rz)[a] + FLUX + 12 * k * BATCH
                g = PULLED + (3 * k + a) * BATCH
                for v in range(BATCH):
                    weight = s[WEIGHT + q * BATCH + v] * s[DET + q * BATCH + v]
                    s[row + v] += weight * s[g + v]
    edge_forces(s, dx, dy)
    for v in range(BATCH):
        curvature = max(modulus * (1.0 - math.log(s[MEAN + v])), 0.0) / s[VOLUME + v]
        s[LOG + v] = math.sqrt(curvature) / s[MEAN + v]
    for row in range(24):
        for v in range(BATCH):
            tangent[(COUPLING + row) * BATCH + v] = s[LOG + v] * s[NODES + row * BATCH + v]


@parallel_kernel
def respond_cell(  # type: ignore[no-untyped-def]
    heights,
    planes,
    factor,
    dx,
    dy,
    law,
    moduli,
    mean_dilatation,
    u,
    state,
    wants_tangent,
    out,
    tangent,
    least,
):
    """Compute the forces, with the tangent if asked for.

    ``moduli`` are the shear modulus, the modulus of the volume and four numbers of the hardening.
    ``state`` is what a law keeps (rows of a batch: J2), or the frozen stress of viscous branches.
    ``least`` gets the smallest det F of each strip of elements, and the number of flowing points.
    Elements that are nearly inverted answer nothing.
    """
    nx, layers, _, ny = u.shape
    batches = (ny + BATCH - 1) // BATCH
    shear, volume = moduli[0], moduli[1]
    has = state.shape[5] > 1
    for colour in range(2):
        for pair in numba.prange((nx + 1 - colour) // 2):
            i = 2 * pair + colour
            sides = (i, (i + 1) % nx)
            s = np.zeros(SCRATCH)
            smallest, flowing = 1e300, 0
            for batch in range(batches):
                start = batch * BATCH
                lanes = min(BATCH, ny - start)
                for layer in range(layers):
                    determinant = strain_batch(
                        heights, planes, factor, dx, dy, u, sides, layer, start, lanes, s
                    )
                    smallest = min(smallest, determinant)
                    if not determinant > LEAST_DILATATION:
                        smallest = -1.0
                        continue
                    rows = tangent[i, layer, batch] if wants_tangent else tangent[0, 0, 0]
                    kept = state[i, layer, batch] if has else state[0, 0, 0]
                    for k in range(36 * BATCH):
                        s[FLUX + k] = 0.0
                    for q in range(8):
                        pull_back(s, q)
                        _volume(s, q, volume, mean_dilatation)
                        points = rows[45 * q * BATCH :]
                        if law == NEO_HOOKEAN:
                            neo_hookean(s, q, shear, kept[q], has, points, wants_tangent)
                        else:
                            flowing += plastic(
                                s, q, shear, moduli[2:], kept[q], points, wants_tangent, lanes
                            )
                    edge_forces(s, dx, dy)
                    scatter(s[NODES:], sides, layer, start, lanes, out)
                    if wants_tangent and mean_dilatation:
                        _couple(s, volume, dx, dy, rows)
            least[i, 0], least[i, 1] = smallest, flowing


@parallel_kernel
def update_state(heights, planes, factor, dx, dy, moduli, u, state, new):  # type: ignore[no-untyped-def]
    """Write the state of J2 plasticity at the end of a step."""
    nx, layers, _, ny = u.shape
    batches = (ny + BATCH - 1) // BATCH
    for strip in numba.prange(nx):
        i = np.int64(strip)
        sides = (i, (i + 1) % nx)
        s = np.zeros(SCRATCH)
        for batch in range(batches):
            start = batch * BATCH
            lanes = min(BATCH, ny - start)
            for layer in range(layers):
                strain_batch(heights, planes, factor, dx, dy, u, sides, layer, start, lanes, s)
                for q in range(8):
                    pull_back(s, q)
                    for v in range(2 * BATCH):
                        s[LOG + v] = 0.0
                    old = state[i, layer, batch, q]
                    plastic_state(s, q, moduli[0], moduli[2:], old, new[i, layer, batch, q])


@parallel_kernel
def inverse_strain(heights, planes, factor, dx, dy, u, out):  # type: ignore[no-untyped-def]
    """Write I - C^-1 at every Gauss point, rows 11, 22, 33, 12, 23, 13."""
    nx, layers, _, ny = u.shape
    batches = (ny + BATCH - 1) // BATCH
    for strip in numba.prange(nx):
        i = np.int64(strip)
        sides = (i, (i + 1) % nx)
        s = np.zeros(SCRATCH)
        for batch in range(batches):
            start = batch * BATCH
            lanes = min(BATCH, ny - start)
            for layer in range(layers):
                strain_batch(heights, planes, factor, dx, dy, u, sides, layer, start, lanes, s)
                for q in range(8):
                    pull_back(s, q)
                    for row in range(6):
                        a = row % 3 if row < 5 else 0
                        b = a if row < 3 else (a + 1 if row < 5 else 2)
                        one = 1.0 if row < 3 else 0.0
                        for v in range(BATCH):
                            value = s[COFACTOR + a * BATCH + v] * s[COFACTOR + b * BATCH + v]
                            for k in range(1, 3):
                                x = COFACTOR + (3 * k + a) * BATCH + v
                                y = COFACTOR + (3 * k + b) * BATCH + v
                                value += s[x] * s[y]
                            out[i, layer, batch, q, row, v] = one - value


@parallel_kernel
def apply_tangent(tangent, dx, dy, mean_dilatation, u, out):  # type: ignore[no-untyped-def]
    """Tangent times a displacement."""
    nx, layers, _, ny = u.shape
    batches = (ny + BATCH - 1) // BATCH
    out[:] = 0.0
    for colour in range(2):
        for pair in numba.prange((nx + 1 - colour) // 2):
            i = 2 * pair + colour
            sides = (i, (i + 1) % nx)
            s, w = np.zeros(SCRATCH), np.empty(18 * BATCH, np.float32)
            for batch in range(batches):
                start = batch * BATCH
                lanes = min(BATCH, ny - start)
                for layer in range(layers):
                    rows = tangent[i, layer, batch]
                    gather(u, sides, layer, start, lanes, s[NODES:])
                    edge_derivatives(s, dx, dy)
                    for v in range(BATCH):
                        s[MEAN + v] = 0.0
                    if mean_dilatation:
                        for row in range(24):
                            for v in range(BATCH):
                                coupled = rows[(COUPLING + row) * BATCH + v]
                                s[MEAN + v] += coupled * s[NODES + row * BATCH + v]
                    for k in range(36 * BATCH):
                        s[FLUX + k] = 0.0
                    for q in range(8):
                        _multiply(s, q, rows[45 * q * BATCH :], w)
                    edge_forces(s, dx, dy)
                    if mean_dilatation:
                        for row in range(24):
                            for v in range(BATCH):
                                coupled = rows[(COUPLING + row) * BATCH + v]
                                s[NODES + row * BATCH + v] += coupled * s[MEAN + v]
                    scatter(s[NODES:], sides, layer, start, lanes, out)


@kernel
def _multiply(s, q, t, w):  # type: ignore[no-untyped-def]
    """Symmetric 9 x 9 matrix, upper triangle row by row, times the derivatives of one point.

    In single precision, like the matrix. ``w`` has 9 rows for the derivatives and 9 for the result.
    """
    rx, ry, rz, _ = point_rows(q)
    for row in range(9):
        x = EDGES + 12 * (row // 3) * BATCH + (rx, ry, rz)[row % 3]
        for v in range(BATCH):
            w[row * BATCH + v] = s[x + v]
    for v in range(BATCH):
        a, b, c = w[v], w[BATCH + v], w[2 * BATCH + v]
        d, e, g = w[3 * BATCH + v], w[4 * BATCH + v], w[5 * BATCH + v]
        h, m, n = w[6 * BATCH + v], w[7 * BATCH + v], w[8 * BATCH + v]
        w[9 * BATCH + v] = (
            t[v] * a + t[BATCH + v] * b + t[2 * BATCH + v] * c
            + t[3 * BATCH + v] * d + t[4 * BATCH + v] * e + t[5 * BATCH + v] * g
            + t[6 * BATCH + v] * h + t[7 * BATCH + v] * m + t[8 * BATCH + v] * n
        )  # fmt: skip
        w[10 * BATCH + v] = (
            t[BATCH + v] * a + t[9 * BATCH + v] * b + t[10 * BATCH + v] * c
            + t[11 * BATCH + v] * d + t[12 * BATCH + v] * e + t[13 * BATCH + v] * g
            + t[14 * BATCH + v] * h + t[15 * BATCH + v] * m + t[16 * BATCH + v] * n
        )  # fmt: skip
        w[11 * BATCH + v] = (
            t[2 * BATCH + v] * a + t[10 * BATCH + v] * b + t[17 * BATCH + v] * c
            + t[18 * BATCH + v] * d + t[19 * BATCH + v] * e + t[20 * BATCH + v] * g
            + t[21 * BATCH + v] * h + t[22 * BATCH + v] * m + t[23 * BATCH + v] * n
        )  # fmt: skip
        w[12 * BATCH + v] = (
            t[3 * BATCH + v] * a + t[11 * BATCH + v] * b + t[18 * BATCH + v] * c
            + t[24 * BATCH + v] * d + t[25 * BATCH + v] * e + t[26 * BATCH + v] * g
            + t[27 * BATCH + v] * h + t[28 * BATCH + v] * m + t[29 * BATCH + v] * n
        )  # fmt: skip
        w[13 * BATCH + v] = (
            t[4 * BATCH + v] * a + t[12 * BATCH + v] * b + t[19 * BATCH + v] * c
            + t[25 * BATCH + v] * d + t[30 * BATCH + v] * e + t[31 * BATCH + v] * g
            + t[32 * BATCH + v] * h + t[33 * BATCH + v] * m + t[34 * BATCH + v] * n
        )  # fmt: skip
        w[14 * BATCH + v] = (
            t[5 * BATCH + v] * a + t[13 * BATCH + v] * b + t[20 * BATCH + v] * c
            + t[26 * BATCH + v] * d + t[31 * BATCH + v] * e + t[35 * BATCH + v] * g
            + t[36 * BATCH + v] * h + t[37 * BATCH + v] * m + t[38 * BATCH + v] * n
        )  # fmt: skip
        w[15 * BATCH + v] = (
            t[6 * BATCH + v] * a + t[14 * BATCH + v] * b + t[21 * BATCH + v] * c
            + t[27 * BATCH + v] * d + t[32 * BATCH + v] * e + t[36 * BATCH + v] * g
            + t[39 * BATCH + v] * h + t[40 * BATCH + v] * m + t[41 * BATCH + v] * n
        )  # fmt: skip
        w[16 * BATCH + v] = (
            t[7 * BATCH + v] * a + t[15 * BATCH + v] * b + t[22 * BATCH + v] * c
            + t[28 * BATCH + v] * d + t[33 * BATCH + v] * e + t[37 * BATCH + v] * g
            + t[40 * BATCH + v] * h + t[42 * BATCH + v] * m + t[43 * BATCH + v] * n
        )  # fmt: skip
        w[17 * BATCH + v] = (
            t[8 * BATCH + v] * a + t[16 * BATCH + v] * b + t[23 * BATCH + v] * c
            + t[29 * BATCH + v] * d + t[34 * BATCH + v] * e + t[38 * BATCH + v] * g
            + t[41 * BATCH + v] * h + t[43 * BATCH + v] * m + t[44 * BATCH + v] * n
        )  # fmt: skip
    for row in range(9):
        y = FLUX + 12 * (row // 3) * BATCH + (rx, ry, rz)[row % 3]
        for v in range(BATCH):
            s[y + v] += w[(9 + row) * BATCH + v]
