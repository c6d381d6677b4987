"""Least squares for the parameters of a family, and the law of a family with its samples."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from math import exp, isinf
from typing import Any

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.upscaling.family import Family, Parameter, gaps_of
from multiscale.upscaling.free_form import FitResult, Values, normal_errors, unseen_errors
from multiscale.upscaling.observations import QUANTITIES, Observations
from multiscale.upscaling.reading import BY_REALISATION
from multiscale.upscaling.sampling import widening

FARTHEST = 60.0  # largest factor e^60 of a parameter in a fit
REFUSED = 1e6  # relative error of a law that cannot be made

BY_POINT = "bootstrap over the residuals of independent points"

NONE = "none: too few realisations or no samples, so the scatter is unknown"


@dataclass(frozen=True, eq=False)
class Regression:
    r"""The fit of a family to a set of conditions; built by :func:`regression_of`.

    The method of Levenberg and Marquardt in MINPACK minimises, with a zero gap at the largest
    pressure as a further term where a measured stiffness leaves the datum of the gap open,

    .. math:: \sum_j w_j \Big(\frac{f(x_j; \theta) - y_j}{s_j}\Big)^2.    \tag{1}
    """

    family: Family
    observations: Observations
    scale: np.ndarray  # (points,), s_j
    weights: np.ndarray  # (points,), w_j, not negative
    held: Mapping[str, float]  # values that follow from the data, SI
    free: tuple[str, ...]
    start: Mapping[str, float]  # initial parameters of the fit of the mean, SI

    def solve(
        self, mean: np.ndarray, weight: np.ndarray, start: Mapping[str, float] | None = None
    ) -> dict[str, float]:
        """Fit the mean values of a sample, shape (points,), with its weights."""
        from scipy.optimize import leastsq

        origin = self.start if start is None else start
        if not self.free:
            return dict(origin)
        share = np.sqrt(self.weights * weight)
        # a second start, if the iteration does not leave a flat region
        for x0 in (np.zeros(len(self.free)), np.full(len(self.free), 0.3)):
            x, _, _, _, status = leastsq(
                lambda x: self._residual(x, origin, mean, share),
                x0,
                ftol=1e-12,
                xtol=1e-8,
                maxfev=400 * (len(self.free) + 1),
                full_output=True,
            )
            if status in (1, 2, 3, 4):
                return self._parameters(x, origin)
        raise ConvergenceError(
            f"the fit of the family {self.family.name!r} did not converge; fix a parameter that "
            f"the data do not determine ({', '.join(self.free)}), or choose another family"
        )

    def solve_many(
        self, means: np.ndarray, weights: np.ndarray, start: Mapping[str, float]
    ) -> list[dict[str, float] | None]:
        """Fit the means of samples, (samples, points), from the same start; None if one fails."""
        fits: list[dict[str, float] | None] = [None] * len(means)
        for k, (mean, weight) in enumerate(zip(means, weights, strict=True)):
            with suppress(CaseError, ConvergenceError):
                fits[k] = self.solve(mean, weight, start)
        return fits

    def law(self, parameters: Mapping[str, Any]) -> object:
        """Return the law with these parameters."""
        return self.family.make(**{**self.held, **parameters})

    def predict(self, parameters: Mapping[str, Any]) -> np.ndarray:
        """Evaluate the quantity at the conditions, SI."""
        observed = self.observations
        value = QUANTITIES[observed.quantity].predict(self.law(parameters), *observed.conditions)
        return np.asarray(value)

    def _residual(
        self, x: np.ndarray, origin: Mapping[str, float], mean: np.ndarray, share: np.ndarray
    ) -> np.ndarray:
        """Evaluate the terms of (1) before they are squared."""
        parameters = self._parameters(x, origin)
        open_datum = self.observations.quantity == "normal_stiffness"
        try:
            error = share * (self.predict(parameters) - mean) / self.scale
        except CaseError:  # outside the range of the law
            return np.full(mean.size + open_datum, REFUSED)
        if not np.all(np.isfinite(error)):
            error = np.nan_to_num(error, nan=REFUSED, posinf=REFUSED, neginf=-REFUSED)
        if not open_datum:
            return np.asarray(error)
        law, p = self.law(parameters), self.observations.pressure
        last = int(np.argmax(p))
        gap = law.gap_at(p[last : last + 1])  # type: ignore[attr-defined]
        return np.append(error, gap * mean[last] / p[last])

    def _parameters(self, x: np.ndarray, origin: Mapping[str, float]) -> dict[str, float]:
        parameters = {name: float(origin[name]) for name in self.family.parameters}
        for name, step in zip(self.free, x, strict=True):
            parameters[name] = _move(self.family.parameters[name], parameters[name], float(step))
        return parameters


def regression_of(
    family: Family, observations: Observations, fixed: Mapping[str, float], weights: np.ndarray
) -> Regression:
    """Prepare the fit of a family."""
    unknown = set(fixed) - set(family.parameters)
    if unknown:
        raise CaseError(
            f"the family {family.name!r} has no parameter {sorted(unknown)[0]!r} to be fixed; it "
            f"has {', '.join(family.parameters)}"
        )
    if observations.quantity not in family.quantities:
        raise CaseError(
            f"the family {family.name!r} is fitted to {' or '.join(family.quantities)}, not to "
            f"{observations.quantity}"
        )
    free = tuple(name for name in family.parameters if name not in fixed)
    n_points = int(np.count_nonzero(weights))
    if len(free) >= n_points:
        raise CaseError(
            f"the family {family.name!r} has {len(free)} free parameters, but only {n_points} "
            f"points were observed; observe at least {len(free) + 1}, or fix parameters"
        )
    scale = observations.scale
    return Regression(
        family,
        observations,
        np.full(scale.shape, scale.mean()) if family.even else scale,
        weights,
        {name: value for name, (value, _) in family.held(observations).items()},
        free,
        {**family.start(observations), **fixed},
    )


def _move(parameter: Parameter, origin: float, step: float) -> float:
    """Move a parameter from the origin by a step of its free coordinate, inside the range."""
    low, step = parameter.lower, min(max(step, -FARTHEST), FARTHEST)
    if isinf(low):
        return origin + step * (abs(origin) or 1.0)
    return low + max(origin - low, 1e-12 * abs(origin)) * exp(step)


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
    """Fit the parameters of a family and their samples; samples that fail are only counted."""
    regression = regression_of(family, observations, fixed, weights)
    mean = observations.mean
    equal = np.ones(mean.size)  # weights
    best = regression.solve(mean, equal)
    if observations.quantity not in ("gap", "recovery"):
        # errors relative to a measured value that is too small would weigh more, and bias the law
        for _ in range(2):
            regression = replace(regression, scale=regression.predict(best))
            best = regression.solve(mean, equal, best)

    # bootstrap samples
    drawn = _sample_means(observations, regression, best, counts, n_samples, seed)
    fits = regression.solve_many(*drawn, best)
    samples = [fit for fit in fits if fit is not None]
    values: Values = {name: np.array(value) for name, value in best.items()}
    for name in best:
        values[f"{name}_sample"] = np.array([sample[name] for sample in samples])
    values |= {name: np.array(value) for name, value in regression.held.items()}
    errors = _errors(observations, regression, best, mean)
    attributes = errors.attributes | {
        "parameters": " ".join(family.parameters),
        "held": " ".join(regression.held),
        "fixed": " ".join(fixed),
        "n_failed_samples": len(fits) - len(samples),
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
    """Draw the mean values of the samples and their weights, (samples, points)."""
    mean = observations.mean[None]
    if len(counts):
        sample, weight = observations.means(counts)
        return mean + observations.widening * np.where(weight > 0.0, sample - mean, 0.0), weight
    n, k = mean.size, len(regression.free)
    # the points of several specimens are not independent: each is stiffer or softer at all points
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
    """Evaluate the errors of the fit and of fits with a left out point; Akaike's criterion."""
    n, k = mean.size, len(regression.free)
    normal = observations.quantity in ("gap", "normal_stiffness")
    judged = np.arange(1, n - 1) if normal else np.arange(n)
    used = 1.0 - np.eye(n)[judged]
    fits = regression.solve_many(np.tile(mean, (judged.size, 1)), used, best)
    blind = [dict(best) if parameters is None else parameters for parameters in fits]
    fit = (regression.predict(best) - mean) / regression.scale
    total = max(float(np.sum(regression.weights * fit**2)), 1e-24 * n)
    # n ln(R/n) + 2 (k+1) + 2 (k+1)(k+2) / (n-k-2) (1) of weighted residuals, for few points
    criterion = float("nan")
    if n - k - 2 > 0:
        criterion = float(n * np.log(total / n) + 2 * (k + 1) + 2 * (k + 1) * (k + 2) / (n - k - 2))
    attributes = {"akaike_criterion": criterion, "n_parameters": k}
    if normal:
        p, law = observations.pressure, regression.law(best)
        gap = gaps_of(observations, mean)
        laws = [regression.law(parameters) for parameters in blind]
        errors = normal_errors(law, laws, judged, p, gap)
        return FitResult(errors.values, attributes | errors.attributes)
    error = np.array([regression.predict(parameters)[j] for j, parameters in enumerate(blind)])
    error = (error - mean) / regression.scale
    attributes |= {"maximum_fit_error": float(np.max(np.abs(fit))), **unseen_errors(error)}
    return FitResult({"fit_error": error}, attributes)
