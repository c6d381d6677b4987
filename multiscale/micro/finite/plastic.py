r"""J2 plasticity in logarithmic strain for a batch: return map, spectral tangent, new state.

For the equations see :class:`multiscale.laws.bulk.J2`. In the principal frame :math:`V` of the
trial :math:`b = F C_p^{-1} F^t`, with :math:`G = F^{-1} V`, the stress and its derivative are

.. math::
    P T^t = V \tau (TG)^t, \qquad A_{kl} = TG\, W_{kl}\, (TG)^t,    \tag{1}

for each pair of components :math:`k, l`, where

.. math::
    (W_{kl})_{ab} = V_{ka} V_{lb} (\partial\tau_a/\partial\varepsilon_b)
        + V_{kb} V_{la} (t \lambda_a - \tau_a), \qquad
    (W_{kl})_{aa} = V_{ka} V_{la} (\partial\tau_a/\partial\varepsilon_a - \tau_a)
        + \sum_{b \ne a} V_{kb} V_{lb}\, t \lambda_a,    \tag{2}

with :math:`t = (\tau_a - \tau_b)/(\lambda_a - \lambda_b)`.
"""

import math

from multiscale.micro.finite.batch import (
    COFACTOR,
    FLUX,
    GRADIENT,
    LOG,
    METRIC,
    PULLED,
    WEIGHT,
    kernel,
    logarithm,
    point_rows,
)
from multiscale.micro.finite.element_stiffness import FIRST, SECOND, STEP
from multiscale.micro.hexahedron import BATCH

__all__ = ["SINGLE_ROWS", "plastic", "plastic_state"]

FC = METRIC  # 9: F C_p^-1, later F^-1 V
TRIAL = FC + 9 * BATCH  # 6: b in rows 11, 22, 33, 12, 23, 13; the first three become eigenvalues
FRAME = TRIAL + 6 * BATCH  # 9: V
STRESS = FRAME + 9 * BATCH  # 3: Kirchhoff
FLOW = STRESS + 3 * BATCH  # 3: elastic logarithmic strains, before and after the return
ALPHA = FLOW + 3 * BATCH  # accumulated plastic strain
SIZE = ALPHA + BATCH  # of the deviatoric strain
GAMMA = SIZE + BATCH  # flow of the step
LIMIT = GAMMA + BATCH  # yield stress, and its slope
SLOPE = LIMIT + BATCH
FLOWS = SLOPE + BATCH  # 1 where it flows, 0 elsewhere
DIRECT = FLOWS + BATCH  # 6: derivatives of the stresses 11, 22, 33, 12, 23, 31
MIXED = DIRECT + 6 * BATCH  # 9: for 12, 23, 31: t lambda_a, t lambda_b, t lambda_a - tau_a
PUSHED = MIXED + 9 * BATCH  # 9: T G
SINGLE_ROWS = 33  # of V, TG, DIRECT and MIXED in single precision

SWEEPS = 8  # largest number of sweeps of Jacobi's method
LEAST = 1e-30  # largest sum of squares off the diagonal over a batch that counts as zero
CLOSE = 1e-6  # relative distance of eigenvalues that counts as equal
HALF = math.sqrt(2.0 / 3.0)


@kernel
def _trial(s, q, state):  # type: ignore[no-untyped-def]
    """Elastic left Cauchy-Green tensor of the step without flow."""
    f, c = s[GRADIENT + 9 * q * BATCH :], s[FC:]
    for k in range(3):
        fk, out = f[3 * k * BATCH :], c[3 * k * BATCH :]
        for v in range(BATCH):
            x, y, z = fk[v], fk[BATCH + v], fk[2 * BATCH + v]
            xy, yz, xz = state[3, v], state[4, v], state[5, v]
            out[v] = x * (1.0 + state[0, v]) + y * xy + z * xz
            out[BATCH + v] = x * xy + y * (1.0 + state[1, v]) + z * yz
            out[2 * BATCH + v] = x * xz + y * yz + z * (1.0 + state[2, v])
    for k in range(3):  # rows of b: its diagonal, and 12, 23, 13
        i, j = (k, k + 1) if k < 2 else (0, 2)
        g, fi, fk = c[3 * i * BATCH :], c[3 * k * BATCH :], f[3 * k * BATCH :]
        fj, out = f[3 * j * BATCH :], s[TRIAL + k * BATCH :]
        for v in range(BATCH):
            out[v] = (
                fi[v] * fk[v]
                + fi[BATCH + v] * fk[BATCH + v]
                + fi[2 * BATCH + v] * fk[2 * BATCH + v]
            )
            out[3 * BATCH + v] = (
                g[v] * fj[v] + g[BATCH + v] * fj[BATCH + v] + g[2 * BATCH + v] * fj[2 * BATCH + v]
            )
    for k in range(9 * BATCH):
        s[FRAME + k] = 0.0
    for k in range(3):
        for v in range(BATCH):
            s[FRAME + 4 * k * BATCH + v] = 1.0


