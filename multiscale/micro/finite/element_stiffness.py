r"""Tangent stiffness of the hexahedra of a batch, in single precision.

A translation makes no force. So the stiffness is kept between the motions of the corners 1 to 7
relative to corner 0: per pair of components :math:`k \le l` the 7 x 7 block

.. math::
    K_{kl} = \sum_q B_q^t A^q_{kl} B_q + c_k c_l^t,    \tag{1}

with the tangents :math:`A^q` between the parent derivatives at the Gauss points, the derivatives
:math:`B_q` of the shape functions, and the vector :math:`c` that couples the points through the
mean dilatation. Of a block with :math:`k = l` the upper triangle is kept: 231 numbers in all.
Relative motions also keep the rounding of single precision away from rigid translations.
"""

import numpy as np

from multiscale.micro.finite.batch import kernel
from multiscale.micro.hexahedron import BATCH, FAR, NEAR

__all__ = ["ENTRIES", "MOTIONS", "add_coupling", "add_point", "corner_gradients", "multiply"]

MOTIONS = 21  # of the corners 1 to 7, component by component
ENTRIES = 3 * 28 + 3 * 49
FIRST, SECOND = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)  # components of the blocks


def corner_gradients(dx: float, dy: float) -> np.ndarray:
    """Parent derivatives of the shape functions of the corners 1 to 7.

    Parameters
    ----------
    dx, dy : float
        Spacing, m.

    Returns
    -------
    ndarray, shape (8, 3, 7)
        By Gauss point, direction and corner; 1/m, by zeta 1.
    """
    value = np.array([[NEAR, FAR], [FAR, NEAR]])  # corner, point
    slope = np.array([[-1.0, -1.0], [1.0, 1.0]])
    gradients = np.empty((2, 2, 2, 3, 2, 2, 2))  # point, direction, corner
    for direction, scale in enumerate((1.0 / dx, 1.0 / dy, 1.0)):
        factors = [slope if k == direction else value for k in range(3)]
        gradients[:, :, :, direction] = scale * np.einsum("aA,bB,cC->ABCabc", *factors)
    return gradients.reshape(8, 3, 8)[:, :, 1:].astype(np.float32)


@kernel
def add_point(points, gradient, half, matrix):  # type: ignore[no-untyped-def]
    """Add one Gauss point to (1).

    ``points`` has its 45 rows of A, ``gradient`` the derivatives (3, 7), ``half`` room for 21 rows.
    """
    block = 0
    for pair in range(6):
        k, m = 3 * FIRST[pair], 3 * SECOND[pair]
        for a in range(3):
            r = k + a
            x, y, z = _place(r, m), _place(r, m + 1), _place(r, m + 2)
            for n in range(7):
                bx, by, bz = gradient[0, n], gradient[1, n], gradient[2, n]
                out = (7 * a + n) * BATCH
                for v in range(BATCH):
                    half[out + v] = bx * points[x + v] + by * points[y + v] + bz * points[z + v]
        for row in range(7):
            bx, by, bz = gradient[0, row], gradient[1, row], gradient[2, row]
            for n in range(row if k == m else 0, 7):
                x = n * BATCH
                for v in range(BATCH):
                    matrix[block + v] += (
                        bx * half[x + v]
                        + by * half[x + 7 * BATCH + v]
                        + bz * half[x + 14 * BATCH + v]
                    )
                block += BATCH


@kernel
def _place(r, c):  # type: ignore[no-untyped-def]
    """Offset of an entry in the upper triangle of a symmetric 9 x 9 matrix, row by row."""
    i, j = min(r, c), max(r, c)
    return (9 * i - i * (i - 1) // 2 + j - i) * BATCH


@kernel
def add_coupling(c, matrix):  # type: ignore[no-untyped-def]
    """Add the product of a vector with itself to (1)."""
    block = 0
    for pair in range(6):
        k, m = 7 * FIRST[pair], 7 * SECOND[pair]
        for row in range(7):
            x = (k + row) * BATCH
            for n in range(row if k == m else 0, 7):
                y = (m + n) * BATCH
                for v in range(BATCH):
                    matrix[block + v] += c[x + v] * c[y + v]
                block += BATCH


@kernel
def multiply(t, x, y):  # type: ignore[no-untyped-def]
    """Write the forces ``y`` of relative motions ``x``, both 21 rows."""
    for k in range(3):
        _multiply_triangle(t[28 * k * BATCH :], x[7 * k * BATCH :], y[7 * k * BATCH :])
    for pair in range(3, 6):
        k, m = 7 * FIRST[pair] * BATCH, 7 * SECOND[pair] * BATCH
        block = t[(84 + 49 * (pair - 3)) * BATCH :]
        _multiply_block(block, x[m:], y[k:], 7 * BATCH, BATCH)
        _multiply_block(block, x[k:], y[m:], BATCH, 7 * BATCH)


@kernel
def _multiply_block(t, x, y, row, column):  # type: ignore[no-untyped-def]
    """Add a 7 x 7 block times seven rows."""
    for r in range(7):
        out, s = r * BATCH, t[r * row :]
        for v in range(BATCH):
            y[out + v] += (
                s[v] * x[v]
                + s[column + v] * x[BATCH + v]
                + s[2 * column + v] * x[2 * BATCH + v]
                + s[3 * column + v] * x[3 * BATCH + v]
                + s[4 * column + v] * x[4 * BATCH + v]
                + s[5 * column + v] * x[5 * BATCH + v]
                + s[6 * column + v] * x[6 * BATCH + v]
            )


@kernel
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
