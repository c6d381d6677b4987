r"""Tension of links in the middle of a time step, such that no energy is gained."""

import numpy as np

from multiscale.numerics.compiled import compiled

__all__ = ["mean_tension"]


@compiled
def mean_tension(
    before: np.ndarray, after: np.ndarray, lower: np.ndarray, upper: np.ndarray, theta: float
) -> tuple[np.ndarray, np.ndarray]:
    r"""Return the weighted mean of the final tension of a step and its average over the elongation.

    Notes
    -----
    With :math:`V` the convex energy of a link and :math:`P` the projection onto the bounds,

    .. math::
        \bar\tau = (2\theta - 1)\, P(\tau^+) + 2 (1 - \theta)\, \frac{\Delta V}{\Delta e},

    so that :math:`\bar\tau\, \Delta e - \Delta V = (2\theta - 1)(\tau^+ \Delta e - \Delta V) \ge
    0`: a discrete gradient [1]_. If a link stays taut or slack it equals
    :math:`\theta \tau^+ + (1 - \theta) \tau^-`. The quotient is summed over the parts of the
    step below, between and above the bounds, without a difference of nearly equal energies.

    References
    ----------
    .. [1] O. Gonzalez, Comput. Methods Appl. Mech. Eng. 190 (2000) 1763-1783,
       doi:10.1016/S0045-7825(00)00189-4.
    """
    tension, slope = np.empty_like(after), np.empty_like(after)
    for row in range(after.size):
        low, high = min(before[row], after[row]), max(before[row], after[row])
        end = min(max(after[row], lower[row]), upper[row])
        carries = 1.0 if lower[row] < after[row] < upper[row] else 0.0
        mean, growth = end, 0.5 * carries
        if high > low:
            length = high - low
            first = min(max(low, lower[row]), upper[row])
            last = min(max(high, lower[row]), upper[row])
            taut = (last - first) / length
            mean = 0.5 * (first + last) * taut
            growth = 0.5 * taut * taut
            if low < lower[row]:
                below = (min(high, lower[row]) - low) / length
                mean += lower[row] * below
                growth += abs(end - lower[row]) / length * below
            if high > upper[row]:
                above = (high - max(low, upper[row])) / length
                mean += upper[row] * above
                growth += abs(end - upper[row]) / length * above
        tension[row] = (2.0 * theta - 1.0) * end + 2.0 * (1.0 - theta) * mean
        slope[row] = (2.0 * theta - 1.0) * carries + 2.0 * (1.0 - theta) * growth
    return tension, slope