@kernel
def _spectrum(s):  # type: ignore[no-untyped-def]
    """Eigenvalues and vectors by Jacobi's rotations, all lanes at once."""
    for _ in range(SWEEPS):
        rest = 0.0
        for v in range(BATCH):
            xy, yz = s[TRIAL + 3 * BATCH + v], s[TRIAL + 4 * BATCH + v]
            xz = s[TRIAL + 5 * BATCH + v]
            rest += xy * xy + yz * yz + xz * xz
        if rest < LEAST:
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
def _yield_stress(s, first, hardening, rise, rate):  # type: ignore[no-untyped-def]
    """Yield stress, and its slope by the plastic strain."""
    for v in range(BATCH):
        s[LIMIT + v], s[SLOPE + v] = first + hardening * s[ALPHA + v], hardening
    if rate > 0.0:
        for v in range(BATCH):
            decay = math.exp(-rate * s[ALPHA + v])
            s[LIMIT + v] += rise * (1.0 - decay)
            s[SLOPE + v] += rise * rate * decay


@kernel
def _flow(s, state, shear, first, hardening, rise, rate, lanes):  # type: ignore[no-untyped-def]
    """Find the flow of the step by Newton's iteration; return the number of flowing lanes."""
    for v in range(BATCH):
        s[ALPHA + v], s[GAMMA + v] = state[6, v], 0.0
    _yield_stress(s, first, hardening, rise, rate)
    flowing = 0.0
    for v in range(BATCH):
        beyond = 2.0 * shear * s[SIZE + v] > HALF * s[LIMIT + v]
        s[FLOWS + v] = 1.0 if beyond else 0.0
        flowing += s[FLOWS + v] if v < lanes else 0.0
    if flowing == 0.0:
        return 0
    for _ in range(60):
        moved = 0.0
        for v in range(BATCH):
            step = 2.0 * shear * (s[SIZE + v] - s[GAMMA + v]) - HALF * s[LIMIT + v]
            step *= s[FLOWS + v] / (2.0 * shear + 2.0 / 3.0 * s[SLOPE + v])
            s[GAMMA + v] += step
            s[ALPHA + v] = state[6, v] + HALF * s[GAMMA + v]
            moved += 1.0 if abs(step) > 1e-15 * s[SIZE + v] else 0.0
        _yield_stress(s, first, hardening, rise, rate)
        if moved == 0.0:
            break
    return int(flowing)


