r"""Tangent stiffness of the hexahedra of a batch, in single precision.

A trilinear field is a sum of modes :math:`\xi_x^{m_x} \xi_y^{m_y} \xi_z^{m_z}`,
:math:`m \in \{0, 1\}^3`, with amplitudes by a Walsh transform of the corner values; sums over the
Gauss points :math:`\pm g` are Walsh transforms as well. For tangents :math:`A_{kl}` between the
derivatives of two components,

.. math::
    K^{kl}_{mn} = g^{|m| + |n| - 2} \sum_{i \in m} \sum_{j \in n}
        \hat A^{kl}_{ij}\bigl((m - i) \oplus (n - j)\bigr), \qquad
    \hat A_{ij}(w) = \tfrac12 s_i s_j \sum_q (-1)^{w \cdot q} A_{ij}(q),    \tag{1}

where :math:`i \in m` are the directions in which the mode is linear and :math:`s` the scales
:math:`(1/\Delta x, 1/\Delta y, 1)`. The upper triangles without the translation :math:`m = 0` have
231 numbers.
"""

import numpy as np

from multiscale.micro.elastic.stiffness import BATCH
from multiscale.micro.finite.strain import inlined, kernel
from multiscale.numerics.compiled import compiled

MOTIONS = 21  # modes 1 to 7, component by component
ENTRIES = 3 * 28 + 3 * 49
POINT_ROWS = 6 * 9  # rows of the tangent of a Gauss point, with all entries of each block
FIRST, SECOND = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)  # components of the blocks
HALF = np.float32(0.5)
STEP = 3 * BATCH  # the rows of three blocks alternate


def _terms() -> tuple[np.ndarray, np.ndarray]:
    """Places of K and of the transformed A, directions, and factors of the terms of (1)."""
    places, factors, entry = [], [], 0
    for first in (0, 27):  # rows of a point: three blocks with k = l, three with k < l
        for m, n in np.ndindex(8, 8):
            if m == 0 or n < (1 if first else m):
                continue
            for i, j in np.ndindex(3, 3):
                x, y = 4 >> i, 4 >> j  # bits of the directions
                if m & x and n & y:
                    w = (m - x) ^ (n - y)
                    row = POINT_ROWS * w + first + 3 * (3 * i + j)
                    places.append((3 * BATCH * entry, BATCH * row, i, j))
                    factors.append(3.0 ** (1.0 - 0.5 * (m.bit_count() + n.bit_count())))
            entry += 1
    return np.array(places, np.uint32), np.array(factors, np.float32)


PLACES, FACTORS = _terms()


@compiled(inline="always", fastmath=True)  # strides become constants
def walsh(rows, start, stride, scale):  # type: ignore[no-untyped-def]
    """Transform eight rows at a distance, sorted by x, y and z, in place, and scale them."""
    for v in range(start, start + BATCH):
        a, b = rows[v], rows[stride + v]
        c, d = rows[2 * stride + v], rows[3 * stride + v]
        e, f = rows[4 * stride + v], rows[5 * stride + v]
        g, h = rows[6 * stride + v], rows[7 * stride + v]
        a, b, c, d, e, f, g, h = a + b, a - b, c + d, c - d, e + f, e - f, g + h, g - h
        a, b, c, d, e, f, g, h = a + c, b + d, a - c, b - d, e + g, f + h, e - g, f - h
        rows[v], rows[stride + v] = scale * (a + e), scale * (b + f)
        rows[2 * stride + v], rows[3 * stride + v] = scale * (c + g), scale * (d + h)
        rows[4 * stride + v], rows[5 * stride + v] = scale * (a - e), scale * (b - f)
        rows[6 * stride + v], rows[7 * stride + v] = scale * (c - g), scale * (d - h)


@kernel
def add_matrix(points, sums, dx, dy, matrix):  # type: ignore[no-untyped-def]
    """Write (1) from the tangents of the Gauss points, 54 rows each; ``sums`` is scratch memory."""
    scales = (np.float32(1.0 / dx), np.float32(1.0 / dy), np.float32(1.0))
    for row in range(POINT_ROWS):
        walsh(points, row * BATCH, POINT_ROWS * BATCH, HALF)
    sums[:] = 0.0
    for k in range(len(FACTORS)):
        to, place = PLACES[k, 0], PLACES[k, 1]
        factor = FACTORS[k] * scales[PLACES[k, 2]] * scales[PLACES[k, 3]]
        for v in range(STEP):
            sums[to + v] += factor * points[place + v]
    _sort(sums, matrix, 0, 28)
    _sort(sums, matrix, 84, 49)


