"""From the response of many cells to an interface law with its uncertainty."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import AreaLaw, ConvexDecreasing
from multiscale.schema import INTERFACE_LAW, MICRO_RESPONSE
from multiscale.upscaling.admissibility import is_admissible
from multiscale.upscaling.spline import fit_spline, place_knots

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["area_from_dataset", "fit_law", "law_from_dataset"]

FEWEST_REALISATIONS = 3
"""Below, the interval of a mean is too wide to be of use and there are no samples."""

_OWN_ATTRIBUTES = frozenset({"schema", "schema_version", "Conventions", "source", "history"})


def fit_law(
    response: "xr.Dataset",
    *,
    n_terms: int = 20,
    n_samples: int = 200,
    ridge: float = 3e-4,
    seed: int = 0,
) -> "xr.Dataset":
    r"""Fit a normal law and an area law to the response of an ensemble of cells.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``; realisations loaded to the same pressures. Failed steps
        (``converged`` 0 or NaN) are left out, and a pressure that no realisation reached with them.
    n_terms : int
        Number of knots of the normal law, at least 6.
    n_samples : int
        Number of bootstrap samples. With fewer than three realisations the scatter is not
        known, and the dimension ``sample`` has size 0.
    ridge : float
        Weight of the smoothness of the law, dimensionless; see :func:`fit_spline`. Larger is
        smoother: less noise in the stiffness at the ends of the data, more bias.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    Dataset
        Follows ``INTERFACE_LAW``. Attributes: ``family``, ``n_realisations``, ``n_samples``,
        ``pressure_min``, ``pressure_max`` (Pa), ``gap_min``, ``gap_max`` (m) of the data, the
        errors of the fit below (1), ``admissible`` (1 or 0), ``seed``, ``ridge``, ``uncertainty``
        (a sentence), and what the response says of the surface.

        - ``maximum_fit_error``: largest relative pressure error at the data;
        - ``cross_validated_error``: the largest at a pressure that the fit has not seen. The
          first and the last pressure are always seen, as leaving them out is extrapolation;
        - ``cross_validated_stiffness_error``: the same for the stiffness, against the full fit.

    Raises
    ------
    CaseError
        If fewer than three pressures are usable, or the mean gap does not fall as they rise.
    SchemaError
        If the response does not follow its schema.

    Notes
    -----
    The law is that of :class:`~multiscale.laws.ConvexDecreasing`. Its knots are even in the
    logarithm of the pressure and common to all samples. With 8 noise-free pressures it returns
    exponential, power, Greenwood-Williamson and Westergaard laws (up to half the pressure of
    complete contact) with less than 0.2 % error of pressure and 2 % of stiffness over the whole
    range of the data. Outside this range the law extrapolates. Where the stiffness tends to
    infinity, as at complete contact, its error grows.

    The bootstrap resamples whole realisations with replacement, since the steps of one are
    correlated; the samples are spread by the factor of :func:`_widening` so that 95 % intervals
    keep their promise for few realisations. The bands tell the sampling error, not that of the
    model.

    References
    ----------
    .. [1] B. Efron and R. J. Tibshirani, An Introduction to the Bootstrap, Chapman & Hall, 1993.
    """
    if n_terms < 6:
        raise CaseError(f"a normal law needs at least 6 terms, got n_terms = {n_terms}")
    if not (n_samples >= 0 and ridge > 0.0):
        raise CaseError(
            f"n_samples must not be negative and ridge must be positive, got {n_samples} "
            f"and {ridge:g}"
        )
    MICRO_RESPONSE.check(response)
    data = _usable(response)
    p, n = data.pressure, data.pressure.size
    gap, area, _ = _means(data, np.ones((1, len(data.counted))))
    if not np.all(np.diff(gap[0]) < 0.0):
        at = int(np.argmax(np.diff(gap[0]) >= 0.0))
        raise CaseError(
            f"the mean gap does not fall from {p[at]:.3g} to {p[at + 1]:.3g} Pa "
            f"({gap[0, at]:.3g} to {gap[0, at + 1]:.3g} m), so that no decreasing law fits; "
            f"lower the pressures if contact is full there (contact fraction "
            f"{area[0, at + 1]:.2g}), or use more realisations"
        )
    if gap[0, 0] - gap[0, -1] < 1e-9 * gap[0, 0]:
        raise CaseError(
            f"the mean gap of {gap[0, 0]:.3g} m changes by only {gap[0, 0] - gap[0, -1]:.1g} m "
            f"over all pressures, which rounding may have made; raise the pressures"
        )
    largest = float(np.max(data.gap[data.counted]))
    largest += (_widening(len(data.counted)) - 1.0) * (largest - float(gap.max()))
    knot, level = place_knots(p, gap[0], n_terms, largest)

    coefficient = fit_spline(p, gap, np.ones((1, n)), knot, level, ridge=ridge)[0]
    unseen = fit_spline(p, np.repeat(gap, n, axis=0), 1 - np.eye(n), knot, level, ridge=ridge)
    law = ConvexDecreasing(knot, coefficient, pressure_range=(p[0], p[-1]))

    counts = _bootstrap_counts(len(data.counted), n_samples, seed)
    sample_gap, sample_area, sample_weight = _means(data, counts)
    widening = _widening(len(data.counted))
    sample_gap = gap + widening * np.where(sample_weight > 0.0, sample_gap - gap, 0.0)
    sample_area = area + widening * np.where(sample_weight > 0.0, sample_area - area, 0.0)
    sample = np.empty((0, n_terms))
    if len(counts):
        sample = fit_spline(p, sample_gap, sample_weight, knot, level, ridge=ridge)

    attributes = {
        **_inherited(response),
        **_fit_errors(law, unseen, p, gap[0]),
        "family": "convex_decreasing",
        "n_realisations": len(data.counted),
        "n_samples": len(counts),
        "uncertainty": "bootstrap over realisations"
        if len(counts)
        else "none: too few realisations or no samples asked for, so the scatter is not known",
        "seed": seed,
        "ridge": ridge,
        "pressure_min": float(p[0]),
        "pressure_max": float(p[-1]),
        "gap_min": float(gap[0, -1]),
        "gap_max": float(gap[0, 0]),
        "admissible": int(is_admissible(law, (p[0], p[-1]))),
    }
    return INTERFACE_LAW.build(
        {
            "knot": knot,
            "coefficient": coefficient,
            "coefficient_sample": sample,
            "area_pressure": p,
            "area_fraction": _never_decreasing(area)[0],
            "area_fraction_sample": _never_decreasing(sample_area),
            "fit_pressure": p,
            "fit_mean_gap": gap[0],
        },
        **attributes,
    )


def _inherited(response: "xr.Dataset") -> dict[str, str | float | int]:
    """Attributes of the response that tell about the surface, as netCDF takes them."""
    plain = {
        name: value.item() if isinstance(value, np.number) else value
        for name, value in response.attrs.items()
        if name not in _OWN_ATTRIBUTES
    }
    return {name: value for name, value in plain.items() if isinstance(value, str | int | float)}


def _fit_errors(
    law: ConvexDecreasing, unseen: np.ndarray, pressure: np.ndarray, gap: np.ndarray
) -> dict[str, float]:
    """Largest relative errors; row j of ``unseen`` are the coefficients without pressure j."""
    inner = range(1, len(gap) - 1)
    blind = [ConvexDecreasing(law.knot, unseen[j]) for j in inner]
    p = np.array([other.pressure(gap[j]) for j, other in zip(inner, blind, strict=True)])
    k = np.array([other.stiffness(gap[j]) for j, other in zip(inner, blind, strict=True)])
    return {
        "maximum_fit_error": float(np.max(np.abs(law.pressure(gap) / pressure - 1.0))),
        "cross_validated_error": float(np.max(np.abs(p / pressure[1:-1] - 1.0))),
        "cross_validated_stiffness_error": float(
            np.max(np.abs(k / law.stiffness(gap[1:-1]) - 1.0))
        ),
    }


def law_from_dataset(
    dataset: "xr.Dataset", sample: int | None = None, *, gap: float = 0.0
) -> ConvexDecreasing:
    """Make the normal law of a dataset.

    Parameters
    ----------
    dataset : Dataset
        Follows ``INTERFACE_LAW``.
    sample : int, optional
        Which bootstrap sample; the mean law if not given.
    gap : float, default 0.0
        Initial gap between the mean planes, m.
    """
    INTERFACE_LAW.check(dataset)
    family = dataset.attrs.get("family", "convex_decreasing")
    if family != "convex_decreasing":
        raise CaseError(f"the law is of the family {family!r}, expected 'convex_decreasing'")
    return ConvexDecreasing(
        dataset["knot"].to_numpy(),
        _pick(dataset, "coefficient", sample),
        gap=gap,
        pressure_range=(
            float(dataset.attrs.get("pressure_min", 0.0)),
            float(dataset.attrs.get("pressure_max", np.inf)),
        ),
    )


def area_from_dataset(dataset: "xr.Dataset", sample: int | None = None) -> AreaLaw:
    """Make the area law of a dataset; arguments as for :func:`law_from_dataset`."""
    INTERFACE_LAW.check(dataset)
    return AreaLaw(dataset["area_pressure"].to_numpy(), _pick(dataset, "area_fraction", sample))


def _pick(dataset: "xr.Dataset", name: str, sample: int | None) -> np.ndarray:
    """Values of the mean law or of one sample."""
    if sample is None:
        return np.asarray(dataset[name].to_numpy())
    n_samples = dataset.sizes["sample"]
    if not 0 <= sample < n_samples:
        raise CaseError(f"the law has no sample {sample}; it has {n_samples}, counted from 0")
    return np.asarray(dataset[f"{name}_sample"].to_numpy()[sample])


@dataclass(frozen=True)
class _Data:
    """Pressures (steps,), Pa, rising; gap, m, area and counted are (realisations, steps)."""

    pressure: np.ndarray
    gap: np.ndarray
    area: np.ndarray
    counted: np.ndarray


def _usable(response: "xr.Dataset") -> _Data:
    """Plain arrays of the steps and realisations that can be used, pressures rising."""
    gap, area = response["mean_gap"].to_numpy(), response["contact_fraction"].to_numpy()
    own = -response["traction"].sel(component="n").to_numpy()
    counted = (response["converged"].to_numpy() == 1) & np.isfinite(gap) & np.isfinite(area)
    counted &= np.isfinite(own)
    total = counted.sum(axis=0)
    if "nominal_pressure" in response.variables:
        pressure = response["nominal_pressure"].to_numpy()
    else:
        pressure = np.where(counted, own, 0.0).sum(axis=0) / np.maximum(total, 1)
    steps = np.flatnonzero((total > 0) & (pressure > 0.0))
    steps = steps[np.argsort(pressure[steps])]
    if steps.size < 3:
        raise CaseError(
            f"a law needs at least 3 pressures with a converged realisation, found {steps.size} "
            f"of {gap.shape[1]}; solve more steps or look why they failed"
        )
    pressure = pressure[steps]
    if not np.all(np.diff(pressure) > 1e-9 * pressure[1:]):
        raise CaseError(
            "a nominal pressure occurs twice in the response; a law is fitted to one loading "
            "branch, so select its steps first"
        )
    kept = counted[:, steps].any(axis=1)
    return _Data(pressure, *(array[np.ix_(kept, steps)] for array in (gap, area, counted)))


def _means(data: _Data, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean gap and area of samples given by counts (samples, realisations); weight 1 or 0."""
    total = counts @ data.counted
    share = np.maximum(total, 1)
    gap = counts @ np.where(data.counted, data.gap, 0.0) / share
    area = counts @ np.where(data.counted, data.area, 0.0) / share
    return gap, area, (total > 0).astype(float)


