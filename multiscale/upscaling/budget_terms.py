"""The terms of an error budget, each from computed quantities: half-widths over the value.

Every function returns an array of shape (3, steps): gap, contact fraction and stiffness.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.upscaling.observations import (
    Observations,
    area_observations,
    normal_observations,
)
from multiscale.upscaling.reading import area_from_dataset, law_band, law_from_dataset
from multiscale.upscaling.resolution import LOWEST_ORDER, SAFETY, estimate_grid_error
from multiscale.upscaling.scales import ScaleSeparation
from multiscale.upscaling.statistics import ensemble_average

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "NORMAL",
    "each_value",
    "fit_term",
    "grid_term",
    "increment_term",
    "law_stiffness",
    "pooled_sampling_term",
    "same_steps",
    "sampling_term",
    "separation_term",
    "students",
]

FREE_NORMAL = "convex_decreasing"
NORMAL = 1.959963984540054  # standard deviations to 95 %


def law_stiffness(law: "xr.Dataset", pressure: np.ndarray) -> np.ndarray:
    """Stiffness of the mean law, Pa/m."""
    one = law_from_dataset(law)
    return one.stiffness(one.gap_at(pressure))


def sampling_term(
    response: "xr.Dataset", law: "xr.Dataset", p: np.ndarray
) -> tuple[np.ndarray, float]:
    """Half-widths from the scatter of the realisations, and what they are of it."""
    from scipy.stats import t

    rows = []
    for variable in ("mean_gap", "contact_fraction"):
        average = ensemble_average(response, variable)
        rows.append(average.half_width / np.abs(average.mean))
    stiffness = np.full(p.size, np.nan)
    try:
        low, high = law_band(law, lambda one: one.stiffness(one.gap_at(p)))
        stiffness = 0.5 * (high - low) / law_stiffness(law, p)
    except CaseError:  # too few realisations or samples for a band
        pass
    n = average.n.max()
    return np.array([*rows, stiffness]), float(t.ppf(0.975, max(n - 1, 1)) / np.sqrt(n))


def pooled_sampling_term(
    response: "xr.Dataset", sizes: Mapping[float, "xr.Dataset"]
) -> tuple[np.ndarray, float]:
    r"""Half-widths from the scatter of the realisations and of cells of other sizes.

    The coefficient of variation falls as :math:`1/L`, see :func:`size_trend`, so that with
    :math:`\nu_i = N_i - 1` and the sizes :math:`r_i` relative to the response

    .. math:: \mathrm{CoV}^2 = \frac{\sum_i \nu_i\, (r_i\, \mathrm{CoV}_i)^2}{\sum_i \nu_i},
        \qquad w = t_{0.975,\, \sum \nu_i}\, \mathrm{CoV} / \sqrt{N_0}.
    """
    from scipy.stats import t

    own, found = same_steps(response, sizes, apart=True)
    freedom, square = 0, np.zeros((3, own[0].pressure.size))
    for ratio, pair in [(1.0, own), *found.items()]:
        n = pair[0].n_realisations
        if n < 2:
            continue
        values = np.array([one[1.0] for one in each_value({1.0: pair})])
        cov = np.nanstd(values, axis=1, ddof=1) / np.abs(np.nanmean(values, axis=1))
        square += (n - 1) * (ratio * cov) ** 2
        freedom += n - 1
    if not freedom:
        return np.full(square.shape, np.nan), np.nan
    factor = float(t.ppf(0.975, freedom) / np.sqrt(own[0].n_realisations))
    return np.asarray(factor * np.sqrt(square / freedom)), factor


def fit_term(law: "xr.Dataset", p: np.ndarray) -> np.ndarray:
    """Half-widths from the errors at steps that the fit has not seen.

    Areas and gaps of free form are interpolated, to the second order at least, and leaving one out
    doubles the spacing, so that a fourth is left between the data. A stiffness is a derivative: a
    half is left, or the error of the step itself. At the ends of the data nothing holds its slope,
    and it is as unsure as it departs from the power law through the two steps next to it.
    """
    free = law.attrs.get("family", FREE_NORMAL) == FREE_NORMAL
    shares = {"fit_error": 0.25 if free else 1.0, "area_fit_error": 0.25}
    rows = []
    for name, share in (shares | {"stiffness_fit_error": 0.5 if free else 1.0}).items():
        error = law[name].to_numpy() if name in law else np.full(p.size, np.nan)
        known = error[np.isfinite(error)]
        rms = np.sqrt(np.mean(known**2)) if known.size else np.nan
        rows.append(np.full(p.size, NORMAL * share * rms))
    own = NORMAL * np.abs(error)
    own[[0, -1]] = [_end_error(np.log(law_stiffness(law, p)), np.log(p), k) for k in (1, -1)]
    rows[2] = np.fmax(rows[2], own)
    return np.array(rows)


def _end_error(value: np.ndarray, x: np.ndarray, step: int) -> float:
    """Distance of the first (step 1) or last (-1) value from the line through the next two."""
    end, near, far = (0, 1, 2) if step > 0 else (-1, -2, -3)
    slope = (value[near] - value[far]) / (x[near] - x[far])
    return float(abs(value[end] - value[near] - slope * (x[end] - x[near])))


Pair = tuple[Observations, Observations]  # of gaps and of areas


def same_steps(
    response: "xr.Dataset", others: Mapping[float, "xr.Dataset"], *, apart: bool
) -> tuple[Pair, dict[float, Pair]]:
    """Gaps and areas of a response, and of all that are compared, which were pressed alike."""
    own = normal_observations(response), area_observations(response)
    if apart and len(others) < 2:
        raise CaseError(
            f"ensembles apart from the response are compared among themselves, so that two are "
            f"needed, got {len(others)}"
        )
    found = {} if apart else {1.0: own}
    for ratio, other in others.items():
        found[ratio] = normal_observations(other), area_observations(other)
        p = found[ratio][0].pressure
        if p.size != own[0].pressure.size or not np.allclose(p, own[0].pressure, rtol=1e-6):
            raise CaseError(
                f"the response at the ratio {ratio:g} has other pressures; press it as the first"
            )
    return own, found


def _stiffness_of(gap: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Stiffness from differences of gaps (..., steps), Pa/m: to compare ensembles only."""
    return np.asarray(-p / np.gradient(gap, np.log(p), axis=-1))


