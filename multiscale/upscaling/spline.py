"""Fit of a convex decreasing law to pressures and gaps; plain arrays."""

import numpy as np

__all__ = ["N_TERMS", "fit_spline", "place_knots"]

N_TERMS = 40
"""Knots of a law, if nothing else is asked for."""

RIDGE = 3e-4  # weight of the smoothness of a law, dimensionless

PASSES = 4  # of the fit, each smooth relative to the one before
HEAD = 0.3  # the first knot lies beyond the largest pressure by this, in its logarithm
TAIL = 7.0  # the last knot lies below the smallest pressure by this, in its logarithm


def place_knots(
    pressure: np.ndarray, gap: np.ndarray, n_terms: int, largest_gap: float
) -> tuple[np.ndarray, np.ndarray]:
    r"""Place knots evenly in the logarithm of the pressure.

    Notes
    -----
    Three fifths of the knots lie in the range of the data, where the gap is interpolated. Beyond,
    the decay length :math:`-\mathrm{d}g/\mathrm{d}\ln p` is taken proportional to :math:`p^\beta`
    with :math:`0 \le \beta \le 1` from the data: zero for an exponential law, 1/m for a power
    law of exponent m, so that the last knot comes close to the end of a compact support.
    """
    from scipy.interpolate import PchipInterpolator

    x = np.log(pressure)
    decay = -np.diff(gap) / np.diff(x)
    middle = 0.5 * (x[1:] + x[:-1])
    beta = float(np.clip(np.polyfit(middle, np.log(decay), 1)[0], 1e-6, 1.0))

    n_tail = (2 * n_terms) // 5
    inside = np.linspace(x[-1] + HEAD, x[0], n_terms - n_tail)
    even = n_tail * (inside[0] - inside[1])
    share = np.arange(1, n_tail + 1) / n_tail
    level = np.append(inside, x[0] - even * share - max(0.0, TAIL - even) * share**2)

    knot = np.asarray(PchipInterpolator(x, gap)(np.clip(level, x[0], x[-1])))
    knot -= decay[-1] * np.maximum(0.0, level - x[-1])
    end_decay = decay[0] * np.exp(beta * (x[0] - middle[0]))
    knot -= end_decay * np.expm1(beta * np.minimum(0.0, level - x[0])) / beta
    stretch = max(1.0, 1.05 * (largest_gap - gap[0]) / (knot[-1] - gap[0]))
    return np.where(knot > gap[0], gap[0] + stretch * (knot - gap[0]), knot), level


def fit_spline(
    pressure: np.ndarray,
    gap: np.ndarray,
    weight: np.ndarray,
    knot: np.ndarray,
    level: np.ndarray,
) -> np.ndarray:
    r"""Fit convex decreasing laws to samples of a response by non-negative least squares.

    Notes
    -----
    The curvature :math:`p''(g)` is linear between the knots, :math:`\theta_k \ge 0` at the knots
    and zero from the last one on: any such :math:`\theta` gives a positive, decreasing, convex
    and twice differentiable law of compact support. With the pressure :math:`A_{jk}` at
    :math:`g_j` of a unit curvature at knot k, the fit minimises

    .. math::
        \sum_j w_j \Big( \frac{1}{p_j} \sum_k A_{jk} \theta_k - 1 \Big)^2
        + \rho^2 \int \Big( \frac{\mathrm{d}^3 \ln \theta}{\mathrm{d} x^3} \Big)^2 \mathrm{d}x,
        \qquad x = \ln p,    \tag{1}

    with :math:`\rho =` :data:`RIDGE`, and :math:`\ln\theta` linearised about the pass before. The
    second term decides between curvatures that the data do not tell apart; it vanishes for
    exponential and for power laws.
    """
    from scipy.optimize import nnls

    origin, length, unit = knot[0], np.ptp(knot), pressure.max()
    s, g = (knot - origin) / length, (gap - origin) / length
    powers = _curvature_to_powers(s)
    bending = RIDGE * _third_derivative(level[:-1])
    decay = -np.gradient(s, level)[:-1]
    start = np.exp(level[:-1]) / unit / decay**2

    coefficients = np.empty((len(gap), knot.size))
    for sample, (here, counts) in enumerate(zip(g, weight, strict=True)):
        at_data = np.maximum(0.0, s - here[:, None]) ** 3 @ powers  # A_jk
        at_data *= (counts * unit / pressure)[:, None]
        theta = start
        for _ in range(PASSES):
            matrix = np.vstack([at_data * theta, bending])
            target = np.concatenate([counts, -bending @ (np.log(theta) - 1.0)])
            change, _ = nnls(matrix, target, maxiter=100 * theta.size)
            theta = theta * np.clip(change, 0.1, 10.0)
        coefficients[sample] = powers @ theta
    # left of the first knot the curvature goes on with its slope, but never falls
    coefficients[:, 0] += np.maximum(0.0, -coefficients.sum(axis=1))
    return np.asarray(coefficients * unit / length**3)


def _curvature_to_powers(knot: np.ndarray) -> np.ndarray:
    """Coefficients of the truncated cubes for a unit curvature at each knot but the last."""
    n, h = knot.size, np.diff(knot)
    powers = np.zeros((n, n - 1))
    for k in range(n - 1):
        powers[k + 1, k] += 1.0 / (6.0 * h[k])
        powers[k, k] -= 1.0 / (6.0 * h[k])
        if k > 0:
            powers[k, k] -= 1.0 / (6.0 * h[k - 1])
            powers[k - 1, k] += 1.0 / (6.0 * h[k - 1])
    return powers


def _third_derivative(x: np.ndarray) -> np.ndarray:
    """Matrix whose squared norm is the integral of the squared third derivative over x."""
    difference = np.eye(x.size)
    for order in (1, 2, 3):
        spacing = (x[:-order] - x[order:]) / order
        difference = np.diff(difference, axis=0) / -spacing[:, None]
    return np.asarray(difference * np.sqrt(spacing)[:, None])
