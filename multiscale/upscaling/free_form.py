"""The normal law and the area law of free form: non-negative least squares, and their errors."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import AreaLaw, ConvexDecreasing
from multiscale.upscaling.family import gaps_of
from multiscale.upscaling.observations import ALLOWED, TWO_SIDED, Observations, list_pressures

N_TERMS = 40  # default number of knots of a law

RIDGE = 3e-4  # weight of the smoothness of a law, dimensionless

PASSES = 4  # of the fit, each smooth relative to the pass before
HEAD = 0.3  # the first knot lies beyond the largest pressure by this, in its logarithm
TAIL = 7.0  # the last knot lies below the smallest pressure by this, in its logarithm

SECOND_ORDER, FIRST_ORDER = 0.25, 0.5  # remaining share of an error at half the spacing

Values = dict[str, np.ndarray]

FEWEST_PRESSURES = 3
"""Pressures of a normal law of free form; its error follows from the inner pressures."""


def place_knots(
    pressure: np.ndarray, gap: np.ndarray, n_terms: int, largest_gap: float
) -> tuple[np.ndarray, np.ndarray]:
    """Place knots evenly in the logarithm of the pressure, three fifths of them in the data."""
    from scipy.interpolate import PchipInterpolator

    x = np.log(pressure)
    decay = -np.diff(gap) / np.diff(x)
    middle = 0.5 * (x[1:] + x[:-1])
    # beyond, -dg / d ln p ~ p^beta: beta is 0 for an exponential law, 1/m for a power law, so that
    # the last knot comes close to the end of a compact support
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

    The curvature :math:`p''(g)` is linear between the knots, :math:`\theta_k \ge 0` at the knots
    and zero beyond: the law is positive, decreasing, convex and smooth. With the pressure
    :math:`A_{jk}` at :math:`g_j` of a unit curvature at knot k and :math:`\rho =` :data:`RIDGE`,
    the fit minimises

    .. math::
        \sum_j w_j \Big( \frac{1}{p_j} \sum_k A_{jk} \theta_k - 1 \Big)^2
        + \rho^2 \int \Big( \frac{\mathrm{d}^3 \ln \theta}{\mathrm{d} x^3} \Big)^2 \mathrm{d}x,
        \qquad x = \ln p.    \tag{1}
    """
    from scipy.optimize import nnls

    origin, length, unit = knot[0], np.ptp(knot), pressure.max()
    s, g = (knot - origin) / length, (gap - origin) / length
    powers = _curvature_to_powers(s)
    bending = RIDGE * _third_derivative(level[:-1])
    decay = -np.gradient(s, level)[:-1]
    start = np.exp(level[:-1]) / unit / decay**2

    coefficients = np.empty((len(gap), knot.size))
    for sample, (g_sample, counts) in enumerate(zip(g, weight, strict=True)):
        at_data = np.maximum(0.0, s - g_sample[:, None]) ** 3 @ powers  # A_jk
        at_data *= (counts * unit / pressure)[:, None]
        # the second term vanishes for exponential and for power laws
        # (1), linear in the relative change of theta
        theta = start
        for _ in range(PASSES):
            matrix = np.vstack([at_data * theta, bending])
            target = np.concatenate([counts, -bending @ (np.log(theta) - 1.0)])
            change, _ = nnls(matrix, target, maxiter=100 * theta.size)
            theta = theta * np.clip(change, 0.1, 10.0)
        coefficients[sample] = powers @ theta
    # left of the first knot the curvature continues with its slope, but never falls
    coefficients[:, 0] += np.maximum(0.0, -coefficients.sum(axis=1))
    return np.asarray(coefficients * unit / length**3)


def _curvature_to_powers(knot: np.ndarray) -> np.ndarray:
    """Return the coefficients of truncated cubes for a unit curvature at each knot but the last."""
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
    """Assemble the third derivative over x, weighted to the root of its integral."""
    difference = np.eye(x.size)
    for order in (1, 2, 3):
        spacing = (x[:-order] - x[order:]) / order
        difference = np.diff(difference, axis=0) / -spacing[:, None]
    return np.asarray(difference * np.sqrt(spacing)[:, None])


