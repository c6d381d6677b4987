r"""J2 plasticity in logarithmic strain for a batch: return map, tangent, new state.

For the equations see :class:`multiscale.laws.bulk.J2`, which is compiled here without a spectral
decomposition. With the trial :math:`b = F C_p^{-1} F^t`, the deviator :math:`e` of
:math:`\tfrac12 \ln b = \operatorname{artanh} Z`, :math:`Z = I - 2 (b + I)^{-1}`, and the pulled
back directions :math:`g = F^{-T} T^t`,

.. math::
    P T^t = \tau g, \qquad \tau = \kappa e + \tau_v I, \qquad
    \kappa = 2 \mu (1 - \Delta\gamma / |e|).    \tag{1}

A motion with the gradient :math:`l = d + w` changes this strain by
:math:`w e - e w + f(\mathrm{ad}_e)\, d`, where :math:`\mathrm{ad}_e d = e d - d e` and
:math:`f(x) = x \coth x` is an even series. By the theorem of Cayley and Hamilton
:math:`f(\mathrm{ad}_e) d = \sum h_{ij}\, e^i d\, e^j` with powers up to 2, and so

.. math::
    A_{ka,lb} = (\tau_v' - \tfrac{\kappa}{3}) g_{ka} g_{lb}
        - \frac{\lambda}{|e|^2} (eg)_{ka} (eg)_{lb}
        + \sum_{ij} m_{ij} (e^i g)_{kb} (e^j g)_{la}
        + \sum_{ij} r_{ij} (e^i)_{kl} (g^t e^j g)_{ab},    \tag{2}

where :math:`\lambda = \kappa - d|s|/d|e|`, :math:`m` is :math:`\tfrac{\kappa}{2} h` less
:math:`\tau_v` in place 00 and :math:`\tfrac{\kappa}{2}` in 01 and 10, and :math:`r` is
:math:`\tfrac{\kappa}{2} h` with :math:`\tfrac{\kappa}{2}` more in 01 and less in 10.
"""

import math

import numpy as np

from multiscale.micro.finite.batch import (
    COFACTOR,
    DEFORMED,
    FLUX,
    LOG,
    METRIC,
    PULLED,
    WEIGHT,
    kernel,
    part,
    point_rows,
)
from multiscale.micro.finite.element_stiffness import FIRST, SECOND, STEP
from multiscale.micro.hexahedron import BATCH
from multiscale.numerics.compiled import compiled

__all__ = ["SINGLE_ROWS", "plastic", "plastic_state"]

