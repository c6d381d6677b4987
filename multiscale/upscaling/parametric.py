"""A law of a family with parameters, from observations to the variables of its dataset."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from multiscale.upscaling.bootstrap import widening
from multiscale.upscaling.family import Family, integrate_stiffness
from multiscale.upscaling.observations import Observations
from multiscale.upscaling.regression import Regression, regression_of
from multiscale.upscaling.spline_law import FitResult, Values, normal_errors, unseen_errors

__all__ = ["fit_family"]

BY_REALISATION = "bootstrap over realisations"
BY_POINT = "bootstrap over the residuals of independent points"
NONE = "none: too few realisations or no samples asked for, so the scatter is not known"


def fit_family(
    observations: Observations,
    family: Family,
    counts: np.ndarray,
    weights: np.ndarray,
    fixed: Mapping[str, float],
    *,
    n_samples: int,
    seed: int,
) -> FitResult:
    """Fit the parameters of a family and their samples; unsettled samples are only counted."""
    regression = regression_of(family, observations, fixed, weights)
    mean = observations.mean
    ones = np.ones(mean.size)
    best = regression.solve(mean, ones)
    if observations.quantity not in ("gap", "recovery"):
        # errors relative to a value that is itself too small would weigh more, and bias the law
        for _ in range(2):
            regression = replace(regression, scale=regression.predict(best))
            best = regression.solve(mean, ones, best)

    drawn = _sample_means(observations, regression, best, counts, n_samples, seed)
    found = regression.solve_many(*drawn, best)
    samples = [sample for sample in found if sample is not None]
    values: Values = {name: np.array(value) for name, value in best.items()}
    for name in best:
        values[f"{name}_sample"] = np.array([sample[name] for sample in samples])
    values |= {name: np.array(value) for name, value in regression.held.items()}
    errors = _errors(observations, regression, best, mean)
    attributes = errors.attributes | {
        "parameters": " ".join(family.parameters),
        "held": " ".join(regression.held),
        "fixed": " ".join(fixed),
        "n_failed_samples": len(found) - len(samples),
        "uncertainty": BY_REALISATION if len(counts) else (BY_POINT if samples else NONE),
    }
    return FitResult(values | errors.values, attributes)


def _sample_means(
    observations: Observations,
    regression: Regression,
    best: Mapping[str, float],
    counts: np.ndarray,
    n_samples: int,
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean values of the samples and their weights, (samples, points)."""
    mean = observations.mean[None]
    if len(counts):
        sample, weight = observations.means(counts)
        return mean + observations.widening * np.where(weight > 0.0, sample - mean, 0.0), weight
    n, k = mean.size, len(regression.free)
    # the points of several specimens are not independent: each is stiffer or softer at all
    if not (observations.independent and observations.n_realisations == 1):
        return np.empty((0, n)), np.empty((0, n))
    fitted = regression.predict(best)
    residual = (mean[0] - fitted) / regression.scale
    residual = (residual - residual.mean()) * np.sqrt(n / (n - k)) * widening(n - k)
    drawn = np.random.default_rng(seed).integers(0, n, (n_samples, n))
    return fitted + regression.scale * residual[drawn], np.ones((n_samples, n))


def _errors(
    observations: Observations, regression: Regression, best: Mapping[str, float], mean: np.ndarray
) -> FitResult:
    r"""Errors of the fit at its data and of fits that lack one point each; Akaike's criterion.

    With its correction for few points, of the weighted residuals as independent errors, it is

    .. math:: n \ln(R/n) + 2 (k+1) + \frac{2 (k+1)(k+2)}{n - k - 2}.    \tag{1}
    """
    n, k = mean.size, len(regression.free)
    normal = observations.quantity in ("gap", "normal_stiffness")
    judged = np.arange(1, n - 1) if normal else np.arange(n)
    kept = 1.0 - np.eye(n)[judged]
    found = regression.solve_many(np.tile(mean, (judged.size, 1)), kept, best)
    blind = [dict(best) if one is None else one for one in found]
    fit = (regression.predict(best) - mean) / regression.scale
    total = max(float(np.sum(regression.weights * fit**2)), 1e-24 * n)
    criterion = float("nan")
    if n - k - 2 > 0:
        criterion = float(n * np.log(total / n) + 2 * (k + 1) + 2 * (k + 1) * (k + 2) / (n - k - 2))
    attributes = {"akaike_criterion": criterion, "n_parameters": k}
    if normal:
        p, law = observations.pressure, regression.law(best)
        gap = mean if observations.quantity == "gap" else integrate_stiffness(p, mean)
        laws = [regression.law(one) for one in blind]  # a misfit does not decay: share 1
        errors = normal_errors(law, laws, judged, p, gap)
        return FitResult(errors.values, attributes | errors.attributes)
    error = np.array([regression.predict(one)[j] for j, one in enumerate(blind)])
    error = (error - mean) / regression.scale
    attributes |= {"maximum_fit_error": float(np.max(np.abs(fit))), **unseen_errors(error)}
    return FitResult({"fit_error": error}, attributes)
