"""References of the codes: limits extrapolated from their finest grids."""

import numpy as np

__all__ = ["common_reference", "extrapolate", "limit_of"]


def extrapolate(values: np.ndarray, order: float | None = None) -> float:
    r"""Extrapolate a result, on grids each twice as fine as the one before, from its last three.

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