@dataclass(frozen=True, eq=False)
class FitResult:
    """Variables and attributes of the dataset of a fitted law."""

    values: Values
    attributes: dict[str, Any]


def fit_convex_decreasing(
    observations: Observations,
    counts: np.ndarray,
    weights: np.ndarray,
    *,
    n_terms: int,
) -> FitResult:
    """Fit a convex decreasing law and its samples."""
    p, n = observations.pressure, observations.pressure.size
    if n < FEWEST_PRESSURES:
        raise CaseError(
            f"a law of free form needs {FEWEST_PRESSURES} pressures or more, got {n}; measure at "
            f"more pressures"
        )
    # gaps of the mean and of the samples, and knots over all of them
    mean = observations.mean[None]
    sample_mean, sample_weight = observations.means(counts)
    gap, sample_gap = gaps_of(observations, mean), sample_mean
    largest = float(np.nanmax(observations.values))
    if observations.quantity == "normal_stiffness":
        sample_gap = gaps_of(observations, np.where(sample_weight > 0.0, sample_mean, mean))
        largest = float(max(gap.max(), sample_gap.max(initial=0.0)))
    factor = observations.widening
    largest += (factor - 1.0) * (largest - float(gap.max()))
    knot, level = place_knots(p, gap[0], n_terms, largest)

    # the mean law, fits with left out points, and samples spread as Student's
    root = np.sqrt(weights)
    coefficient = fit_spline(p, gap, root[None], knot, level)[0]
    law = ConvexDecreasing(knot, coefficient, pressure_range=(p[0], p[-1]))
    used, judged = left_out(n)
    unseen = fit_spline(p, np.repeat(gap, len(used), axis=0), root * used, knot, level)
    sample_gap = gap + factor * np.where(sample_weight > 0.0, sample_gap - gap, 0.0)
    sample = np.empty((0, n_terms))
    if len(counts):
        seen = root * (sample_weight > 0.0)
        sample = fit_spline(p, sample_gap, seen, knot, level)
    blind = [ConvexDecreasing(knot, row) for row in unseen]
    values = {"knot": knot, "coefficient": coefficient, "coefficient_sample": sample}
    errors = normal_errors(law, blind, judged, p, gap[0])
    ends = {"gap_min": float(gap[0, -1]), "gap_max": float(gap[0, 0])}
    return FitResult(values | errors.values, errors.attributes | ends)


def representable(
    observations: Observations, weights: np.ndarray, *, n_terms: int
) -> tuple[int, list[str]]:
    """Count the pressures, from the lowest on, that a convex law follows; a caution if not all."""
    p = observations.pressure
    _check_falls(p, gaps_of(observations, observations.mean[None])[0])
    if observations.independent:
        return p.size, []
    counted = weights > 0.0
    observations, weights = observations.at(counted), weights[counted]
    p, all_pressures, n, gap = observations.pressure, p, int(counted.sum()), observations.mean
    falls = _softer_above(observations)
    for k in range(2 + int(np.argmax(falls)) if falls.any() else n, 2, -1):
        some = observations.at(slice(k))
        knot, level = place_knots(some.pressure, gap[:k], n_terms, float(gap[0]))
        root = np.sqrt(weights[None, :k])
        law = ConvexDecreasing(knot, fit_spline(some.pressure, gap[None, :k], root, knot, level)[0])
        if some.misses(law, "").missed.any():
            continue
        if k == n:
            return all_pressures.size, []
        # a convex law that ends there has at least the mean stiffness of the interval below
        stiffness = p[k - 1] / observations.scale[k - 1]  # from the gaps on both sides
        if law.stiffness(gap[k - 1]) <= (1.0 + ALLOWED) * stiffness:
            return int(np.sum(all_pressures <= p[k - 1])), [
                f"the law ends at {list_pressures(p[k - 1 : k])}: {list_pressures(p[k:])} are left "
                f"out, since the interface is softer there than any convex law through the "
                f"gaps below"
            ]
    turn = 1 + int(np.argmax(falls))
    raise CaseError(
        f"no convex law follows the gaps at {list_pressures(p)}: from "
        f"{list_pressures(p[turn : turn + 1])} on the stiffness of the interface falls as the "
        f"pressure rises, and fewer than three pressures lie below, too few for a law; "
        f"press the cells at more pressures below"
    )


