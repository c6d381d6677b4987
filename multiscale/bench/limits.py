"""References of the codes: limits extrapolated from their finest grids."""

import numpy as np

__all__ = ["common_reference", "extrapolate", "limit_of"]


def extrapolate(values: np.ndarray, order: float | None = None) -> float:
    r"""Extrapolate a result, on grids each twice as fine as the one before, from its last three.

    Returns
    -------
    float
        :math:`v_3 + (v_3 - v_2) / (2^r - 1)`; ``nan`` if one of the three is. Without an order r it
        is :math:`\log_2 (v_2 - v_1) / (v_3 - v_2)`, kept between 1 and 2, and 2 for values that
        oscillate: their remaining error is small, and a wild order must not enlarge it.

    Examples
    --------
    >>> extrapolate(1.0 + 0.25 ** np.arange(3.0))
    1.0
    """
    first, second, third = (float(value) for value in values[-3:])
    before, last = second - first, third - second
    if last == 0.0:
        return third
    if order is None:
        order = 2.0
        if before / last > 0.0:
            order = float(np.clip(np.log2(before / last), 1.0, 2.0))
    return float(third + last / (2.0**order - 1.0))


def limit_of(count: int, scene: str, answers: list[float]) -> tuple[float, float]:
    """Limit of the first answers, from coarse to fine, and its relative distance from the last."""
    limit = extrapolate(np.array(answers[:count]))
    return limit, abs(answers[count - 1] / limit - 1.0)


def common_reference(limits: np.ndarray, finest: np.ndarray) -> tuple[float, float]:
    """Choose among the limits of several codes, and say how far they are apart.

    Parameters
    ----------
    limits, finest : ndarray, shape (codes,)
        The limit of each code and what it found on its finest grid; ``nan`` if there is none.

    Returns
    -------
    reference : float, the limit that was extrapolated least; ``nan`` if there is none
    uncertainty : float
        Largest distance of another limit from it, in the unit of the limits; ``nan`` with fewer
        than two, because nothing checks a single one.

    Examples
    --------
    >>> common_reference(np.array([1.0, 1.25]), np.array([1.5, 1.125]))
    (1.25, 0.25)
    """
    known = np.isfinite(limits)
    if not known.any():
        return np.nan, np.nan
    limits, finest = limits[known], finest[known]
    reference = float(limits[np.argmin(np.abs(limits - finest))])
    distance = float(np.max(np.abs(limits - reference)))
    return reference, distance if limits.size > 1 else np.nan
