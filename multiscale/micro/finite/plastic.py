r"""J2 plasticity in logarithmic strain for a batch: return map, spectral tangent, new state.

The equations are those of :class:`multiscale.laws.bulk.J2`. In the principal frame :math:`V` of the
trial :math:`b = F C_p^{-1} F^t`, with :math:`G = F^{-1} V` and :math:`m_{ab} = V_a \otimes T G_b`,

.. math::
    P T^t = \sum_a \tau_a m_{aa}, \qquad A = \sum m_{ab}\, k_{ab,cd}\, m_{cd}, \tag{1}

where only :math:`k_{aa,cc} = \partial\tau_a/\partial\varepsilon_c - \tau_a \delta_{ac}`,
:math:`k_{ab,ab} = t \lambda_b` and :math:`k_{ab,ba} = t \lambda_a - \tau_a` with
:math:`t = (\tau_a - \tau_b)/(\lambda_a - \lambda_b)` are not zero.
"""

import math

from multiscale.micro.finite.batch import (
    COFACTOR,
    FLUX,
    GEOMETRY,
    GRADIENT,
    LOG,
    METRIC,
    WEIGHT,
    kernel,
    point_rows,
)
from multiscale.micro.hexahedron import BATCH

__all__ = ["plastic", "plastic_state"]

FC = METRIC  # 9: F C_p^-1, later F^-1 V
TRIAL = FC + 9 * BATCH  # 6: b in rows 11, 22, 33, 12, 23, 13; the first three become eigenvalues
FRAME = TRIAL + 6 * BATCH  # 9: V
STRESS = FRAME + 9 * BATCH  # 3: Kirchhoff
FLOW = STRESS + 3 * BATCH  # 3: elastic logarithmic strains after the return
ALPHA = FLOW + 3 * BATCH  # accumulated plastic strain
DIRECT = ALPHA + BATCH  # 9: k_aa,cc
MIXED = DIRECT + 9 * BATCH  # 9: for 12, 23, 13: k_ab,ab, k_ba,ba, k_ab,ba
PUSHED = MIXED + 9 * BATCH  # 9: T G
CHANGE = PUSHED + 9 * BATCH  # 81: k m
TURNED = CHANGE + 81 * BATCH  # 27

SWEEPS = 8
LEAST = 1e-31  # sum of squares off the diagonal that counts as zero
CLOSE = 1e-6  # relative distance of eigenvalues that counts as equal
YIELDED = 1e-9
HALF = math.sqrt(2.0 / 3.0)


