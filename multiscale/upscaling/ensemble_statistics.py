"""How sure the averages of an ensemble are, and how they change with cells and their number."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.upscaling.observations import Observations
from multiscale.upscaling.response_observations import area_observations, normal_observations

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Average", "Trend", "ensemble_average", "required_realisations", "size_trend"]

_OBSERVE = {"mean_gap": normal_observations, "contact_fraction": area_observations}


@dataclass(frozen=True, eq=False)
class Average:
    """Mean of one quantity over the realisations, step by step.

    Attributes
    ----------
    pressure : ndarray, shape (steps,)
        Pa, rising.
    mean, deviation : ndarray, shape (steps,)
        Mean and standard deviation, m for a gap.
    half_width : ndarray, shape (steps,)
        Half-width of the interval of the mean (Student), same unit; infinite for one realisation.
    n : ndarray of int, shape (steps,)
        Realisations that count.
    confidence : float
    """

    pressure: np.ndarray
    mean: np.ndarray
    deviation: np.ndarray
    half_width: np.ndarray
    n: np.ndarray
    confidence: float

    @property
    def coefficient_of_variation(self) -> np.ndarray:
        """Standard deviation over the mean, dimensionless."""
        return np.asarray(self.deviation / np.abs(self.mean))


@dataclass(frozen=True, eq=False)
class Trend:
    """How a value changes with a number that describes the ensemble.

    Attributes
    ----------
    at, value : ndarray, shape (points,)
        What the ensembles differ in, and the value of each.
    interval : ndarray, shape (2, points)
        95 % interval of each value.
    slope, slope_interval
        Slope of the line through the points, in the coordinates that the function states, and its
        95 % interval.
    """

    at: np.ndarray
    value: np.ndarray
    interval: np.ndarray
    slope: float
    slope_interval: tuple[float, float]


def ensemble_average(
    response: "xr.Dataset",
    variable: str = "mean_gap",
    *,
    confidence: float = 0.95,
    target: float | None = None,
) -> Average:
    """Average a quantity over the realisations.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``.
    variable : {"mean_gap", "contact_fraction"}
    confidence, target : float
        Confidence of the interval of the mean, and the largest half-width asked for, relative to
        the mean.

    Raises
    ------
    CaseError
        If the interval is wider than asked for; the message says how many realisations suffice.
    """
    from scipy.stats import t

    if not 0.0 < confidence < 1.0:
        raise CaseError(f"confidence must lie between 0 and 1, got {confidence:g}")
    seen = _observe(response, variable)
    n = seen.counted.sum(axis=0)
    mean = seen.means()[0][0]
    square = np.where(seen.counted, seen.values - mean, 0.0) ** 2
    deviation = np.sqrt(square.sum(axis=0) / np.maximum(n - 1, 1))
    factor = t.ppf(0.5 * (1.0 + confidence), np.maximum(n - 1, 1))
    half = np.where(n > 1, factor * deviation / np.sqrt(n), np.inf)
    average = Average(seen.pressure, mean, np.where(n > 1, deviation, np.nan), half, n, confidence)
    ratio = half / np.abs(mean)
    if target is None or not np.any(ratio > target):
        return average
    j = int(np.argmax(ratio))
    where = f"{100.0 * confidence:g} % confidence at {seen.pressure[j]:.3g} Pa"
    if n[j] < 2:
        raise CaseError(
            f"one realisation tells nothing of the scatter of {variable}; {where} needs at least 3"
        )
    need = required_realisations(float(average.coefficient_of_variation[j]), target, confidence)
    raise CaseError(
        f"{n[j]} realisations give {variable} within {100.0 * ratio[j]:.2g} % with "
        f"{where}, not {100.0 * target:.2g} %; about {need} realisations are enough, or cells "
        f"{ratio[j] / target:.2g} times as large"
    )


def required_realisations(
    coefficient_of_variation: float, target: float, confidence: float = 0.95
) -> int:
    r"""Smallest number of realisations whose mean is known to a relative half-width.

    Notes
    -----
    The smallest :math:`N \ge 2` with :math:`t_{(1+c)/2,\,N-1}\, \mathrm{CoV} / \sqrt N \le` target.

    Examples
    --------
    >>> required_realisations(0.05, 0.02)
    27
    """
    from scipy.stats import norm, t

    if not target > 0.0:
        raise CaseError(f"the target must be positive, got {target:g}")
    tail = 0.5 * (1.0 + confidence)
    n = max(2, int((norm.ppf(tail) * coefficient_of_variation / target) ** 2))
    while t.ppf(tail, n - 1) * coefficient_of_variation / np.sqrt(n) > target:
        n += 1
    return n


def size_trend(
    responses: Mapping[float, "xr.Dataset"],
    variable: str = "mean_gap",
    *,
    pressure: float | None = None,
) -> Trend:
    r"""Scatter of a quantity over the size of the cell.

    Parameters
    ----------
    responses : mapping of float to Dataset
        From the size of the cell, in longest wavelengths :math:`L/\lambda_l`, to its response;
        at least two sizes with the same spectrum, of at least 8 realisations each.
    variable : {"mean_gap", "contact_fraction"}
    pressure : float, optional
        Step at this nominal pressure, Pa; the middle one if not given.

    Returns
    -------
    Trend
        Coefficient of variation over the size, with chi-squared intervals. The slope between
        the logarithms is -1 where the scatter falls as :math:`\lambda_l/L`: a cell then averages
        over :math:`(L/\lambda_l)^2` independent patches. Its interval comes from 2000 bootstrap
        samples of the realisations of each size.
    """
    from scipy.stats import chi2

    if len(responses) < 2:
        raise CaseError(
            f"the convergence with the cell size needs at least two sizes, got {len(responses)}"
        )
    size = np.array(sorted(responses))
    random, spread, interval, samples = np.random.default_rng(seed=0), [], [], []
    for relative in size:
        values = _at(responses[relative], variable, pressure)
        n = values.size
        if n < 8:
            raise CaseError(
                f"a scatter from {n} realisations is too uncertain for a trend over the cell size; "
                f"use at least 8 at each size, and 40 for a slope within about 0.3"
            )
        cov = float(np.std(values, ddof=1) / abs(values.mean()))
        spread.append(cov)
        interval.append(cov * np.sqrt((n - 1) / chi2.ppf([0.975, 0.025], n - 1)))
        drawn = values[random.integers(0, n, (2000, n))]
        samples.append(np.std(drawn, axis=1, ddof=1) / np.abs(drawn.mean(axis=1)))
    slopes = np.polyfit(np.log(size), np.log(np.array(samples)), 1)[0]
    slope = float(np.polyfit(np.log(size), np.log(spread), 1)[0])
    low, high = np.percentile(slopes, [2.5, 97.5])
    return Trend(size, np.array(spread), np.array(interval).T, slope, (float(low), float(high)))


def _observe(response: "xr.Dataset", variable: str) -> Observations:
    if variable not in _OBSERVE:
        raise CaseError(f"no average of {variable!r}; choose from {', '.join(_OBSERVE)}")
    return _OBSERVE[variable](response)


def _at(response: "xr.Dataset", variable: str, pressure: float | None) -> np.ndarray:
    """Values of all realisations that count at one step."""
    seen = _observe(response, variable)
    step = seen.pressure.size // 2
    if pressure is not None:
        step = int(np.argmin(np.abs(seen.pressure - pressure)))
        if abs(seen.pressure[step] - pressure) > 0.01 * pressure:
            raise CaseError(
                f"no step at {pressure:.3g} Pa; the nearest is at {seen.pressure[step]:.3g} Pa"
            )
    return np.asarray(seen.values[seen.counted[:, step], step])
