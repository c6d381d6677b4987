r"""Fit of a convex decreasing law to pressures and gaps; plain arrays, many samples at once."""

import numpy as np

from multiscale.errors import ConvergenceError

__all__ = ["fit_spline", "place_knots"]

HEAD = 0.3
"""How far the first knot lies beyond the largest pressure, in its logarithm."""
TAIL = 7.0
"""How far the last knot lies below the smallest pressure, in its logarithm."""


def place_knots(
    pressure: np.ndarray, gap: np.ndarray, n_terms: int, largest_gap: float
) -> tuple[np.ndarray, np.ndarray]:
    r"""Knots that are even in the logarithm of the pressure.

    Parameters
    ----------
    pressure, gap : ndarray, shape (n,)
        The data, pressure increasing and gap decreasing; Pa and m.
    n_terms : int
        Number of knots, at least 6.
    largest_gap : float
        The last knot lies beyond this gap, m.

    Returns
    -------
    knot : ndarray, shape (n_terms,)
        Increasing, m.
    level : ndarray, shape (n_terms,)
        Estimate of :math:`\ln p` at the knots, p in Pa.

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
    stretch = 1.05 * (largest_gap - gap[0]) / (knot[-1] - gap[0])
    return np.where(knot > gap[0], gap[0] + max(1.0, stretch) * (knot - gap[0]), knot), level


def fit_spline(
    pressure: np.ndarray,
    gap: np.ndarray,
    weight: np.ndarray,
    knot: np.ndarray,
    level: np.ndarray,
    *,
    ridge: float,
    max_iterations: int = 100,
    tolerance: float = 1e-5,
) -> np.ndarray:
    r"""Fit the coefficients of a convex decreasing law to samples of a response.

    Parameters
    ----------
    pressure : ndarray, shape (n,)
        :math:`p_j`, Pa.
    gap : ndarray, shape (samples, n)
        :math:`g_j` of every sample, m; below the last knot.
    weight : ndarray, shape (samples, n)
        1 for a point that counts, 0 for one that is left out; dimensionless.
    knot, level : ndarray, shape (terms,)
        From :func:`place_knots`.
    ridge : float
        :math:`\rho`, dimensionless.
    max_iterations : int
        Iteration limit.
    tolerance : float
        Bound on the Newton decrement, which is the change of the relative pressure error that
        another step would bring; dimensionless.

    Returns
    -------
    ndarray, shape (samples, terms)
        Coefficients of the truncated powers, Pa m\ :sup:`-3`.

    Raises
    ------
    ConvergenceError
        If a sample does not reach the tolerance.

    Notes
    -----
    The curvature :math:`p''` is linear between the knots, where it is :math:`\exp\theta_k`, and
    zero at the last. Any :math:`\theta` gives an admissible law. With the pressure
    :math:`A_{jk}` that a unit curvature at knot k makes at :math:`g_j`, the fit minimises

    .. math::
        \sum_j w_j \ln^2 \frac{\sum_k A_{jk}\, e^{\theta_k}}{p_j}
        + \rho^2 \int (\theta''')^2\, \mathrm{d}x, \qquad x = \ln p,    \tag{1}

    by Newton's method with the
    absolute values of the eigenvalues and a line search. The second term settles what few pressures leave open. It vanishes for
    exponential laws (:math:`\theta'` = 1) and power laws (:math:`\theta'` = 1 - 2/m) alike.
    """
    origin, length, unit = gap.min(), np.ptp(gap), pressure.max()
    s, g, target = (knot - origin) / length, (gap - origin) / length, np.log(pressure / unit)
    hats = _hats(s)
    at_data = np.maximum(0.0, s - g[..., None]) ** 3 @ hats  # A_jk
    bending = _third_differences(level[:-1])
    smooth = ridge**2 * bending.T @ bending
    theta = np.broadcast_to(level[:-1] - np.log(unit), (len(gap), s.size - 1)).copy()
    left = np.arange(len(gap))
    for stiffer in 10.0 ** np.arange(4):
        start = theta[left]
        theta[left], decrement = _minimise(
            start,
            at_data[left],
            target,
            weight[left],
            stiffer**2 * smooth,
            max_iterations,
            tolerance,
        )
        failed = ~(decrement <= tolerance)
        theta[left[failed]] = start[failed]
        left = left[failed]
        if left.size == 0:
            break
    else:
        raise ConvergenceError(
            f"the fit of the normal law did not converge in {max_iterations} iterations (last "
            f"decrement {np.max(decrement):.1e}); raise ridge, or leave out pressures whose gap "
            f"scatters"
        )
    coefficient = np.exp(theta) @ hats.T
    # left of the first knot the curvature continues with its slope, but never falls
    coefficient[:, 0] += np.maximum(0.0, -coefficient.sum(axis=1))
    return np.asarray(coefficient * (unit / length**3))


def _hats(knot: np.ndarray) -> np.ndarray:
    """Truncated powers whose second derivative is one at knot k, zero at the others."""
    n, h = knot.size, np.diff(knot)
    hats = np.zeros((n, n - 1))
    for k in range(n - 1):
        hats[k + 1, k] += 1.0 / (6.0 * h[k])
        hats[k, k] -= 1.0 / (6.0 * h[k])
        if k > 0:
            hats[k, k] -= 1.0 / (6.0 * h[k - 1])
            hats[k - 1, k] += 1.0 / (6.0 * h[k - 1])
    return hats


def _third_differences(x: np.ndarray) -> np.ndarray:
    """Matrix whose squared norm is the integral of the squared third derivative over x."""
    difference = np.eye(x.size)
    for order in (1, 2, 3):
        spacing = (x[:-order] - x[order:]) / order
        difference = np.diff(difference, axis=0) / -spacing[:, None]
    return difference * np.sqrt(spacing)[:, None]


def _logarithm_and_slope(
    at_data: np.ndarray, theta: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Logarithm of fitted over given pressure, and its derivative with respect to theta."""
    top = theta.max(axis=1, keepdims=True)
    parts = at_data * np.exp(theta - top)[:, None, :]
    total = parts.sum(axis=2)
    return np.log(total) + top - target, parts / total[..., None]


def _minimise(
    theta: np.ndarray,
    at_data: np.ndarray,
    target: np.ndarray,
    weight: np.ndarray,
    smooth: np.ndarray,
    max_iterations: int,
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Newton steps on (1), shortened where the decrement rises; theta and decrement."""
    theta, n = theta.copy(), theta.shape[1]
    final, fraction = np.full(len(theta), np.inf), np.ones(len(theta))
    busy = np.arange(len(theta))
    for _ in range(max_iterations):
        error, slope = _logarithm_and_slope(at_data[busy], theta[busy], target)
        weighted = slope * weight[busy, :, None]
        gradient = np.einsum("sjk,sj->sk", weighted, error) + theta[busy] @ smooth
        hessian = np.swapaxes(slope, 1, 2) @ weighted + smooth
        hessian += 1e-12 * np.eye(n)  # curvatures that neither data nor ridge see
        step = np.linalg.solve(hessian, -gradient[..., None])[..., 0]
        decrement = np.sqrt(np.maximum(0.0, -np.sum(gradient * step, axis=1)))
        fraction = np.where(decrement > final[busy], 0.5 * fraction, np.minimum(1, 1.3 * fraction))
        final[busy] = decrement
        going = ~(decrement <= tolerance)
        limit = np.minimum(fraction, 2.0 / np.maximum(2.0, np.abs(step).max(axis=1)))
        busy, fraction = busy[going], fraction[going]
        if busy.size == 0:
            break
        theta[busy] += (limit[:, None] * step)[going]
    return theta, final
