"""The error budget of a law: half-widths over gap, contact fraction and stiffness, (3, steps)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import ERROR_BUDGET, INTERFACE_LAW, Dataset
from multiscale.upscaling.budget import (
    ERROR_TERMS,
    FEW_CELLS,
    LOWEST_ORDER,
    MODEL,
    NO_PART,
    NO_STATED,
    NORMAL,
    SAFETY,
    STATED,
    Term,
    add_terms,
    assemble_budget,
    estimate_grid_error,
    how_attribute,
    of_this_version,
)
from multiscale.upscaling.fit import stiffness_of_each
from multiscale.upscaling.reading import area_from_dataset, law_from_dataset, require_law
from multiscale.upscaling.response_observations import (
    area_observations,
    normal_observations,
    up_to_limit,
)
from multiscale.upscaling.sampling import student
from multiscale.upscaling.scales import ScaleSeparation, surface_term
from multiscale.upscaling.shear_budget import NORMAL_ALONE, STEEPEST, tangential_terms

FIT_ERRORS = {
    "fit_error": "gap_fit_share",
    "area_fit_error": "area_fit_share",
    "stiffness_fit_error": "stiffness_fit_share",
}
"""From the errors at left out points to the shares that remain between points."""

FEWEST_UNSEEN = 3  # errors at left out points: five pressures have so many

GROWTH = 10.0  # largest of differences from interval to interval that can be continued

DISCREPANCY, EXPONENT = 0.1, 0.05
"""Default half-widths of level and exponent of the stiffness of joints about the law of their
cells."""

LAW_QUANTITIES = ("mean_gap", "contact_fraction", "stiffness")


def error_budget(
    response: Dataset,
    law: Dataset,
    *,
    resolutions: Mapping[float, Dataset] | None = None,
    scales: ScaleSeparation | None = None,
    tangential: Mapping[float, Dataset] | None = None,
    control: Dataset | None = None,
    discrepancy: float | None = None,
    known: Mapping[str, Term] = {},
) -> Dataset:
    r"""Estimate the errors of the gap, the contact fraction and the stiffness of a law.

    Parameters
    ----------
    response : Dataset, follows ``MICRO_RESPONSE``
    law : Dataset, follows ``INTERFACE_LAW``; fitted to the response by :func:`fit_law`
    resolutions : mapping of float to Dataset, optional
        From the ratio of the spacings (coarser over response: 2, or 2 and 4) to the response of
        the same realisations on a coarser grid. With a ratio of 1 they are compared among
        themselves, such as the same small cells on several grids.
    scales : ScaleSeparation, optional, from :func:`compare_scales`
    tangential : mapping of float to Dataset, optional
        If given, the tangential traction of the law, over full slip, has a budget too; see
        :func:`~.shear_budget.tangential_terms`. From the ratio of the spacings to the law of the
        same realisations, pressed and sheared on a coarser grid, and under 1 of these realisations
        on the grid of the law; may be empty.
    control : Dataset, optional, as of :func:`fit_law`
    discrepancy : float, optional
        Half-width of the 95 % interval of the stiffness of joints about the law of their cells, and
        of its exponent half as much; :data:`DISCREPANCY` if not given, 0 for none.
    known : mapping of str to Term, optional
        Terms that are known otherwise.

    Returns
    -------
    Dataset
        Follows ``ERROR_BUDGET``: half-widths of 95 % intervals relative to the value, for each
        quantity, term and step of the law; NaN for a term without data. A bias, answer minus truth,
        is zero if its sign is unknown, and never subtracted. The total contains :data:`ALWAYS` and
        every term with data; the attribute ``unknown`` lists the unknown terms, and ``how_...``
        describes the estimate of each term, or the missing data. A term that cannot be computed
        from the data, such as the sampling of a single realisation, makes the total unknown, NaN,
        at its quantity and step.

    Raises
    ------
    CaseError
        If the law does not belong to the response, or a response has other steps.

    Notes
    -----
    Terms are independent of each other. With the sum :math:`b` of the biases and the standard
    deviation :math:`s` from the root of the sum of the squares of the half-widths about them, the
    total :math:`w` is such that :math:`|b + s\, \mathcal{N}(0, 1)| \le w` with a probability of
    95 %; without a bias it equals the root.
    """
    INTERFACE_LAW.check(law)
    response = up_to_limit(response, law)
    control = None if control is None else up_to_limit(control, law)
    resolutions = {ratio: up_to_limit(grid, law) for ratio, grid in (resolutions or {}).items()}
    known = {name: term.at(slice(law.sizes["step"])) for name, term in known.items()}
    gap = normal_observations(response, control)
    p = gap.pressure
    if law.sizes["step"] != p.size or not np.allclose(law["fit_pressure"], p, rtol=1e-6):
        raise CaseError(
            f"the law was fitted at {law.sizes['step']} pressures that are not the {p.size} of the "
            f"response; fit it to this response"
        )
    sampling = sampling_term(response, law, control)
    how = f"Student's interval of {gap.n_realisations} realisations"
    if gap.control is not None:
        how += f" with {gap.control}"
    elif control is not None:
        how += " only, since they and the control cells follow each other by chance"
    if not np.any(np.isfinite(sampling.half_width)):
        how = "not known: a single realisation has no scatter, solve 3"
    # terms without further data, then the terms of the given data
    terms = {
        "sampling": Term(how, sampling.half_width),
        "fit": Term("error at pressures that are left out of the fit", fit_term(law, p)),
        "cell size": Term("not known: cells of one size were solved"),
        "micro discretisation": Term(
            "not known: pass resolutions, the same realisations on coarser grids"
        ),
        "increments": increment_term(response),
        "small slopes": slope_term(response),
        "surface": surface_term(response, law, p),
        "friction bed": NORMAL_ALONE,
        "scale separation": Term("not known: pass scales from compare_scales"),
        FEW_CELLS: NO_PART,
        MODEL: discrepancy_term(law, p, DISCREPANCY if discrepancy is None else discrepancy),
        STATED: NO_STATED,
        "macro discretisation": Term("not in a law: see propagate"),
    }
    if resolutions:
        terms["micro discretisation"] = grid_term(response, resolutions)
    terms |= known
    if scales is not None:
        terms["scale separation"] = Term(str(scales), separation_term(law, p, scales))
        few = scatter_term(sampling.scatter, scales)
        terms[FEW_CELLS] = Term(scales.count_cells(), few)
    if tangential is None:
        budget = assemble_budget(terms, LAW_QUANTITIES, p)
    else:
        rows = (*LAW_QUANTITIES, "tangential_traction")
        budget = assemble_budget(tangential_terms(terms, law, p, tangential), rows, p)
    scatter = np.full((budget.sizes["quantity"], p.size), np.nan)
    scatter[:3] = sampling.scatter
    return ERROR_BUDGET.assign(budget, {"cell_scatter": scatter})


@dataclass(frozen=True, eq=False)
class Sampling:
    """Half-widths (3, steps) by the sampling of realisations, and the scatter of single cells."""

    half_width: np.ndarray
    scatter: np.ndarray


def sampling_term(response: Dataset, law: Dataset, control: Dataset | None = None) -> Sampling:
    """Estimate the half-widths by Student's interval of mean gap, contact fraction and 1/K."""
    gap = normal_observations(response, control)
    quantities = _ensembles(response, control, law)
    quantities[2] = [(1.0 / stiffness, freedom) for stiffness, freedom in quantities[2]]
    half, scatter = np.full((2, 3, gap.pressure.size), np.nan)
    for k, ensembles in enumerate(quantities):
        sums = [_squares(values, len(values) - freedom) for values, freedom in ensembles]
        square, freedom, n = (np.array(column) for column in zip(*sums, strict=True))
        estimable = np.all((freedom > 0) & (n > 0), axis=0)
        variance = square / np.maximum(freedom, 1)
        factor = student(freedom) / np.sqrt(np.maximum(n, 1))
        half[k] = np.where(estimable, np.linalg.norm(factor * np.sqrt(variance), axis=0), np.nan)
        scatter[k] = np.where(estimable, np.sqrt(variance.sum(axis=0)), np.nan)
    return Sampling(half, scatter)