# symmetric tensors have the rows 11, 22, 33, 12, 23, 13
FC = METRIC  # 9: F C_p^-1
TRIAL = FC + 9 * BATCH  # 6: b
ROOT = TRIAL + 6 * BATCH  # 6: a root of b
OTHER = ROOT + 6 * BATCH  # 6 and 6: of the iteration of the root
INVERSE = OTHER + 6 * BATCH
TANH = INVERSE + 6 * BATCH  # 6: Z, then 6: its square, and 3: its invariants
STRAIN = TANH + 15 * BATCH  # 15: e, as Z
FACTOR = STRAIN + 15 * BATCH  # 3: of the powers 0, 1, 2 in a polynomial of a tensor
ALPHA = FACTOR + 3 * BATCH  # accumulated plastic strain
SIZE = ALPHA + BATCH  # |e|
GAMMA = SIZE + BATCH  # flow of the step
LIMIT = GAMMA + BATCH  # yield stress, and its slope
SLOPE = LIMIT + BATCH
FLOWS = SLOPE + BATCH  # 1 where it flows, 0 elsewhere
KEEP = FLOWS + BATCH  # 4: kappa, tau_v and the factors of the first two terms of (2), weighted
TURNED = KEEP + 4 * BATCH  # 9: e g
# rows in single precision
TURNS = 0  # 3 x 9: g, eg, eeg
POWERS = TURNS + 27 * BATCH  # 15: as from STRAIN on
MODULI = POWERS + 15 * BATCH  # 4: as from KEEP on
SERIES = MODULI + 4 * BATCH  # 6: kappa / 2 h in places 00, 01, 11, 02, 12, 22
MOVED = SERIES + 6 * BATCH  # 3 x 9: sums of m e^j g
METRICS = MOVED + 27 * BATCH  # 3 x 6: g^t e^j g
SHARES = METRICS + 18 * BATCH  # 6 x 3: sums of r e^i
SINGLE_ROWS = SHARES // BATCH + 18

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
ROWS = ((0, 3, 5), (3, 1, 4), (5, 4, 2))
NEAR = 0.03  # largest Z : Z of the series of artanh
TERMS = 10  # of this series
ROOTS = 20  # enough for any b whose eigenvalues double precision tells apart
EXPONENTS = 24  # terms of an exponential, enough for a plastic strain of 1 in one step
ROOT_2_3 = math.sqrt(2.0 / 3.0)
COTH = np.array((  # x coth x / 2 in powers of x^2 from the highest, for strains less than pi apart
    1.15532163e-11, -1.14025756e-10, 1.12539233e-9, -3617 / 325641566250, 2 / 18243225,
    -691 / 638512875, 1 / 93555, -1 / 9450, 1 / 945, -1 / 90, 1 / 6, 0.5,
), np.float32)  # fmt: skip
TINY = 1e-150
ZERO, HALF, ONE, TWO = (np.float32(number) for number in (0.0, 0.5, 1.0, 2.0))


@part
def _trial(s, state):  # type: ignore[no-untyped-def]
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
        i, j = PAIRS[3 + k]
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
def _combine(s, tensor, out):  # type: ignore[no-untyped-def]
    """Write the polynomial of a symmetric tensor with its FACTOR; the square has its rows."""
    for row in range(3):
        x, y, to = tensor + row * BATCH, tensor + (6 + row) * BATCH, out + row * BATCH
        for v in range(BATCH):
            a, b, c = s[FACTOR + v], s[FACTOR + BATCH + v], s[FACTOR + 2 * BATCH + v]
            s[to + v] = a + b * s[x + v] + c * s[y + v]
            s[to + 3 * BATCH + v] = b * s[x + 3 * BATCH + v] + c * s[y + 3 * BATCH + v]


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
def _strain(s):  # type: ignore[no-untyped-def]
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
            square = x * x + y * y + z * z + 2.0 * (xy * xy + yz * yz + xz * xz)
            far += 1.0 if square > NEAR else 0.0
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
    _combine(s, TANH, STRAIN)
    _square(s, STRAIN)


@kernel
def _saturate(s, rise, rate):  # type: ignore[no-untyped-def]
    """Add the saturation to the yield stress, and to its slope by the plastic strain."""
    if rate > 0.0:
        for v in range(BATCH):
            decay = math.exp(-rate * s[ALPHA + v])
            s[LIMIT + v] += rise * (1.0 - decay)
            s[SLOPE + v] += rise * rate * decay


@kernel
def _flow(s, state, shear, first, hardening, rise, rate, lanes):  # type: ignore[no-untyped-def]
    """Find |e| and the flow by Newton's iteration; return the number of flowing lanes."""
    for v in range(BATCH):
        x, y, z = s[STRAIN + 6 * BATCH + v], s[STRAIN + 7 * BATCH + v], s[STRAIN + 8 * BATCH + v]
        s[SIZE + v] = math.sqrt(x + y + z)
        s[ALPHA + v], s[GAMMA + v] = state[6, v], 0.0
        s[LIMIT + v], s[SLOPE + v] = first + hardening * state[6, v], hardening
    _saturate(s, rise, rate)
    flowing = 0.0
    for v in range(BATCH):
        beyond = 2.0 * shear * s[SIZE + v] > ROOT_2_3 * s[LIMIT + v]
        s[FLOWS + v] = 1.0 if beyond else 0.0
        flowing += s[FLOWS + v] if v < lanes else 0.0
    if flowing == 0.0:
        return 0
    for _ in range(60):
        moved = 0.0
        for v in range(BATCH):
            step = 2.0 * shear * (s[SIZE + v] - s[GAMMA + v]) - ROOT_2_3 * s[LIMIT + v]
            step *= s[FLOWS + v] / (2.0 * shear + 2.0 / 3.0 * s[SLOPE + v])
            s[GAMMA + v] += step
            s[ALPHA + v] = state[6, v] + ROOT_2_3 * s[GAMMA + v]
            s[LIMIT + v], s[SLOPE + v] = first + hardening * s[ALPHA + v], hardening
            moved += 1.0 if abs(step) > 1e-15 * s[SIZE + v] else 0.0
        _saturate(s, rise, rate)
        if moved == 0.0:
            break
    return int(flowing)


