"""The normal law of free form, from observations to the variables of its dataset."""

from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import AreaLaw, ConvexDecreasing
from multiscale.upscaling.bootstrap import widening
from multiscale.upscaling.family import integrate_stiffness
from multiscale.upscaling.observations import Observations
from multiscale.upscaling.spline import fit_spline, place_knots

__all__ = ["fit_area", "fit_convex_decreasing", "normal_errors", "unseen_errors"]

Values = dict[str, np.ndarray]


def fit_convex_decreasing(
    observations: Observations,
    counts: np.ndarray,
    weights: np.ndarray,
    *,
    n_terms: int,
    ridge: float,
) -> tuple[Values, dict[str, Any]]:
    """Fit a convex decreasing law and its samples.

    Parameters
    ----------
    observations : Observations
        Of the gap or of the normal stiffness.
    counts : ndarray, shape (samples, realisations)
        How often each realisation counts in each sample.
    weights : ndarray, shape (points,)
        Dimensionless.
    n_terms, ridge
        See :func:`multiscale.upscaling.fit_law`.

    Returns
    -------
    values, attributes : dict
        Of the dataset.

    Raises
    ------
    CaseError
        If the gap does not fall as the pressure rises.
    """
    p, n = observations.pressure, observations.pressure.size
    mean = observations.means()[0]
    sample_mean, sample_weight = observations.means(counts)
    gap, sample_gap, largest = mean, sample_mean, float(np.nanmax(_masked(observations)))
    if observations.quantity == "normal_stiffness":
        gap = integrate_stiffness(p, mean)
        sample_gap = integrate_stiffness(p, np.where(sample_weight > 0.0, sample_mean, mean))
        largest = float(max(gap.max(), sample_gap.max(initial=0.0)))
    _check_falls(p, gap[0])
    factor = widening(observations.n_realisations - 1, n=observations.n_realisations)
    largest += (factor - 1.0) * (largest - float(gap.max()))
    knot, level = place_knots(p, gap[0], n_terms, largest)

    root = np.sqrt(weights)
    coefficient = fit_spline(p, gap, root[None], knot, level, ridge=ridge)[0]
    law = ConvexDecreasing(knot, coefficient, pressure_range=(p[0], p[-1]))
    unseen = fit_spline(
        p, np.repeat(gap, n, axis=0), root * (1 - np.eye(n)), knot, level, ridge=ridge
    )
    sample_gap = gap + factor * np.where(sample_weight > 0.0, sample_gap - gap, 0.0)
    sample = np.empty((0, n_terms))
    if len(counts):
        seen = root * (sample_weight > 0.0)
        sample = fit_spline(p, sample_gap, seen, knot, level, ridge=ridge)
    blind = [ConvexDecreasing(knot, unseen[j]) for j in range(n)]
    values = {"knot": knot, "coefficient": coefficient, "coefficient_sample": sample}
    errors, attributes = normal_errors(law, blind, p, gap[0])
    attributes |= {"gap_min": float(gap[0, -1]), "gap_max": float(gap[0, 0]), "ridge": ridge}
    return values | errors, attributes


def normal_errors(
    law: Any, blind: list[Any], pressure: np.ndarray, gap: np.ndarray
) -> tuple[Values, dict[str, Any]]:
    """Errors of a normal law at its data, and of fits that lack one of them each.

    The first and the last point are not judged, as leaving them out is extrapolation.
    """
    inner = np.arange(1, len(gap) - 1)
    p, k, g = (np.full(len(gap), np.nan) for _ in range(3))
    for j in inner:
        p[j] = blind[j].pressure(gap[j]) / pressure[j] - 1.0
        k[j] = blind[j].stiffness(gap[j]) / law.stiffness(gap[j]) - 1.0
        g[j] = (blind[j].gap_at(pressure[j]) - gap[j]) / max(abs(gap[j]), 1e-300)
    attributes = {
        "maximum_fit_error": float(np.max(np.abs(law.pressure(gap) / pressure - 1.0))),
        "cross_validated_error": float(np.nanmax(np.abs(p))),
        "cross_validated_stiffness_error": float(np.nanmax(np.abs(k))),
        "cross_validated_rms_error": float(np.sqrt(np.nanmean(p**2))),
    }
    return {"fit_error": g, "stiffness_fit_error": k}, attributes


def _masked(observations: Observations) -> np.ndarray:
    """Values with NaN where there are none."""
    return np.where(observations.counted, observations.values, np.nan)


def _check_falls(p: np.ndarray, gap: np.ndarray) -> None:
    """Refuse gaps that no decreasing law has."""
    if not np.all(np.diff(gap) < 0.0):
        at = int(np.argmax(np.diff(gap) >= 0.0))
        raise CaseError(
            f"the mean gap does not fall from {p[at]:.3g} to {p[at + 1]:.3g} Pa "
            f"({gap[at]:.3g} to {gap[at + 1]:.3g} m), so that no decreasing law fits; "
            f"lower the pressures if contact is full there, or use more realisations"
        )
    if gap[0] - gap[-1] < 1e-9 * gap[0]:
        raise CaseError(
            f"the mean gap of {gap[0]:.3g} m changes by only {gap[0] - gap[-1]:.1g} m "
            f"over all pressures, which rounding may have made; raise the pressures"
        )


def fit_area(observations: Observations, counts: np.ndarray) -> Values:
    """Area law of free form and its samples: mean fractions that never fall."""
    p, mean = observations.pressure, observations.means()[0]
    sample_mean, sample_weight = observations.means(counts)
    factor = widening(observations.n_realisations - 1, n=observations.n_realisations)
    sample_mean = mean + factor * np.where(sample_weight > 0.0, sample_mean - mean, 0.0)
    fraction = _never_decreasing(mean)[0]
    error = np.full(p.size, np.nan)
    for j in range(1, p.size - 1):
        left = np.arange(p.size) != j
        blind = AreaLaw(p[left], fraction[left]).contact_fraction(p[j])
        error[j] = blind / fraction[j] - 1.0 if fraction[j] > 0.0 else np.nan
    return {
        "area_pressure": p,
        "area_fraction": fraction,
        "area_fraction_sample": _never_decreasing(sample_mean),
        "area_fit_error": error,
    }


def unseen_errors(error: np.ndarray) -> dict[str, Any]:
    """Largest and root mean square error at points that a fit has not seen; NaN does not count."""
    known = error[np.isfinite(error)]
    if not known.size:
        return {}
    return {
        "cross_validated_error": float(np.max(np.abs(known))),
        "cross_validated_rms_error": float(np.sqrt(np.mean(known**2))),
    }


def _never_decreasing(fractions: np.ndarray) -> np.ndarray:
    """Closest contact fractions, row by row, that never decrease and lie between 0 and 1."""
    from scipy.optimize import isotonic_regression

    fitted = fractions.copy()
    for row in np.flatnonzero(np.any(np.diff(fractions, axis=1) < 0.0, axis=1)):
        fitted[row] = isotonic_regression(fractions[row]).x
    return np.asarray(np.clip(fitted, 0.0, 1.0))