@kernel
def _return_map(s, state, shear, first, hardening, rise, rate, lanes):  # type: ignore[no-untyped-def]
    """Principal stresses, elastic strains and stiffness; return the number of flowing lanes."""
    for row in range(3):
        logarithm(s[TRIAL + row * BATCH :], s[FLOW + row * BATCH :])
    for v in range(BATCH):
        x, y, z = s[FLOW + v], s[FLOW + BATCH + v], s[FLOW + 2 * BATCH + v]
        mean = (x + y + z) / 3.0
        a, b, c = 0.5 * (x - mean), 0.5 * (y - mean), 0.5 * (z - mean)
        s[FLOW + v], s[FLOW + BATCH + v], s[FLOW + 2 * BATCH + v] = 0.5 * x, 0.5 * y, 0.5 * z
        s[DIRECT + v], s[DIRECT + BATCH + v], s[DIRECT + 2 * BATCH + v] = a, b, c
        s[SIZE + v] = math.sqrt(a * a + b * b + c * c)
    flowing = _flow(s, state, shear, first, hardening, rise, rate, lanes)
    for v in range(BATCH):
        a, b, c = s[DIRECT + v], s[DIRECT + BATCH + v], s[DIRECT + 2 * BATCH + v]
        size = s[SIZE + v] + 1e-300
        ratio = s[GAMMA + v] / size
        share = s[FLOWS + v] * 2.0 * shear / (2.0 * shear + 2.0 / 3.0 * s[SLOPE + v])
        keep = 2.0 * shear * (1.0 - ratio)
        lose = 2.0 * shear * (share - ratio)
        volume = s[LOG + v]
        s[STRESS + v] = keep * a + volume
        s[STRESS + BATCH + v] = keep * b + volume
        s[STRESS + 2 * BATCH + v] = keep * c + volume
        s[FLOW + v] -= ratio * a
        s[FLOW + BATCH + v] -= ratio * b
        s[FLOW + 2 * BATCH + v] -= ratio * c
        a, b, c = a / size, b / size, c / size
        common = s[LOG + BATCH + v] - keep / 3.0
        s[DIRECT + v] = common + keep - lose * a * a - s[STRESS + v]
        s[DIRECT + BATCH + v] = common + keep - lose * b * b - s[STRESS + BATCH + v]
        s[DIRECT + 2 * BATCH + v] = common + keep - lose * c * c - s[STRESS + 2 * BATCH + v]
        s[DIRECT + 3 * BATCH + v] = common - lose * a * b
        s[DIRECT + 4 * BATCH + v] = common - lose * b * c
        s[DIRECT + 5 * BATCH + v] = common - lose * c * a
        s[SIZE + v] = keep  # of a difference of strains
    for p in range(3):
        a, b = p * BATCH, (p + 1) % 3 * BATCH
        for v in range(BATCH):
            x, y = s[TRIAL + a + v], s[TRIAL + b + v]
            equal = abs(x - y) <= CLOSE * (x + y)
            t = (s[STRESS + a + v] - s[STRESS + b + v]) / (1.0 if equal else x - y)
            t = s[SIZE + v] / (x + y) if equal else t
            s[MIXED + 3 * a + v] = t * x
            s[MIXED + 3 * a + BATCH + v] = t * y
            s[MIXED + 3 * a + 2 * BATCH + v] = t * x - s[STRESS + a + v]
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
def plastic(s, q, shear, hardening, state, single, tangent, lanes):  # type: ignore[no-untyped-def]
    """Add the flux of one Gauss point and write its tangent (1); return the flowing lanes."""
    _trial(s, q, state)
    _spectrum(s)
    flowing = _return_map(
        s, state, shear, hardening[0], hardening[1], hardening[2], hardening[3], lanes
    )
    rx, ry, _, rt = point_rows(q)
    weight = s[WEIGHT + q * BATCH :]
    for b in range(3):  # T G = (F^-T T^t)^t V
        g, frame, out = s[PULLED + b * BATCH :], s[FRAME:], s[PUSHED + 3 * b * BATCH :]
        for v in range(BATCH):
            x, y, z = g[v], g[3 * BATCH + v], g[6 * BATCH + v]
            out[v] = x * frame[v] + y * frame[3 * BATCH + v] + z * frame[6 * BATCH + v]
            out[BATCH + v] = (
                x * frame[BATCH + v] + y * frame[4 * BATCH + v] + z * frame[7 * BATCH + v]
            )
            out[2 * BATCH + v] = (
                x * frame[2 * BATCH + v] + y * frame[5 * BATCH + v] + z * frame[8 * BATCH + v]
            )
    stress = s[STRESS:]
    for k in range(3):
        for direction, row in enumerate((rx, ry, 8 * BATCH + rt)):
            x, p = s[FRAME + 3 * k * BATCH :], s[PUSHED + 3 * direction * BATCH :]
            out = s[FLUX + 12 * k * BATCH + row :]
            for v in range(BATCH):
                push = x[v] * stress[v] * p[v]
                push += x[BATCH + v] * stress[BATCH + v] * p[BATCH + v]
                push += x[2 * BATCH + v] * stress[2 * BATCH + v] * p[2 * BATCH + v]
                out[v] += weight[v] * push
    _round(s, weight, single)
    for block in range(6):
        k, m = 3 * FIRST[block] * BATCH, 3 * SECOND[block] * BATCH
        _tangent(
            single, single[k:], single[m:], tangent[(block if block < 3 else 24 + block) * BATCH :]
        )
    return flowing