def _ensembles(
    response: Dataset, control: Dataset | None = None, law: Dataset | None = None
) -> list[list[tuple[np.ndarray, int]]]:
    """Return ensembles, (values, freedom), with means that add up to gap, area and stiffness."""
    gap, area = normal_observations(response, control), area_observations(response, control)
    stiffness = [
        (stiffness_of_each(replace(gap, values=values, control=None), law), freedom)
        for values, freedom in gap.ensembles
    ]
    return [[*gap.ensembles], [*area.ensembles], stiffness]


def _squares(values: np.ndarray, spent: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the relative sum of squares about the mean of values, scaled; freedom, n."""
    counted = np.isfinite(values)
    n = counted.sum(axis=0)
    mean = np.where(counted, values, 0.0).sum(axis=0) / np.maximum(n, 1)
    spread = np.where(counted, values - mean, 0.0)
    size = np.where(mean == 0.0, np.nan, mean)
    freedom = np.maximum(n - spent, 0)
    scale = freedom / np.maximum(n - 1, 1)
    return scale * np.sum(spread**2, axis=0) / size**2, freedom, n


def fit_term(law: Dataset, p: np.ndarray) -> np.ndarray:
    """Estimate the half-widths from the errors at left out steps and their decay."""
    require_law(law, *FIT_ERRORS, *FIT_ERRORS.values())
    # where gaps are negative, errors are over the distance in which p changes by a factor e
    rows, errors = [], []
    gap, normal = law["fit_mean_gap"].to_numpy(), law_from_dataset(law)
    size = np.abs(gap) if np.all(gap > 0.0) else np.abs(np.gradient(gap, np.log(p)))
    to_gap = size / np.maximum(np.abs(gap), 1e-300)
    for name, share in FIT_ERRORS.items():
        error = law[name].to_numpy()
        if name == "fit_error":
            error = error / to_gap
        finite = error[np.isfinite(error)]
        rms = np.sqrt(np.mean(finite**2)) if finite.size else np.nan
        factor = student(finite.size) if finite.size >= FEWEST_UNSEEN else NORMAL
        rows.append(np.full(p.size, factor * float(law[share]) * rms))
        errors.append(NORMAL * np.abs(error))
    # the ends of the gap, the errors of the stiffness, and the observed gaps
    rows[0][[0, -1]] = np.fmax(rows[0][[0, -1]], errors[0][[1, -2]])
    rows[2] = np.fmax(rows[2], errors[2])
    rows[0] = to_gap * np.fmax(rows[0], np.abs(normal.gap_at(p) - gap) / size)
    # the stiffness where the observed stiffness falls, and at the ends
    stiffness = normal.stiffness(normal.gap_at(p))
    observed, between = p / np.abs(np.gradient(gap, np.log(p))), np.diff(p) / np.abs(np.diff(gap))
    falls = np.pad(between[1:] < between[:-1], 1)
    rows[2] = np.fmax(rows[2], np.where(falls, np.abs(stiffness / observed - 1.0), 0.0))
    log_compliance = np.log(p / stiffness)
    ends = [_end_error(gap[::k], np.log(p)[::k], log_compliance[::k]) for k in (-1, 1)]
    rows[2][[0, -1]] = np.fmax(rows[2][[0, -1]], NORMAL * np.array(ends))
    return np.array(rows)


def _end_error(gap: np.ndarray, x: np.ndarray, log_compliance: np.ndarray) -> float:
    """Return the distance of the last compliance of a law from the continued means of intervals."""
    # Newton's series of backward differences, half a step on, of the logarithms c_1, c_2, c_3 of
    # mean slopes |dg / dx|, x = ln p, of the last intervals, of differences that grow by gamma (1:
    # power law):
    #     c = c_1 + (c_1 - c_2) ((1 - r)^(-1/2) - 1) / r,
    #     r = 1 - 1/gamma,  gamma = (c_1 - c_2) / (c_2 - c_3) from 1 to GROWTH
    c = np.log(np.abs(np.diff(gap) / np.diff(x)))[::-1]
    last, before = c[0] - c[1], c[1] - c[2] if c.size > 2 else 0.0
    growth = last / before if last * before > 0.0 else 1.0
    r = 1.0 - 1.0 / np.clip(growth, 1.0 + 1e-6, GROWTH)
    return float(abs(log_compliance[-1] - c[0] - last * ((1.0 - r) ** -0.5 - 1.0) / r))


def grid_term(response: Dataset, resolutions: Mapping[float, Dataset]) -> Term:
    """Estimate bias and half-widths from the same realisations on several grids."""
    # gap, contact fraction and stiffness of every cell, (3, realisations, steps), by the ratio
    by_ratio = {
        ratio: np.array([values for ((values, _),) in _ensembles(grid)])
        for ratio, grid in sorted(_compared(response, resolutions).items())
    }
    ratios = np.array([*by_ratio])
    for (_, fine), (ratio, coarse) in pairwise(by_ratio.items()):
        if coarse.shape[1] < fine.shape[1]:
            raise CaseError(
                f"the response at the ratio {ratio:g} has {coarse.shape[1]} realisations, not "
                f"{fine.shape[1]}; solve the same realisations on every grid"
            )
    near = ratios[np.argmin(np.abs(np.log(ratios)))]
    # bias: sum of the mean differences between grids; half-width: error of the finest grid by the
    # order, without the variance in the square of a mean difference, and the intervals of the
    # differences
    rows, biases, how = [], [], ""
    for values in zip(*by_ratio.values(), strict=True):
        # mean differences between grids, and the error of the finest by Richardson
        differences = [coarse[: len(fine)] - fine for fine, coarse in pairwise(values)]
        change = np.array([np.nanmean(difference, axis=0) for difference in differences])
        finest = np.nanmean(values[0], axis=0)
        means = zip(ratios[1:] / ratios[0], finest + np.cumsum(change, axis=0), strict=True)
        estimate = estimate_grid_error(finest, dict(means))
        order = estimate.order if np.isfinite(estimate.order) else LOWEST_ORDER
        solved = 1.0 * (ratios[1:] <= near)
        # variance and interval of the estimate by the realisations
        weight = solved + np.eye(len(differences))[0] / ((ratios[1] / ratios[0]) ** order - 1.0)
        freedom = np.array([max(len(difference) - 1, 1) for difference in differences])
        deviation = np.array([np.nanstd(difference, axis=0) for difference in differences])
        deviation /= np.sqrt(freedom)[:, None]
        variance = np.sum(weight[:, None] * deviation, axis=0) ** 2  # as if all were correlated
        spread = (weight * student(freedom)) @ deviation
        square = (weight @ change) ** 2
        sure = np.sqrt(np.maximum(square - variance, 0.0) / np.maximum(square, 1e-300))
        scale = near**-order / np.abs(finest)
        rows.append(scale * np.hypot(sure * estimate.half_width, spread))
        biases.append(scale * (solved @ change))
        how = how or estimate.how
    return Term(how, np.array(rows), np.array(biases))


def _compared(response: Dataset, others: Mapping[float, Dataset]) -> dict[float, Dataset]:
    """Return compared responses by their ratios, with the response where none has the ratio 1."""
    if list(others) == [1.0]:
        raise CaseError(
            "resolutions with the spacing of the response are compared with each other, so two "
            "are needed, got 1"
        )
    expected = normal_observations(response).pressure
    for ratio, other in others.items():
        p = normal_observations(other).pressure
        if p.size != expected.size or not np.allclose(p, expected, rtol=1e-6):
            raise CaseError(
                f"the response at the ratio {ratio:g} has other pressures; use the same pressures"
            )
    return {1.0: response, **others}


def increment_term(response: Dataset) -> Term:
    """Estimate the half-widths of the increments of plastic flow from halved increments."""
    gap = normal_observations(response)
    if "flowing_fraction" not in response.variables:
        nothing = np.zeros((3, gap.pressure.size))
        return Term("nothing: no body of the cells flows in increments", nothing)
    if "mean_gap_increment_error" not in response.variables:
        how = "not known: no cell was solved with halved increments too"
        return Term(how, np.full((3, gap.pressure.size), np.nan))
    return _term_of_errors(response, "increment", "halved in one realisation")


def slope_term(response: Dataset) -> Term:
    """Estimate the half-widths of the assumption of small slopes from the expansion in slopes."""
    if "mean_gap_slope_error" not in response.variables:
        return Term("not known: solve one flat cell with slope_order 1 and 2, or conforming cells")
    return _term_of_errors(response, "slope", str(response.attrs["small_slopes"]))


def _term_of_errors(response: Dataset, cause: str, how: str) -> Term:
    """Estimate the half-widths from relative errors of gap and area at the steps of a response."""
    gap = normal_observations(response)
    error, area = (
        response[f"{name}_{cause}_error"].to_numpy()[gap.order]
        for name in ("mean_gap", "contact_fraction")
    )
    mean, x = np.nanmean(gap.values, axis=0), np.log(gap.pressure)
    slope = np.gradient(mean, x) / np.gradient(mean * (1.0 + error), x)  # of pressure over gap
    term = SAFETY * np.abs([error, area, slope - 1.0])
    if np.any(term > 0.0):
        worst = ", ".join(f"{100.0 * error:.2g} %" for error in term.max(axis=1))
        how += f": up to {worst} of gap, area and stiffness"
    return Term(how, term)


def discrepancy_term(law: Dataset, p: np.ndarray, level: float) -> Term:
    """Return the discrepancy of the stiffness of joints from the law of their cells."""
    if not level:
        return Term("not in a law with a discrepancy of 0")
    fine = np.geomspace(p.min(), p.max(), 200)
    normal, x = law_from_dataset(law), np.log(fine)
    # half-width w of the level: errors w and w (x - mean) / 2 of ln K, x = ln p, and of the gap the
    # integrals of e dp / K from the largest pressure
    errors = level * np.array([np.ones(fine.size), EXPONENT / DISCREPANCY * (x - x.mean())])
    closing = -np.diff(normal.gap_at(fine)) * 0.5 * (errors[:, 1:] + errors[:, :-1])
    total = np.cumsum(np.pad(closing, ((0, 0), (0, 1)))[:, ::-1], axis=1)[:, ::-1]
    rows = np.array([np.linalg.norm(total, axis=0), 0.0 * x, np.linalg.norm(errors, axis=0)])
    half = np.array([np.interp(np.log(p), x, row) for row in rows])
    half[0] /= np.abs(normal.gap_at(p))
    how = (
        f"joints about the law of their cells, unverified by measurement: {100.0 * level:.3g} % of "
        f"the stiffness, {EXPONENT / DISCREPANCY * level:.3g} of its exponent"
    )
    return Term(how, half)


def scatter_term(scatter: np.ndarray, scales: ScaleSeparation) -> np.ndarray:
    """Estimate the half-widths of an interface of few cells, 1.96 CoV L / l, 0 if infinite."""
    return np.asarray(NORMAL * np.nan_to_num(scatter, posinf=0.0) * scales.cell_ratio)


def separation_term(law: Dataset, p: np.ndarray, scales: ScaleSeparation) -> np.ndarray:
    """Estimate the half-widths from a pressure that varies over the longest wavelength."""
    mean_law, area_law = law_from_dataset(law), area_from_dataset(law)
    functions: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
        mean_law.gap_at,
        area_law.contact_fraction,
        lambda q: mean_law.stiffness(mean_law.gap_at(q)),
    )
    step, rows = 0.05, []
    for evaluate in functions:
        low, middle, high = (evaluate(p * np.exp(s)) for s in (-step, 0.0, step))
        first = (high - low) / (2.0 * step)  # d/d ln p
        second = (high - 2.0 * middle + low) / step**2
        # 1/2 f''(p) (eps p)² / 12 with eps = longest wavelength over l
        uneven = 0.5 * np.abs(second - first) * scales.wavelength_ratio**2 / 12.0  # p^2 f''
        rows.append(uneven / np.abs(middle))
    return np.array(rows)


def with_scales(law: Dataset, scales: ScaleSeparation) -> Dataset:
    """Return a law with its budget for the scale separation of another structure.

    A budget that lacks a term, as a budget of an earlier version may, is refused.
    """
    law = of_this_version(law)
    require_law(law, "error_bias", "cell_scatter", *map(how_attribute, ERROR_TERMS))
    half, bias = law["error_half_width"].copy(deep=True), law["error_bias"]
    p = law["fit_pressure"].to_numpy()
    scatter = law["cell_scatter"].to_numpy()
    terms = {
        "scale separation": separation_term(law, p, scales),
        FEW_CELLS: scatter_term(scatter[:3], scales),
    }
    for term, rows in terms.items():
        tangential = STEEPEST * rows[2:] * np.ones((len(scatter) - 3, 1))
        half.loc[{"error_term": term}] = np.vstack([rows, tangential])
    given = half.notnull().any(("quantity", "step")).to_numpy()
    total = law["error_total"].copy(data=add_terms(half.to_numpy(), bias.to_numpy(), given))
    unknown = [term for term in str(law.attrs["unknown"]).split(", ") if term != "scale separation"]
    return law.assign(error_half_width=half, error_total=total).assign_attrs(
        {
            "cell_ratio": scales.cell_ratio,
            how_attribute("scale separation"): str(scales),
            how_attribute(FEW_CELLS): scales.count_cells(),
            "unknown": ", ".join(unknown),
        }
    )