@compiled(inline="always", fastmath=True)
def _sort(sums, matrix, first, entries):  # type: ignore[no-untyped-def]
    """Copy the entries of three blocks block by block, in the order of the product."""
    for block in range(3):
        for entry in range(entries):
            to, place = first + block * entries + entry, first + 3 * entry + block
            for v in range(BATCH):
                matrix[to * BATCH + v] = sums[place * BATCH + v]


@inlined
def multiply(t, x, y):  # type: ignore[no-untyped-def]
    """Multiply motions ``x``, 21 rows, by the stiffness ``t`` and write the forces ``y``."""
    for k in range(3):
        _multiply_triangle(t[28 * k * BATCH :], x[7 * k * BATCH :], y[7 * k * BATCH :])
    for block in range(3, 6):
        k, m = 7 * FIRST[block] * BATCH, 7 * SECOND[block] * BATCH
        entries = t[(84 + 49 * (block - 3)) * BATCH :]
        _multiply_block(entries, 7, 1, x[m:], y[k:])
        _multiply_block(entries, 1, 7, x[k:], y[m:])


@compiled(inline="always", fastmath={"contract", "reassoc", "nsz", "arcp"})  # constant strides
def _multiply_block(t, row, column, x, y):  # type: ignore[no-untyped-def]
    """Add a 7 x 7 block times seven rows, written out: five times as fast as tables of places."""
    for r in range(7):
        a, out = row * r * BATCH, r * BATCH
        for v in range(BATCH):
            y[out + v] += (
                t[a + v] * x[v]
                + t[a + column * BATCH + v] * x[BATCH + v]
                + t[a + 2 * column * BATCH + v] * x[2 * BATCH + v]
                + t[a + 3 * column * BATCH + v] * x[3 * BATCH + v]
                + t[a + 4 * column * BATCH + v] * x[4 * BATCH + v]
                + t[a + 5 * column * BATCH + v] * x[5 * BATCH + v]
                + t[a + 6 * column * BATCH + v] * x[6 * BATCH + v]
            )


@inlined
def _multiply_triangle(t, x, y):  # type: ignore[no-untyped-def]
    """Write a symmetric 7 x 7 block, upper triangle row by row, times seven rows."""
    for v in range(BATCH):
        a, b, c, d = x[v], x[BATCH + v], x[2 * BATCH + v], x[3 * BATCH + v]
        e, g, h = x[4 * BATCH + v], x[5 * BATCH + v], x[6 * BATCH + v]
        y[v] = (
            t[v] * a + t[BATCH + v] * b + t[2 * BATCH + v] * c + t[3 * BATCH + v] * d
            + t[4 * BATCH + v] * e + t[5 * BATCH + v] * g + t[6 * BATCH + v] * h
        )  # fmt: skip
        y[BATCH + v] = (
            t[BATCH + v] * a + t[7 * BATCH + v] * b + t[8 * BATCH + v] * c + t[9 * BATCH + v] * d
            + t[10 * BATCH + v] * e + t[11 * BATCH + v] * g + t[12 * BATCH + v] * h
        )  # fmt: skip
        y[2 * BATCH + v] = (
            t[2 * BATCH + v] * a + t[8 * BATCH + v] * b + t[13 * BATCH + v] * c
            + t[14 * BATCH + v] * d + t[15 * BATCH + v] * e + t[16 * BATCH + v] * g
            + t[17 * BATCH + v] * h
        )  # fmt: skip
        y[3 * BATCH + v] = (
            t[3 * BATCH + v] * a + t[9 * BATCH + v] * b + t[14 * BATCH + v] * c
            + t[18 * BATCH + v] * d + t[19 * BATCH + v] * e + t[20 * BATCH + v] * g
            + t[21 * BATCH + v] * h
        )  # fmt: skip
        y[4 * BATCH + v] = (
            t[4 * BATCH + v] * a + t[10 * BATCH + v] * b + t[15 * BATCH + v] * c
            + t[19 * BATCH + v] * d + t[22 * BATCH + v] * e + t[23 * BATCH + v] * g
            + t[24 * BATCH + v] * h
        )  # fmt: skip
        y[5 * BATCH + v] = (
            t[5 * BATCH + v] * a + t[11 * BATCH + v] * b + t[16 * BATCH + v] * c
            + t[20 * BATCH + v] * d + t[23 * BATCH + v] * e + t[25 * BATCH + v] * g
            + t[26 * BATCH + v] * h
        )  # fmt: skip
        y[6 * BATCH + v] = (
            t[6 * BATCH + v] * a + t[12 * BATCH + v] * b + t[17 * BATCH + v] * c
            + t[21 * BATCH + v] * d + t[24 * BATCH + v] * e + t[26 * BATCH + v] * g
            + t[27 * BATCH + v] * h
        )  # fmt: skip