def _softer_above(observations: Observations) -> np.ndarray:
    """Whether the interface is softer above an inner pressure than below it, and not by chance."""
    steps, mean = -np.diff(observations.values, axis=1), -np.diff(observations.mean)
    finite = np.isfinite(steps)
    n = np.maximum(finite.sum(axis=0), 1)
    spread = np.where(finite, steps - np.where(finite, steps, 0.0).sum(axis=0) / n, 0.0)
    chance = TWO_SIDED * np.sqrt(np.sum(spread**2, axis=0) / np.maximum(n * (n - 1), 1)) / mean
    stiffness = np.diff(observations.pressure) / mean
    allowed = 2.0 * ALLOWED + np.hypot(chance[1:], chance[:-1])
    return np.asarray(stiffness[1:] < (1.0 - allowed) * stiffness[:-1])


def fit_each(observations: Observations, gap: np.ndarray) -> list[ConvexDecreasing]:
    """Fit laws of single realisations, with gaps (realisations, points), m, at all points."""
    p, mean = observations.pressure, observations.mean
    _check_falls(p, mean)
    knot, level = place_knots(p, mean, N_TERMS, float(gap.max()))
    coefficients = fit_spline(p, gap, 1.0 * observations.counted, knot, level)
    return [ConvexDecreasing(knot, row, pressure_range=(p[0], p[-1])) for row in coefficients]


