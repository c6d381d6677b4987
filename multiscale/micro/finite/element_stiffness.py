r"""Tangent stiffness of the hexahedra of a batch, in single precision.

A translation causes no force. So the stiffness is stored for the motions of the corners 1 to 7
relative to corner 0: per pair of components :math:`k \le l` the 7 x 7 block

.. math::
    K_{kl} = \sum_q B_q^t A^q_{kl} B_q,    \tag{1}

with the tangents :math:`A^q` between the parent derivatives at the Gauss points and the derivatives
:math:`B_q` of the shape functions. Only the upper triangle of a block with :math:`k = l` is stored:
231 numbers in all. With relative motions, the rounding of single precision does not affect rigid
translations.
"""

import numpy as np

from multiscale.micro.finite.batch import kernel
from multiscale.micro.hexahedron import BATCH, FAR, NEAR

__all__ = [
    "ENTRIES",
    "FIRST",
    "MOTIONS",
    "POINT_ROWS",
    "SECOND",
    "add_points",
    "corner_gradients",
    "multiply",
]

MOTIONS = 21  # of the corners 1 to 7, component by component
ENTRIES = 3 * 28 + 3 * 49
POINT_ROWS = 6 * 9  # of the tangent of a Gauss point: all of each block
FIRST, SECOND = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)  # components of the blocks


def corner_gradients(dx: float, dy: float) -> np.ndarray:
    """Parent derivatives of the shape functions of the corners 1 to 7, shape (8, 3, 7).

    They are sorted by Gauss point, direction and corner: by x and y in 1/m, from the spacing in m,
    and by zeta dimensionless.
    """
    value = np.array([[NEAR, FAR], [FAR, NEAR]])  # corner, point
    slope = np.array([[-1.0, -1.0], [1.0, 1.0]])
    gradients = np.empty((2, 2, 2, 3, 2, 2, 2))  # point, direction, corner
    for direction, scale in enumerate((1.0 / dx, 1.0 / dy, 1.0)):
        factors = [slope if k == direction else value for k in range(3)]
        gradients[:, :, :, direction] = scale * np.einsum("aA,bB,cC->ABCabc", *factors)
    return gradients.reshape(8, 3, 8)[:, :, 1:].astype(np.float32)


@kernel
def add_points(points, gradients, half, matrix):  # type: ignore[no-untyped-def]
    """Add four Gauss points to (1).

    ``points`` contains their tangents, 9 rows for each of the six blocks, ``gradients`` the
    derivatives, shape (4, 3, 7), and ``half`` is scratch of 84 rows.
    """
    start = 0
    for block in range(6):
        for q in range(4):
            _contract(points[(6 * q + block) * 9 * BATCH :], gradients[q], half[21 * q * BATCH :])
        _add_block(gradients, half, matrix[start:], block < 3)
        start += (28 if block < 3 else 49) * BATCH


@kernel
def _contract(a, gradient, half):  # type: ignore[no-untyped-def]
    """Write A B of one block."""
    for n in range(7):
        x, y, z = gradient[0, n], gradient[1, n], gradient[2, n]
        out = half[n * BATCH :]
        for v in range(BATCH):
            out[v] = a[v] * x + a[BATCH + v] * y + a[2 * BATCH + v] * z
            out[7 * BATCH + v] = a[3 * BATCH + v] * x + a[4 * BATCH + v] * y + a[5 * BATCH + v] * z
            out[14 * BATCH + v] = a[6 * BATCH + v] * x + a[7 * BATCH + v] * y + a[8 * BATCH + v] * z


@kernel
def _add_block(b, half, matrix, triangle):  # type: ignore[no-untyped-def]
    """Add B^t A B of one block, summed over four points."""
    entry = 0
    for m in range(7):  # a row of the block at once: its entries, and A B, follow each other
        first = m * BATCH if triangle else 0
        size, out = 7 * BATCH - first, matrix[entry:]
        g, h, i, j = (
            half[first:],
            half[21 * BATCH + first :],
            half[42 * BATCH + first :],
            half[63 * BATCH + first :],
        )
        for v in range(size):
            out[v] += (
                b[0, 0, m] * g[v]
                + b[0, 1, m] * g[7 * BATCH + v]
                + b[0, 2, m] * g[14 * BATCH + v]
                + b[1, 0, m] * h[v]
                + b[1, 1, m] * h[7 * BATCH + v]
                + b[1, 2, m] * h[14 * BATCH + v]
                + b[2, 0, m] * i[v]
                + b[2, 1, m] * i[7 * BATCH + v]
                + b[2, 2, m] * i[14 * BATCH + v]
                + b[3, 0, m] * j[v]
                + b[3, 1, m] * j[7 * BATCH + v]
                + b[3, 2, m] * j[14 * BATCH + v]
            )
        entry += size


@kernel
def multiply(t, x, y):  # type: ignore[no-untyped-def]
    """Multiply motions ``x``, 21 rows, by the stiffness ``t`` and write the forces ``y``."""
    for k in range(3):
        _multiply_triangle(t[28 * k * BATCH :], x[7 * k * BATCH :], y[7 * k * BATCH :])
    for block in range(3, 6):
        k, m = 7 * FIRST[block] * BATCH, 7 * SECOND[block] * BATCH
        entries = t[(84 + 49 * (block - 3)) * BATCH :]
        _multiply_block(entries, x[m:], y[k:])
        _multiply_transposed(entries, x[k:], y[m:])


@kernel
def _multiply_block(t, x, y):  # type: ignore[no-untyped-def]
    """Add a 7 x 7 block times seven rows."""
    for r in range(7):
        a, out = 7 * r * BATCH, r * BATCH
        for v in range(BATCH):
            y[out + v] += (
                t[a + v] * x[v]
                + t[a + BATCH + v] * x[BATCH + v]
                + t[a + 2 * BATCH + v] * x[2 * BATCH + v]
                + t[a + 3 * BATCH + v] * x[3 * BATCH + v]
                + t[a + 4 * BATCH + v] * x[4 * BATCH + v]
                + t[a + 5 * BATCH + v] * x[5 * BATCH + v]
                + t[a + 6 * BATCH + v] * x[6 * BATCH + v]
            )


@kernel
def _multiply_transposed(t, x, y):  # type: ignore[no-untyped-def]
    """Add the transpose of a 7 x 7 block times seven rows.

    The sum is written out so that the strides of all reads are constants for the compiler.
    """
    for r in range(7):
        a, out = r * BATCH, r * BATCH
        for v in range(BATCH):
            y[out + v] += (
                t[a + v] * x[v]
                + t[a + 7 * BATCH + v] * x[BATCH + v]
                + t[a + 14 * BATCH + v] * x[2 * BATCH + v]
                + t[a + 21 * BATCH + v] * x[3 * BATCH + v]
                + t[a + 28 * BATCH + v] * x[4 * BATCH + v]
                + t[a + 35 * BATCH + v] * x[5 * BATCH + v]
                + t[a + 42 * BATCH + v] * x[6 * BATCH + v]
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
