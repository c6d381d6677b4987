r"""J2 plasticity in logarithmic strain for a batch: return map, flux, new state, tangent.

For the equations see :class:`multiscale.laws.bulk.J2`. With the deviator :math:`e` of the strain of
:mod:`.strain` and the pulled back directions :math:`g = F^{-T} T^t`,

.. math::
    P T^t = \tau g, \qquad \tau = \kappa e + \tau_v I, \qquad
    \kappa = 2 \mu (1 - \Delta\gamma / |e|).    \tag{1}

A motion with the gradient :math:`l = d + w` changes the strain :math:`e` by
:math:`w e - e w + f(\mathrm{ad}_e)\, d` with :math:`f(x) = x \coth x`, by the theorem of Cayley and
Hamilton :math:`\sum h_{ij}\, e^i d\, e^j` with powers up to 2, and so

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

from multiscale.micro.elastic.stiffness import BATCH
from multiscale.micro.finite.matrix import FIRST, SECOND, STEP
from multiscale.micro.finite.strain import (
    COFACTOR,
    DILATED,
    FACTOR,
    FC,
    FLUX,
    LAST,
    LOG,
    PULLED,
    STRAIN,
    SYMMETRIC,
    TANH,
    WEIGHT,
    combine,
    inlined,
    kernel,
    logarithmic_strain,
    point_rows,
    trial_strain,
    turn_vectors,
)
from multiscale.numerics.compiled import compiled

ALPHA = LAST  # accumulated plastic strain
SIZE = ALPHA + BATCH  # |e|
GAMMA = SIZE + BATCH  # flow of the step
LIMIT = GAMMA + BATCH  # yield stress, and its slope
SLOPE = LIMIT + BATCH
FLOWS = SLOPE + BATCH  # 1 in flowing lanes, 0 elsewhere
KEEP = FLOWS + BATCH  # 4: kappa, tau_v and two factors of the tangent, weighted
TURNED = KEEP + 4 * BATCH  # 9: e g
assert TURNED + 9 * BATCH <= DILATED, "the rows of the law are too few"
EXPONENTS = 24  # terms of an exponential, enough for a plastic strain of 1 in a step
ROOT_2_3 = math.sqrt(2.0 / 3.0)
TINY = 1e-150

# rows in single precision
TURNS = 0  # 3 x 9: g, eg, eeg
POWERS = TURNS + 27 * BATCH  # 15: e, as in STRAIN
MODULI = POWERS + 15 * BATCH  # 4: kappa, tau_v and the factors of the first two terms of (2)
SERIES = MODULI + 4 * BATCH  # 6: kappa / 2 h in places 00, 01, 11, 02, 12, 22
MOVED = SERIES + 6 * BATCH  # 3 x 9: sums of m e^j g
METRICS = MOVED + 27 * BATCH  # 3 x 6: g^t e^j g
SHARES = METRICS + 18 * BATCH  # 6 x 3: sums of r e^i
SINGLE_ROWS = SHARES // BATCH + 18

ROWS = ((0, 3, 5), (3, 1, 4), (5, 4, 2))
COTH = np.array((  # x coth x / 2 in powers of x^2 from the highest, for strains less than pi apart
    1.15532163e-11, -1.14025756e-10, 1.12539233e-9, -3617 / 325641566250, 2 / 18243225,
    -691 / 638512875, 1 / 93555, -1 / 9450, 1 / 945, -1 / 90, 1 / 6, 0.5,
), np.float32)  # fmt: skip
ZERO, HALF, ONE, TWO = (np.float32(number) for number in (0.0, 0.5, 1.0, 2.0))


@kernel
def _harden(s, moduli):  # type: ignore[no-untyped-def]
    """Write the yield stress and its slope at the plastic strain."""
    for v in range(BATCH):
        s[LIMIT + v] = moduli.yield_stress + moduli.hardening * s[ALPHA + v]
        s[SLOPE + v] = moduli.hardening
    if moduli.rate > 0.0:
        for v in range(BATCH):
            decay = math.exp(-moduli.rate * s[ALPHA + v])
            s[LIMIT + v] += moduli.saturation * (1.0 - decay)
            s[SLOPE + v] += moduli.saturation * moduli.rate * decay


@kernel
def _flow(s, state, moduli, lanes):  # type: ignore[no-untyped-def]
    """Compute |e| and the flow by Newton's iteration; return the number of flowing lanes."""
    for v in range(BATCH):
        x, y, z = s[STRAIN + 6 * BATCH + v], s[STRAIN + 7 * BATCH + v], s[STRAIN + 8 * BATCH + v]
        s[SIZE + v] = math.sqrt(x + y + z)
        s[ALPHA + v], s[GAMMA + v] = state[6, v], 0.0
    _harden(s, moduli)
    shear, flowing = moduli.shear, 0.0
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
            moved += 1.0 if abs(step) > 1e-15 * s[SIZE + v] else 0.0
        _harden(s, moduli)
        if moved == 0.0:
            break
    return int(flowing)