@kernel
def _round(s, weight, single):  # type: ignore[no-untyped-def]
    """Copy V, TG, and with the weight DIRECT and MIXED, in single precision."""
    for k in range(9 * BATCH):
        single[k] = s[FRAME + k]
    for k in range(9 * BATCH):
        single[9 * BATCH + k] = s[PUSHED + k]
    for row in range(5):
        direct, out = s[DIRECT + 3 * row * BATCH :], single[(18 + 3 * row) * BATCH :]
        for v in range(BATCH):  # three rows at once
            out[v] = weight[v] * direct[v]
            out[BATCH + v] = weight[v] * direct[BATCH + v]
            out[2 * BATCH + v] = weight[v] * direct[2 * BATCH + v]


@kernel
def _tangent(w, first, second, out):  # type: ignore[no-untyped-def]
    """Write the nine rows of A for two components, whose rows of V are given."""
    for v in range(BATCH):
        a, b, c = first[v], first[BATCH + v], first[2 * BATCH + v]
        d, e, f = second[v], second[BATCH + v], second[2 * BATCH + v]
        ad, be, cf = a * d, b * e, c * f
        # W of (2)
        xx = ad * w[18 * BATCH + v] + be * w[24 * BATCH + v] + cf * w[31 * BATCH + v]
        yy = be * w[19 * BATCH + v] + ad * w[25 * BATCH + v] + cf * w[27 * BATCH + v]
        zz = cf * w[20 * BATCH + v] + be * w[28 * BATCH + v] + ad * w[30 * BATCH + v]
        xy = a * e * w[21 * BATCH + v] + b * d * w[26 * BATCH + v]
        yx = b * d * w[21 * BATCH + v] + a * e * w[26 * BATCH + v]
        yz = b * f * w[22 * BATCH + v] + c * e * w[29 * BATCH + v]
        zy = c * e * w[22 * BATCH + v] + b * f * w[29 * BATCH + v]
        zx = c * d * w[23 * BATCH + v] + a * f * w[32 * BATCH + v]
        xz = a * f * w[23 * BATCH + v] + c * d * w[32 * BATCH + v]
        # A = TG W TG^t
        p, q, r = w[9 * BATCH + v], w[10 * BATCH + v], w[11 * BATCH + v]
        g, h, i = w[12 * BATCH + v], w[13 * BATCH + v], w[14 * BATCH + v]
        j, k, m = w[15 * BATCH + v], w[16 * BATCH + v], w[17 * BATCH + v]
        x, y, z = p * xx + q * yx + r * zx, p * xy + q * yy + r * zy, p * xz + q * yz + r * zz
        out[v] = x * p + y * q + z * r
        out[STEP + v] = x * g + y * h + z * i
        out[2 * STEP + v] = x * j + y * k + z * m
        x, y, z = g * xx + h * yx + i * zx, g * xy + h * yy + i * zy, g * xz + h * yz + i * zz
        out[3 * STEP + v] = x * p + y * q + z * r
        out[4 * STEP + v] = x * g + y * h + z * i
        out[5 * STEP + v] = x * j + y * k + z * m
        x, y, z = j * xx + k * yx + m * zx, j * xy + k * yy + m * zy, j * xz + k * yz + m * zz
        out[6 * STEP + v] = x * p + y * q + z * r
        out[7 * STEP + v] = x * g + y * h + z * i
        out[8 * STEP + v] = x * j + y * k + z * m


@kernel
def plastic_state(s, q, shear, hardening, state, new):  # type: ignore[no-untyped-def]
    """State at the end of the step: C_p^-1 - I = F^-1 b_e F^-t - I and the plastic strain."""
    _trial(s, q, state)
    _spectrum(s)
    _return_map(s, state, shear, hardening[0], hardening[1], hardening[2], hardening[3], BATCH)
    _inverse_frame(s)
    for v in range(BATCH):
        if s[ALPHA + v] == state[6, v]:  # an elastic point keeps its state to the last bit
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