def left_out(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the points that fits use (fits, n), and the left out point of each (fits,)."""
    sets = (range(n), range(0, n, 2), range(1, n, 2))
    fits = [(points, j) for points in sets for j in points[1:-1]]
    used = np.array([[i in points and i != j for i in range(n)] for points, j in fits])
    return used, np.array([j for _, j in fits])


def decay_share(
    error: np.ndarray, n: int, least: float, noise: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return the share of the rms error at unseen points that remains between the points."""
    # A point left out makes a hole of two spacings, every second point a hole of four: e_2 / e_4 is
    # the decay over another halving, with the order limited to 2 for a value, 1 for a derivative.
    # Below five points the share is 1: of four gaps of flat cells over 0.9 to 1.9 decades, against
    # 33, the rms error over e_2 was 0.24 to 0.36 in the median, but 1.7 to 4.5 in a twentieth of
    # the cases.
    finite = np.isfinite(error)
    square = np.where(finite, error**2 - noise, 0.0)
    holes = slice(n - 2), slice(n - 2, None)  # of two spacings, and of four
    count = [max(np.count_nonzero(finite[hole]), 1) for hole in holes]
    e2, e4 = (max(square[hole].sum() / m, 0.0) for hole, m in zip(holes, count, strict=True))
    raw = np.sum(error[: n - 2][finite[: n - 2]] ** 2) / count[0]
    decay = np.clip(np.sqrt(e2 / e4), least, 1.0) if e4 > 0.0 else 1.0
    return np.asarray(decay * np.sqrt(e2 / raw) if raw > 0.0 else decay)


def normal_errors(
    law: Any, blind: list[Any], judged: np.ndarray, pressure: np.ndarray, gap: np.ndarray
) -> FitResult:
    """Evaluate errors of a normal law at its data, and of fits at left out points."""
    n = len(gap)
    p, k, g = np.array(
        [
            (
                fit.pressure(gap[j]) / pressure[j] - 1.0,
                fit.stiffness(gap[j]) / law.stiffness(gap[j]) - 1.0,
                (fit.gap_at(pressure[j]) - gap[j]) / max(abs(gap[j]), 1e-300),
            )
            for fit, j in zip(blind, judged, strict=True)
        ]
    ).T
    attributes = {
        "maximum_fit_error": float(np.max(np.abs(law.pressure(gap) / pressure - 1.0))),
        "cross_validated_error": float(np.nanmax(np.abs(p[: n - 2]))),
        "cross_validated_stiffness_error": float(np.nanmax(np.abs(k[: n - 2]))),
        "cross_validated_rms_error": float(np.sqrt(np.nanmean(p[: n - 2] ** 2))),
    }
    values = {
        "fit_error": at_inner(g, n),
        "stiffness_fit_error": at_inner(k, n),
        "gap_fit_share": decay_share(g, n, SECOND_ORDER),
        "stiffness_fit_share": decay_share(k, n, FIRST_ORDER),
    }
    return FitResult(values, attributes)


def at_inner(error: np.ndarray, n: int) -> np.ndarray:
    """Return the errors at all n points of fits that leave each out: NaN at the ends."""
    return np.pad(error[: n - 2], 1, constant_values=np.nan)


def _check_falls(p: np.ndarray, gap: np.ndarray) -> None:
    """Refuse gaps that no decreasing law has."""
    if not np.all(np.diff(gap) < 0.0):
        at = int(np.argmax(np.diff(gap) >= 0.0))
        raise CaseError(
            f"the mean gap does not fall from {p[at]:.3g} to {p[at + 1]:.3g} Pa "
            f"({gap[at]:.3g} to {gap[at + 1]:.3g} m), so no decreasing law fits; "
            f"lower the pressures if contact is full there, or use more realisations"
        )
    if gap[0] - gap[-1] < 1e-9 * gap[0]:
        raise CaseError(
            f"the mean gap of {gap[0]:.3g} m changes by only {gap[0] - gap[-1]:.1g} m "
            f"over all pressures, which may be rounding; raise the pressures"
        )


def fit_area(observations: Observations, counts: np.ndarray) -> Values:
    """Fit an area law of free form and its samples: mean fractions that never fall."""
    p, mean = observations.pressure, observations.mean[None]
    sample_mean, sample_weight = observations.means(counts)
    factor = observations.widening
    sample_mean = mean + factor * np.where(sample_weight > 0.0, sample_mean - mean, 0.0)
    fraction = _never_decreasing(mean)[0]
    # errors at left out points, and the variance of their noise by single cells
    used, judged = left_out(p.size)
    singles = [np.where(np.isfinite(a), a, mean) for a, _ in observations.ensembles]
    error, noise, x = np.full(judged.size, np.nan), np.zeros(judged.size), np.log(p)
    for k, (seen, j) in enumerate(zip(used, judged, strict=True)):
        if fraction[j] > 0.0:
            blind = AreaLaw(p[seen], fraction[seen]).contact_fraction(p[j])
            error[k] = blind / fraction[j] - 1.0
            below, above = np.flatnonzero(seen[:j])[-1], j + 1 + np.flatnonzero(seen[j + 1 :])[0]
            w = (x[j] - x[below]) / (x[above] - x[below])
            for single in singles:
                between = (1.0 - w) * single[:, below] + w * single[:, above] - single[:, j]
                noise[k] += np.var(between / fraction[j]) / max(len(single) - 1, 1)
    return {
        "area_pressure": p,
        "area_fraction": fraction,
        "area_fraction_sample": _never_decreasing(sample_mean),
        "area_fit_error": at_inner(error, p.size),
        "area_fit_share": decay_share(error, p.size, SECOND_ORDER, noise),
    }


def unseen_errors(error: np.ndarray) -> dict[str, Any]:
    """Return the largest and the root mean square error at left out points, without NaN."""
    finite = error[np.isfinite(error)]
    if not finite.size:
        return {}
    return {
        "cross_validated_error": float(np.max(np.abs(finite))),
        "cross_validated_rms_error": float(np.sqrt(np.mean(finite**2))),
    }


def _never_decreasing(fractions: np.ndarray) -> np.ndarray:
    """Return the closest contact fractions by rows that never decrease, between 0 and 1."""
    from scipy.optimize import isotonic_regression

    fitted = fractions.copy()
    for row in np.flatnonzero(np.any(np.diff(fractions, axis=1) < 0.0, axis=1)):
        fitted[row] = isotonic_regression(fractions[row]).x
    return np.asarray(np.clip(fitted, 0.0, 1.0))