@inlined
def _factors(s, weight, shear):  # type: ignore[no-untyped-def]
    """Factors of (1) and of its tangent times the weight of the point."""
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


@inlined
def _push(factors, g, turned, flux):  # type: ignore[no-untyped-def]
    """Add the flux (1) in a direction."""
    for v in range(BATCH):
        keep, volumetric = factors[v], factors[BATCH + v]
        flux[v] += keep * turned[v] + volumetric * g[v]
        flux[12 * BATCH + v] += keep * turned[3 * BATCH + v] + volumetric * g[3 * BATCH + v]
        flux[24 * BATCH + v] += keep * turned[6 * BATCH + v] + volumetric * g[6 * BATCH + v]


@kernel
def plastic(s, q, moduli, state, w, tangent, lanes):  # type: ignore[no-untyped-def]
    """Add the flux of a Gauss point, write its tangent; return flowing lanes. ``w`` is scratch."""
    trial_strain(s, state)
    logarithmic_strain(s)
    flowing = _flow(s, state, moduli, lanes)
    turn_vectors(s, STRAIN, PULLED, TURNED)
    _factors(s, s[WEIGHT + q * BATCH :], moduli.shear)
    rx, ry, _, rt = point_rows(q)
    for a, row in enumerate((rx, ry, 8 * BATCH + rt)):
        _push(s[KEEP:], s[PULLED + a * BATCH :], s[TURNED + a * BATCH :], s[FLUX + row :])
    _tangent(s, w, s[TURNED:], s[KEEP:], tangent)
    return flowing


@kernel
def plastic_state(s, moduli, state, new):  # type: ignore[no-untyped-def]
    """Write the state C_p^-1 + F^-1 b (exp(-2 dgamma N) - I) F^-t - I at the end of the step."""
    trial_strain(s, state)
    logarithmic_strain(s)
    _flow(s, state, moduli, BATCH)
    for k in range(3 * BATCH):
        s[FACTOR + k] = 0.0
    for term in range(EXPONENTS, 0, -1):  # exponential minus I in powers of e
        for v in range(BATCH):
            scale = -2.0 * s[GAMMA + v] / (term * s[SIZE + v] + TINY)
            a, b, c = s[FACTOR + v] + 1.0, s[FACTOR + BATCH + v], scale * s[FACTOR + 2 * BATCH + v]
            s[FACTOR + v] = c * s[STRAIN + 14 * BATCH + v]
            s[FACTOR + BATCH + v] = scale * a - c * s[STRAIN + 13 * BATCH + v]
            s[FACTOR + 2 * BATCH + v] = scale * b
    combine(s, STRAIN, TANH)
    turn_vectors(s, TANH, COFACTOR, TURNED)
    for row in range(6):
        x, y = FC + SYMMETRIC[row][0] * BATCH, TURNED + SYMMETRIC[row][1] * BATCH
        for v in range(BATCH):  # F^-1 b = (F C_p^-1)^t
            change = s[x + v] * s[y + v] + s[x + 3 * BATCH + v] * s[y + 3 * BATCH + v]
            new[row, v] = state[row, v] + change + s[x + 6 * BATCH + v] * s[y + 6 * BATCH + v]
    for v in range(BATCH):
        new[6, v] = s[ALPHA + v]


