r"""J2 plasticity in logarithmic strain for a batch: return map, flux, new state.

For the equations see :class:`multiscale.laws.bulk.J2`, which is compiled here without a spectral
decomposition. With the deviator :math:`e` of the strain of :mod:`.logarithmic_strain` and the
pulled back directions :math:`g = F^{-T} T^t`,

.. math::
    P T^t = \tau g, \qquad \tau = \kappa e + \tau_v I, \qquad
    \kappa = 2 \mu (1 - \Delta\gamma / |e|).    \tag{1}
"""

import math

from multiscale.micro.elastic.hexahedron import BATCH
from multiscale.micro.finite.batch import (
    COFACTOR,
    FLUX,
    LOG,
    PULLED,
    WEIGHT,
    kernel,
    part,
    point_rows,
)
from multiscale.micro.finite.logarithmic_strain import (
    FACTOR,
    FC,
    LAST,
    STRAIN,
    SYMMETRIC,
    TANH,
    combine,
    logarithmic_strain,
    trial_strain,
    turn_vectors,
)
from multiscale.micro.finite.plastic_tangent import plastic_tangent

__all__ = ["plastic", "plastic_state"]

ALPHA = LAST  # accumulated plastic strain
SIZE = ALPHA + BATCH  # |e|
GAMMA = SIZE + BATCH  # flow of the step
LIMIT = GAMMA + BATCH  # yield stress, and its slope
SLOPE = LIMIT + BATCH
FLOWS = SLOPE + BATCH  # 1 where it flows, 0 elsewhere
KEEP = FLOWS + BATCH  # 4: kappa, tau_v and two factors of the tangent, weighted
TURNED = KEEP + 4 * BATCH  # 9: e g
EXPONENTS = 24  # terms of an exponential, enough for a plastic strain of 1 in one step
ROOT_2_3 = math.sqrt(2.0 / 3.0)
TINY = 1e-150


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


@part
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
    """Add the flux of one Gauss point and write its tangent; return the flowing lanes.

    ``w`` is scratch of SINGLE_ROWS in single precision.
    """
    trial_strain(s, state)
    logarithmic_strain(s)
    flowing = _flow(s, state, shear, hardening[0], hardening[1], hardening[2], hardening[3], lanes)
    turn_vectors(s, STRAIN, PULLED, TURNED)
    _factors(s, s[WEIGHT + q * BATCH :], shear)
    rx, ry, _, rt = point_rows(q)
    for a, row in enumerate((rx, ry, 8 * BATCH + rt)):
        _push(s[KEEP:], s[PULLED + a * BATCH :], s[TURNED + a * BATCH :], s[FLUX + row :])
    plastic_tangent(s, w, s[TURNED:], s[KEEP:], tangent)
    return flowing


@kernel
def plastic_state(s, shear, hardening, state, new):  # type: ignore[no-untyped-def]
    r"""State at the end of the step.

    .. math:: C_p^{-1} + F^{-1} b\, (e^{-2 \Delta\gamma N} - I) F^{-t} - I

    leaves the state of an elastic point unchanged to the last bit.
    """
    trial_strain(s, state)
    logarithmic_strain(s)
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
    combine(s, STRAIN, TANH)
    turn_vectors(s, TANH, COFACTOR, TURNED)
    for row in range(6):
        x, y = FC + SYMMETRIC[row][0] * BATCH, TURNED + SYMMETRIC[row][1] * BATCH
        for v in range(BATCH):  # F^-1 b = (F C_p^-1)^t
            change = s[x + v] * s[y + v] + s[x + 3 * BATCH + v] * s[y + 3 * BATCH + v]
            new[row, v] = state[row, v] + change + s[x + 6 * BATCH + v] * s[y + 6 * BATCH + v]
    for v in range(BATCH):
        new[6, v] = s[ALPHA + v]