@kernel
def _trial(s, q, state):  # type: ignore[no-untyped-def]
    """Elastic left Cauchy-Green tensor of the step without flow."""
    f = GRADIENT + 9 * q * BATCH
    for k in range(3):
        fk, out = f + 3 * k * BATCH, FC + 3 * k * BATCH
        for v in range(BATCH):
            x, y, z = s[fk + v], s[fk + BATCH + v], s[fk + 2 * BATCH + v]
            xy, yz, xz = state[3, v], state[4, v], state[5, v]
            s[out + v] = x * (1.0 + state[0, v]) + y * xy + z * xz
            s[out + BATCH + v] = x * xy + y * (1.0 + state[1, v]) + z * yz
            s[out + 2 * BATCH + v] = x * xz + y * yz + z * (1.0 + state[2, v])
    for row in range(6):
        i, j = row % 3, (row % 3 + row // 3) % 3 if row < 5 else 0
        if row == 5:
            i, j = 0, 2
        g, fj, out = FC + 3 * i * BATCH, f + 3 * j * BATCH, TRIAL + row * BATCH
        for v in range(BATCH):
            value = s[g + v] * s[fj + v] + s[g + BATCH + v] * s[fj + BATCH + v]
            s[out + v] = value + s[g + 2 * BATCH + v] * s[fj + 2 * BATCH + v]
    for row in range(9):
        one = 1.0 if row % 4 == 0 else 0.0
        for v in range(BATCH):
            s[FRAME + row * BATCH + v] = one


@kernel
def _spectrum(s):  # type: ignore[no-untyped-def]
    """Eigenvalues and vectors by Jacobi's rotations, all lanes at once."""
    for _ in range(SWEEPS):
        largest = 0.0
        for v in range(BATCH):
            xy, yz = s[TRIAL + 3 * BATCH + v], s[TRIAL + 4 * BATCH + v]
            xz = s[TRIAL + 5 * BATCH + v]
            largest = max(largest, xy * xy + yz * yz + xz * xz)
        if largest < LEAST:
            break
        for p in range(3):
            r = (p + 1) % 3
            other = (p + 2) % 3
            pp, rr = TRIAL + p * BATCH, TRIAL + r * BATCH
            pr = TRIAL + (3 + p) * BATCH  # rows 3, 4, 5 hold 12, 23, 31
            ro, op = TRIAL + (3 + r) * BATCH, TRIAL + (3 + other) * BATCH
            for v in range(BATCH):
                off, gap = s[pr + v], s[rr + v] - s[pp + v]
                sign = 1.0 if gap >= 0.0 else -1.0
                t = 2.0 * off * sign
                t /= sign * gap + math.sqrt(gap * gap + 4.0 * off * off) + 1e-300
                cosine = 1.0 / math.sqrt(t * t + 1.0)
                sine = t * cosine
                s[pp + v] -= t * off
                s[rr + v] += t * off
                s[pr + v] = 0.0
                a, b = s[op + v], s[ro + v]
                s[op + v], s[ro + v] = cosine * a - sine * b, sine * a + cosine * b
                for k in range(3):
                    x = FRAME + (3 * k + p) * BATCH + v
                    y = FRAME + (3 * k + r) * BATCH + v
                    a, b = s[x], s[y]
                    s[x], s[y] = cosine * a - sine * b, sine * a + cosine * b


@kernel
def _return_map(s, state, shear, first, hardening, rise, rate, lanes):  # type: ignore[no-untyped-def]
    """Principal stresses, elastic strains and stiffness; return the number of flowing lanes."""
    flowing = 0
    for v in range(BATCH):
        x = 0.5 * math.log(s[TRIAL + v])
        y = 0.5 * math.log(s[TRIAL + BATCH + v])
        z = 0.5 * math.log(s[TRIAL + 2 * BATCH + v])
        mean = (x + y + z) / 3.0
        a, b, c = x - mean, y - mean, z - mean
        size = math.sqrt(a * a + b * b + c * c)
        alpha, gamma, share = state[6, v], 0.0, 0.0
        decay = math.exp(-rate * alpha) if rate > 0.0 else 1.0
        limit = first + hardening * alpha + rise * (1.0 - decay)
        if 2.0 * shear * size > (1.0 - YIELDED) * HALF * limit:
            flowing += v < lanes
            slope = hardening + rise * rate * decay
            for _ in range(60):
                step = 2.0 * shear * (size - gamma) - HALF * limit
                step /= 2.0 * shear + 2.0 / 3.0 * slope
                gamma += step
                alpha = state[6, v] + HALF * gamma
                decay = math.exp(-rate * alpha) if rate > 0.0 else 1.0
                limit = first + hardening * alpha + rise * (1.0 - decay)
                slope = hardening + rise * rate * decay
                if abs(step) <= 1e-15 * size:
                    break
            if gamma < 0.0:
                gamma, alpha = 0.0, state[6, v]
            share = 2.0 * shear / (2.0 * shear + 2.0 / 3.0 * slope)
        ratio = gamma / size if size > 0.0 else 0.0
        keep = 2.0 * shear * (1.0 - ratio)
        lose = 2.0 * shear * (share - ratio) / (size * size) if size > 0.0 else 0.0
        volume, stiff = s[LOG + v], s[LOG + BATCH + v]
        s[ALPHA + v] = alpha
        s[STRESS + v] = keep * a + volume
        s[STRESS + BATCH + v] = keep * b + volume
        s[STRESS + 2 * BATCH + v] = keep * c + volume
        s[FLOW + v], s[FLOW + BATCH + v] = x - ratio * a, y - ratio * b
        s[FLOW + 2 * BATCH + v] = z - ratio * c
        common = stiff - keep / 3.0
        s[DIRECT + v] = common + keep - lose * a * a - s[STRESS + v]
        s[DIRECT + BATCH + v] = common - lose * a * b
        s[DIRECT + 2 * BATCH + v] = common - lose * a * c
        s[DIRECT + 4 * BATCH + v] = common + keep - lose * b * b - s[STRESS + BATCH + v]
        s[DIRECT + 5 * BATCH + v] = common - lose * b * c
        s[DIRECT + 8 * BATCH + v] = common + keep - lose * c * c - s[STRESS + 2 * BATCH + v]
    for v in range(BATCH):
        s[DIRECT + 3 * BATCH + v] = s[DIRECT + BATCH + v]
        s[DIRECT + 6 * BATCH + v] = s[DIRECT + 2 * BATCH + v]
        s[DIRECT + 7 * BATCH + v] = s[DIRECT + 5 * BATCH + v]
    for p in range(3):
        a, b = p * BATCH, (p + 1) % 3 * BATCH
        for v in range(BATCH):
            first_value, second_value = s[TRIAL + a + v], s[TRIAL + b + v]
            gap, total = first_value - second_value, first_value + second_value
            equal = abs(gap) <= CLOSE * total
            # with equal strains the stress difference is keep times the strain difference
            keep = s[DIRECT + 4 * a + v] + s[STRESS + a + v] - s[DIRECT + 3 * a + b + v]
            t = (s[STRESS + a + v] - s[STRESS + b + v]) / (1.0 if equal else gap)
            t = keep / total if equal else t
            s[MIXED + 3 * a + v] = t * second_value
            s[MIXED + 3 * a + BATCH + v] = t * first_value
            s[MIXED + 3 * a + 2 * BATCH + v] = t * first_value - s[STRESS + a + v]
    return flowing


@kernel
def _inverse_frame(s):  # type: ignore[no-untyped-def]
    """G = F^-1 V, into the place of F C_p^-1."""
    for m in range(3):
        for a in range(3):
            out = FC + (3 * m + a) * BATCH
            for v in range(BATCH):
                value = s[COFACTOR + m * BATCH + v] * s[FRAME + a * BATCH + v]
                value += s[COFACTOR + (3 + m) * BATCH + v] * s[FRAME + (3 + a) * BATCH + v]
                s[out + v] = value + (
                    s[COFACTOR + (6 + m) * BATCH + v] * s[FRAME + (6 + a) * BATCH + v]
                )


@kernel
def plastic(s, q, shear, hardening, state, tangent, lanes):  # type: ignore[no-untyped-def]
    """Add the flux of one Gauss point and write its tangent (1); return the flowing lanes."""
    _trial(s, q, state)
    _spectrum(s)
    flowing = _return_map(
        s, state, shear, hardening[0], hardening[1], hardening[2], hardening[3], lanes
    )
    _inverse_frame(s)
    rx, ry, _, rt = point_rows(q)
    w = WEIGHT + q * BATCH
    for a in range(3):
        g, p = FC + a * BATCH, PUSHED + a * BATCH
        for v in range(BATCH):
            x, y, z = s[g + v], s[g + 3 * BATCH + v], s[g + 6 * BATCH + v]
            along = z - s[GEOMETRY + rx + 4 * BATCH + v] * x
            along -= s[GEOMETRY + ry + 4 * BATCH + v] * y
            s[p + v], s[p + 3 * BATCH + v] = x, y
            s[p + 6 * BATCH + v] = along / s[GEOMETRY + rt + v]
    for k in range(3):
        for b in range(3):
            row = (rx, ry, 8 * BATCH + rt)[b] + FLUX + 12 * k * BATCH
            x, p = FRAME + 3 * k * BATCH, PUSHED + 3 * b * BATCH
            for v in range(BATCH):
                value = s[x + v] * s[STRESS + v] * s[p + v]
                value += s[x + BATCH + v] * s[STRESS + BATCH + v] * s[p + BATCH + v]
                value += s[x + 2 * BATCH + v] * s[STRESS + 2 * BATCH + v] * s[p + 2 * BATCH + v]
                s[row + v] += s[w + v] * value
    _change(s)
    _tangent(s, w, tangent)
    return flowing


@kernel
def _change(s):  # type: ignore[no-untyped-def]
    """Multiply the nine vectors m of (1) by k."""
    for a in range(3):
        out = CHANGE + 36 * a * BATCH  # k_aa,cc m_cc
        for k in range(3):
            for b in range(3):
                x, p = FRAME + 3 * k * BATCH, PUSHED + 3 * b * BATCH
                d, z = DIRECT + 3 * a * BATCH, out + (3 * k + b) * BATCH
                for v in range(BATCH):
                    value = s[d + v] * s[x + v] * s[p + v]
                    value += s[d + BATCH + v] * s[x + BATCH + v] * s[p + BATCH + v]
                    value += s[d + 2 * BATCH + v] * s[x + 2 * BATCH + v] * s[p + 2 * BATCH + v]
                    s[z + v] = value
    for a in range(3):
        c = (a + 1) % 3
        mixed = MIXED + 3 * a * BATCH
        first, second = CHANGE + 9 * (3 * a + c) * BATCH, CHANGE + 9 * (3 * c + a) * BATCH
        for k in range(3):
            xa, xc = FRAME + (3 * k + a) * BATCH, FRAME + (3 * k + c) * BATCH
            for b in range(3):
                pa, pc = PUSHED + (3 * b + a) * BATCH, PUSHED + (3 * b + c) * BATCH
                z = (3 * k + b) * BATCH
                for v in range(BATCH):
                    m_ac, m_ca = s[xa + v] * s[pc + v], s[xc + v] * s[pa + v]
                    both = s[mixed + 2 * BATCH + v]
                    s[first + z + v] = s[mixed + v] * m_ac + both * m_ca
                    s[second + z + v] = s[mixed + BATCH + v] * m_ca + both * m_ac


@kernel
def _tangent(s, w, tangent):  # type: ignore[no-untyped-def]
    """Upper triangle of A = sum m_ab (k m)_ab, row by row."""
    entry = 0
    for i in range(3):
        x = FRAME + 3 * i * BATCH
        for b in range(3):  # contract with V_i
            for c in range(3 * i, 9):
                z, out = CHANGE + (9 * b + c) * BATCH, TURNED + (9 * b + c) * BATCH
                for v in range(BATCH):
                    value = s[x + v] * s[z + v] + s[x + BATCH + v] * s[z + 27 * BATCH + v]
                    s[out + v] = s[w + v] * (value + s[x + 2 * BATCH + v] * s[z + 54 * BATCH + v])
        for a in range(3):
            p = PUSHED + 3 * a * BATCH
            for c in range(3 * i + a, 9):
                z = TURNED + c * BATCH
                for v in range(BATCH):
                    value = s[p + v] * s[z + v] + s[p + BATCH + v] * s[z + 9 * BATCH + v]
                    tangent[entry * BATCH + v] = (
                        value + s[p + 2 * BATCH + v] * s[z + 18 * BATCH + v]
                    )
                entry += 1


@kernel
def plastic_state(s, q, shear, hardening, state, new):  # type: ignore[no-untyped-def]
    """State at the end of the step: C_p^-1 - I = F^-1 b_e F^-t - I and the plastic strain."""
    _trial(s, q, state)
    _spectrum(s)
    _return_map(s, state, shear, hardening[0], hardening[1], hardening[2], hardening[3], 0)
    _inverse_frame(s)
    for v in range(BATCH):
        if s[ALPHA + v] == state[6, v]:  # what did not flow keeps its state to the last bit
            for row in range(7):
                new[row, v] = state[row, v]
            continue
        new[6, v] = s[ALPHA + v]
        x = math.exp(2.0 * s[FLOW + v])
        y = math.exp(2.0 * s[FLOW + BATCH + v])
        z = math.exp(2.0 * s[FLOW + 2 * BATCH + v])
        for row in range(6):
            i = (row % 3) if row < 5 else 0
            j = i if row < 3 else (i + 1 if row < 5 else 2)
            gi, gj = FC + 3 * i * BATCH + v, FC + 3 * j * BATCH + v
            value = x * s[gi] * s[gj] + y * s[gi + BATCH] * s[gj + BATCH]
            value += z * s[gi + 2 * BATCH] * s[gj + 2 * BATCH]
            new[row, v] = value - (1.0 if row < 3 else 0.0)