def each_value(pairs: Mapping[float, Pair]) -> list[dict[float, np.ndarray]]:
    """Values (realisations, steps) of gap, area and stiffness by ratio; NaN where missing."""
    gaps = {ratio: _masked(gap) for ratio, (gap, _) in pairs.items()}
    stiffness = {
        ratio: _stiffness_of(gaps[ratio], gap.pressure) for ratio, (gap, _) in pairs.items()
    }
    return [gaps, {ratio: _masked(area) for ratio, (_, area) in pairs.items()}, stiffness]


def grid_term(
    response: "xr.Dataset", resolutions: Mapping[float, "xr.Dataset"], *, apart: bool = False
) -> tuple[np.ndarray, str]:
    """Half-widths from the same realisations on several grids, at the spacing of the response.

    The error at the spacing of the response, or at the spacing compared that is nearest to it, is
    its difference to the finest grid, which was solved, and what the finest grid leaves by the
    order observed, or the lowest. The mean difference of few realisations may pass through zero:
    the interval of the differences is added, and its variance taken out of the square of the mean,
    which holds it.
    """
    _, found = same_steps(response, resolutions, apart=apart)
    finest, next_finest = sorted(found)[:2]
    n = {ratio: gap.n_realisations for ratio, (gap, _) in found.items()}
    for ratio in found:
        if n[ratio] != n[finest]:
            raise CaseError(
                f"the response at the ratio {ratio:g} has {n[ratio]} realisations, not "
                f"{n[finest]}; solve the same ones on every grid"
            )
    near = min(found, key=lambda ratio: abs(np.log(ratio)))
    rows, how = [], ""
    for values in each_value(found):
        mean = {ratio / finest: np.nanmean(one, axis=0) for ratio, one in values.items()}
        size = np.abs(mean[1.0])
        estimate = estimate_grid_error(mean.pop(1.0), mean)
        order = estimate.order if np.isfinite(estimate.order) else LOWEST_ORDER
        solved = values[near] - values[finest]
        error = solved + (values[next_finest] - values[finest]) / (
            (next_finest / finest) ** order - 1.0
        )
        variance = np.nanvar(error, axis=0) / max(n[finest] - 1, 1)
        spread = students(variance[None], np.array([[n[finest] - 1]]))
        square = np.nanmean(error, axis=0) ** 2
        sure = np.sqrt(np.maximum(square - variance, 0.0) / np.maximum(square, 1e-300))
        half = SAFETY * np.abs(np.nanmean(solved, axis=0)) + estimate.half_width
        rows.append(near**-order * np.hypot(sure * half, spread) / size)
        how = how or estimate.how
    return np.array(rows), how