@compiled(inline="always", fastmath=True)  # offsets become constants
def _turn(s, tensor, vectors, out):  # type: ignore[no-untyped-def]
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


@part
def _factors(s, weight, shear):  # type: ignore[no-untyped-def]
    """Factors of (1) and (2) times the weight of the point."""
    for v in range(BATCH):
        size = s[SIZE + v] + TINY
        share = s[FLOWS + v] * 2.0 * shear / (2.0 * shear + 2.0 / 3.0 * s[SLOPE + v])
        ratio = s[GAMMA + v] / size
        keep = 2.0 * shear * (1.0 - ratio)
        lose = 2.0 * shear * (ratio - share)
        s[KEEP + v] = weight[v] * keep
        s[KEEP + BATCH + v] = weight[v] * s[LOG + v]
        s[KEEP + 2 * BATCH + v] = weight[v] * (s[LOG + BATCH + v] - keep / 3.0)
        s[KEEP + 3 * BATCH + v] = weight[v] * lose / (size * size)


@part
def _push(factors, g, turned, flux):  # type: ignore[no-untyped-def]
    """Add the flux (1) in one direction."""
    for v in range(BATCH):
        keep, volumetric = factors[v], factors[BATCH + v]
        flux[v] += keep * turned[v] + volumetric * g[v]
        flux[12 * BATCH + v] += keep * turned[3 * BATCH + v] + volumetric * g[3 * BATCH + v]
        flux[24 * BATCH + v] += keep * turned[6 * BATCH + v] + volumetric * g[6 * BATCH + v]


@kernel
def plastic(s, q, shear, hardening, state, w, tangent, lanes):  # type: ignore[no-untyped-def]
    """Add the flux of one Gauss point and write its tangent (2); return the flowing lanes.

    ``w`` is scratch of SINGLE_ROWS in single precision.
    """
    _trial(s, state)
    _strain(s)
    flowing = _flow(s, state, shear, hardening[0], hardening[1], hardening[2], hardening[3], lanes)
    _turn(s, STRAIN, PULLED, TURNED)
    _factors(s, s[WEIGHT + q * BATCH :], shear)
    rx, ry, _, rt = point_rows(q)
    for a, row in enumerate((rx, ry, 8 * BATCH + rt)):
        _push(s[KEEP:], s[PULLED + a * BATCH :], s[TURNED + a * BATCH :], s[FLUX + row :])
    for k in range(9 * BATCH):
        w[TURNS + k] = s[PULLED + k]
    for k in range(9 * BATCH):
        w[TURNS + 9 * BATCH + k] = s[TURNED + k]
    for k in range(15 * BATCH):
        w[POWERS + k] = s[STRAIN + k]
    for k in range(4 * BATCH):
        w[MODULI + k] = s[KEEP + k]
    _turn(w, POWERS, TURNS + 9 * BATCH, TURNS + 18 * BATCH)
    _series(w)
    _sums(w)
    for block in range(6):
        k, m = FIRST[block], SECOND[block]
        rows = 3 * k * BATCH, 3 * m * BATCH, SHARES + 3 * ROWS[k][m] * BATCH
        out = tangent[(block if block < 3 else 24 + block) * BATCH :]
        _write(w, rows, 0, ROWS[0], out)
        _write(w, rows, 1, ROWS[1], out)
        _write(w, rows, 2, ROWS[2], out)
    return flowing