@kernel
def _tangent(s, w, turned, moduli, tangent):  # type: ignore[no-untyped-def]
    """Write the tangent (2) of a Gauss point with weighted ``moduli``; ``w`` is scratch."""
    for k in range(9 * BATCH):
        w[TURNS + k] = s[PULLED + k]
    for k in range(9 * BATCH):
        w[TURNS + 9 * BATCH + k] = turned[k]
    for k in range(15 * BATCH):
        w[POWERS + k] = s[STRAIN + k]
    for k in range(4 * BATCH):
        w[MODULI + k] = moduli[k]
    turn_vectors(w, POWERS, TURNS + 9 * BATCH, TURNS + 18 * BATCH)
    _series(w)
    _sums(w)
    for block in range(6):
        k, m = FIRST[block], SECOND[block]
        rows = 3 * k * BATCH, 3 * m * BATCH, SHARES + 3 * ROWS[k][m] * BATCH
        out = tangent[(block if block < 3 else 24 + block) * BATCH :]
        _write(w, rows, 0, ROWS[0], out)
        _write(w, rows, 1, ROWS[1], out)
        _write(w, rows, 2, ROWS[2], out)


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
        unit = ONE if row < 3 else ZERO
        for v in range(BATCH):
            x, y, half = w[e + v], w[e + 6 * BATCH + v], HALF * w[MODULI + v]
            h, i, m = w[SERIES + 3 * BATCH + v], w[SERIES + BATCH + v], w[SERIES + 4 * BATCH + v]
            w[out + v] = unit * w[SERIES + v] + (i - half) * x + h * y
            w[out + BATCH + v] = unit * (i + half) + w[SERIES + 2 * BATCH + v] * x + m * y
            w[out + 2 * BATCH + v] = unit * h + m * x + w[SERIES + 5 * BATCH + v] * y
    for power in range(3):
        first, second = TURNS + 9 * (power // 2) * BATCH, TURNS + 9 * ((power + 1) // 2) * BATCH
        for row in range(6):
            out = METRICS + (6 * power + row) * BATCH
            x, y = first + SYMMETRIC[row][0] * BATCH, second + SYMMETRIC[row][1] * BATCH
            for v in range(BATCH):
                w[out + v] = (
                    w[x + v] * w[y + v]
                    + w[x + 3 * BATCH + v] * w[y + 3 * BATCH + v]
                    + w[x + 6 * BATCH + v] * w[y + 6 * BATCH + v]
                )


@compiled(inline="always", fastmath=True)  # offsets become constants
def _write(w, rows, a, metrics, out):  # type: ignore[no-untyped-def]
    """Write three rows of the tangent of two components, given by their offsets."""
    k, m, share = rows
    x, y, z = metrics
    for v in range(BATCH):
        r0, r1, r2 = w[share + v], w[share + BATCH + v], w[share + 2 * BATCH + v]
        p = w[MODULI + 2 * BATCH + v] * w[TURNS + a * BATCH + k + v]
        q = w[MODULI + 3 * BATCH + v] * w[TURNS + (9 + a) * BATCH + k + v]
        r, s = w[MOVED + a * BATCH + m + v], w[MOVED + (9 + a) * BATCH + m + v]
        t = w[MOVED + (18 + a) * BATCH + m + v]
        g, h = TURNS + m + v, TURNS + k + v
        out[3 * a * STEP + v] = (
            p * w[g] + q * w[g + 9 * BATCH]
            + r * w[h] + s * w[h + 9 * BATCH] + t * w[h + 18 * BATCH]
            + r0 * w[METRICS + x * BATCH + v] + r1 * w[METRICS + (6 + x) * BATCH + v]
            + r2 * w[METRICS + (12 + x) * BATCH + v]
        )  # fmt: skip
        out[(3 * a + 1) * STEP + v] = (
            p * w[g + BATCH] + q * w[g + 10 * BATCH]
            + r * w[h + BATCH] + s * w[h + 10 * BATCH] + t * w[h + 19 * BATCH]
            + r0 * w[METRICS + y * BATCH + v] + r1 * w[METRICS + (6 + y) * BATCH + v]
            + r2 * w[METRICS + (12 + y) * BATCH + v]
        )  # fmt: skip
        out[(3 * a + 2) * STEP + v] = (
            p * w[g + 2 * BATCH] + q * w[g + 11 * BATCH]
            + r * w[h + 2 * BATCH] + s * w[h + 11 * BATCH] + t * w[h + 20 * BATCH]
            + r0 * w[METRICS + z * BATCH + v] + r1 * w[METRICS + (6 + z) * BATCH + v]
            + r2 * w[METRICS + (12 + z) * BATCH + v]
        )  # fmt: skip