def increment_term(response: "xr.Dataset") -> tuple[np.ndarray, str]:
    """Half-widths from the increments of a body that flows, and how they were told."""
    gap = normal_observations(response)
    error, area = (
        response[f"{name}_increment_error"].to_numpy()[gap.order]
        for name in ("mean_gap", "contact_fraction")
    )
    mean = np.nanmean(_masked(gap), axis=0)
    slope = _stiffness_of(mean * (1.0 + error), gap.pressure) / _stiffness_of(mean, gap.pressure)
    term = SAFETY * np.abs([error, area, slope - 1.0])
    worst = ", ".join(f"{100.0 * one:.2g} %" for one in term.max(axis=1))
    return term, f"increments, halved in one realisation: up to {worst} of gap, area and stiffness"


def students(variances: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """95 % half-width of a sum of terms with variances (terms, steps) and freedoms (terms, 1).

    The freedom of the sum is that of Welch and Satterthwaite.
    """
    from scipy.stats import t

    total = np.maximum(variances.sum(axis=0), 0.0)
    single = np.sum(variances**2 / np.maximum(freedom, 1), axis=0)
    whole = np.where(single > 0.0, total**2 / np.where(single > 0.0, single, 1.0), np.inf)
    factor = t.ppf(0.975, np.maximum(whole, 1.0))
    return np.asarray(np.where(np.isfinite(whole), factor, NORMAL) * np.sqrt(total))


def _masked(observations: Observations) -> np.ndarray:
    """Values with NaN where there are none."""
    return np.where(observations.counted, observations.values, np.nan)


def separation_term(
    law: "xr.Dataset", scatter: np.ndarray, p: np.ndarray, scales: ScaleSeparation
) -> np.ndarray:
    """Half-widths from uneven pressure and from the few cells that one structure holds.

    The scatter is the coefficient of variation of single cells, (3, steps); what is not finite,
    as that of one realisation, counts as none.
    """
    mean_law, area_law = law_from_dataset(law), area_from_dataset(law)
    functions: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
        mean_law.gap_at,
        area_law.contact_fraction,
        lambda q: mean_law.stiffness(mean_law.gap_at(q)),
    )
    step, rows = 0.05, []
    for evaluate, cov in zip(functions, np.nan_to_num(scatter, posinf=0.0), strict=True):
        low, middle, high = (evaluate(p * np.exp(s)) for s in (-step, 0.0, step))
        first = (high - low) / (2.0 * step)  # d/d ln p
        second = (high - 2.0 * middle + low) / step**2
        uneven = 0.5 * np.abs(second - first) * scales.wavelength_ratio**2 / 12.0  # p^2 f''
        rows.append(np.hypot(uneven / np.abs(middle), NORMAL * cov * scales.cell_ratio))
    return np.array(rows)