@kernel
def _series(w):  # type: ignore[no-untyped-def]
    """Write the numbers h by Horner's scheme in (x - y)^2 with x^3 = p x + q, y likewise."""
    for k in range(6 * BATCH):
        w[SERIES + k] = ZERO
    for term in range(len(COTH)):
        number = COTH[term]
        for v in range(BATCH):
            p, q = -w[POWERS + 13 * BATCH + v], w[POWERS + 14 * BATCH + v]
            h, i, j = w[SERIES + v], w[SERIES + BATCH + v], w[SERIES + 2 * BATCH + v]
            k, m = w[SERIES + 3 * BATCH + v], w[SERIES + 4 * BATCH + v]
            n = w[SERIES + 5 * BATCH + v]
            r, t = q * n, k + p * n
            w[SERIES + v] = TWO * q * (i - r) + number * w[MODULI + v]
            w[SERIES + BATCH + v] = q * (j - k) + p * (i - TWO * r)
            w[SERIES + 2 * BATCH + v] = TWO * (p * (j - k - t) + q * m - h)
            w[SERIES + 3 * BATCH + v] = h + p * k - q * m
            w[SERIES + 4 * BATCH + v] = r - i
            w[SERIES + 5 * BATCH + v] = TWO * (t - j)


@kernel
def _sums(w):  # type: ignore[no-untyped-def]
    """Write the sums over j of m e^j g and over i of r e^i, and the products g^t e^j g."""
    for row in range(9):
        g, out = TURNS + row * BATCH, MOVED + row * BATCH
        for v in range(BATCH):
            x, y, z = w[g + v], w[g + 9 * BATCH + v], w[g + 18 * BATCH + v]
            h, m = w[SERIES + 3 * BATCH + v], w[SERIES + 4 * BATCH + v]
            i = w[SERIES + BATCH + v] - HALF * w[MODULI + v]
            w[out + v] = (w[SERIES + v] - w[MODULI + BATCH + v]) * x + i * y + h * z
            w[out + 9 * BATCH + v] = i * x + w[SERIES + 2 * BATCH + v] * y + m * z
            w[out + 18 * BATCH + v] = h * x + m * y + w[SERIES + 5 * BATCH + v] * z
    for row in range(6):
        e, out = POWERS + row * BATCH, SHARES + 3 * row * BATCH
        one = ONE if row < 3 else ZERO
        for v in range(BATCH):
            x, y, half = w[e + v], w[e + 6 * BATCH + v], HALF * w[MODULI + v]
            h, i, m = w[SERIES + 3 * BATCH + v], w[SERIES + BATCH + v], w[SERIES + 4 * BATCH + v]
            w[out + v] = one * w[SERIES + v] + (i - half) * x + h * y
            w[out + BATCH + v] = one * (i + half) + w[SERIES + 2 * BATCH + v] * x + m * y
            w[out + 2 * BATCH + v] = one * h + m * x + w[SERIES + 5 * BATCH + v] * y
    for power in range(3):
        first, second = TURNS + 9 * (power // 2) * BATCH, TURNS + 9 * ((power + 1) // 2) * BATCH
        for row in range(6):
            out = METRICS + (6 * power + row) * BATCH
            x, y = first + PAIRS[row][0] * BATCH, second + PAIRS[row][1] * BATCH
            for v in range(BATCH):
                w[out + v] = (
                    w[x + v] * w[y + v]
                    + w[x + 3 * BATCH + v] * w[y + 3 * BATCH + v]
                    + w[x + 6 * BATCH + v] * w[y + 6 * BATCH + v]
                )


@compiled(inline="always", fastmath=True)  # offsets become constants
def _write(w, rows, a, metrics, out):  # type: ignore[no-untyped-def]
    """Write three rows of the tangent of two components, which are given by their offsets."""
    k, m, share = rows
    x, y, z = metrics
    for v in range(BATCH):
        one, two, three = w[share + v], w[share + BATCH + v], w[share + 2 * BATCH + v]
        p = w[MODULI + 2 * BATCH + v] * w[TURNS + a * BATCH + k + v]
        q = w[MODULI + 3 * BATCH + v] * w[TURNS + (9 + a) * BATCH + k + v]
        r, s = w[MOVED + a * BATCH + m + v], w[MOVED + (9 + a) * BATCH + m + v]
        t = w[MOVED + (18 + a) * BATCH + m + v]
        g, h = TURNS + m + v, TURNS + k + v
        out[3 * a * STEP + v] = (
            p * w[g] + q * w[g + 9 * BATCH]
            + r * w[h] + s * w[h + 9 * BATCH] + t * w[h + 18 * BATCH]
            + one * w[METRICS + x * BATCH + v] + two * w[METRICS + (6 + x) * BATCH + v]
            + three * w[METRICS + (12 + x) * BATCH + v]
        )  # fmt: skip
        out[(3 * a + 1) * STEP + v] = (
            p * w[g + BATCH] + q * w[g + 10 * BATCH]
            + r * w[h + BATCH] + s * w[h + 10 * BATCH] + t * w[h + 19 * BATCH]
            + one * w[METRICS + y * BATCH + v] + two * w[METRICS + (6 + y) * BATCH + v]
            + three * w[METRICS + (12 + y) * BATCH + v]
        )  # fmt: skip
        out[(3 * a + 2) * STEP + v] = (
            p * w[g + 2 * BATCH] + q * w[g + 11 * BATCH]
            + r * w[h + 2 * BATCH] + s * w[h + 11 * BATCH] + t * w[h + 20 * BATCH]
            + one * w[METRICS + z * BATCH + v] + two * w[METRICS + (6 + z) * BATCH + v]
            + three * w[METRICS + (12 + z) * BATCH + v]
        )  # fmt: skip


@kernel
def plastic_state(s, shear, hardening, state, new):  # type: ignore[no-untyped-def]
    r"""State at the end of the step.

    .. math:: C_p^{-1} + F^{-1} b\, (e^{-2 \Delta\gamma N} - I) F^{-t} - I

    leaves the state of an elastic point unchanged to the last bit.
    """
    _trial(s, state)
    _strain(s)
    _flow(s, state, shear, hardening[0], hardening[1], hardening[2], hardening[3], BATCH)
    for k in range(3 * BATCH):
        s[FACTOR + k] = 0.0
    for term in range(EXPONENTS, 0, -1):  # the exponential less I in powers of e, without trace
        for v in range(BATCH):
            scale = -2.0 * s[GAMMA + v] / (term * s[SIZE + v] + TINY)
            a, b, c = s[FACTOR + v] + 1.0, s[FACTOR + BATCH + v], scale * s[FACTOR + 2 * BATCH + v]
            s[FACTOR + v] = c * s[STRAIN + 14 * BATCH + v]
            s[FACTOR + BATCH + v] = scale * a - c * s[STRAIN + 13 * BATCH + v]
            s[FACTOR + 2 * BATCH + v] = scale * b
    _combine(s, STRAIN, TANH)
    _turn(s, TANH, COFACTOR, TURNED)
    for row in range(6):
        x, y = FC + PAIRS[row][0] * BATCH, TURNED + PAIRS[row][1] * BATCH
        for v in range(BATCH):  # F^-1 b = (F C_p^-1)^t
            change = s[x + v] * s[y + v] + s[x + 3 * BATCH + v] * s[y + 3 * BATCH + v]
            new[row, v] = state[row, v] + change + s[x + 6 * BATCH + v] * s[y + 6 * BATCH + v]
    for v in range(BATCH):
        new[6, v] = s[ALPHA + v]