def _bootstrap_counts(n_realisations: int, n_samples: int, seed: int) -> np.ndarray:
    """How often each realisation occurs in each sample, (samples, realisations)."""
    if n_realisations < FEWEST_REALISATIONS:
        return np.empty((0, n_realisations))
    random = np.random.default_rng(seed)
    return random.multinomial(
        n_realisations, np.full(n_realisations, 1.0 / n_realisations), size=n_samples
    ).astype(float)


def _widening(n_realisations: int) -> float:
    r"""Factor that gives the percentile interval of few realisations the width of Student's.

    The bootstrap knows the variance with divisor N and takes it for exact:
    :math:`\sqrt{N/(N-1)}\, t_{0.975,\,N-1} / z_{0.975}`.
    """
    from scipy.stats import norm, t

    n = max(n_realisations, 2)
    return float(np.sqrt(n / (n - 1.0)) * t.ppf(0.975, n - 1) / norm.ppf(0.975))


def _never_decreasing(fractions: np.ndarray) -> np.ndarray:
    """Closest contact fractions, row by row, that never decrease and lie between 0 and 1."""
    from scipy.optimize import isotonic_regression

    fitted = fractions.copy()
    for row in np.flatnonzero(np.any(np.diff(fractions, axis=1) < 0.0, axis=1)):
        fitted[row] = isotonic_regression(fractions[row]).x
    return np.asarray(np.clip(fitted, 0.0, 1.0))
