r"""Deviator of the logarithmic strain for a batch, without a spectral decomposition.

With the trial :math:`b = F C_p^{-1} F^t`,

.. math::
    \tfrac12 \ln b = \operatorname{artanh} Z, \qquad Z = I - 2 (b + I)^{-1},    \tag{1}

by its series in :math:`Z`. Where :math:`Z` is too large for it, :math:`b` is replaced by its root,
whose logarithm is half as large.
"""

import math

from multiscale.micro.elastic.hexahedron import BATCH
from multiscale.micro.finite.batch import DEFORMED, METRIC, kernel, part
from multiscale.numerics.compiled import compiled

__all__ = [
    "FACTOR",
    "FC",
    "LAST",
    "STRAIN",
    "SYMMETRIC",
    "TANH",
    "combine",
    "logarithmic_strain",
    "trial_strain",
    "turn_vectors",
]

# symmetric tensors have the rows 11, 22, 33, 12, 23, 13
FC = METRIC  # 9: F C_p^-1
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
ROOTS = 20  # enough for any b whose eigenvalues double precision tells apart


@part
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


@part
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


@part
def combine(s, tensor, out):  # type: ignore[no-untyped-def]
    """Write the polynomial of a symmetric tensor with its FACTOR; the square has its rows."""
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
    """Square root of ROOT by the iteration of Denman and Beavers, which converges for any b."""
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
