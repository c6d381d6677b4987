"""The terms of an error budget, each from computed quantities: half-widths over the value.

Half-widths have the shape (3, steps): gap, contact fraction and stiffness.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import Dataset
from multiscale.upscaling.fit import stiffness_of_each
from multiscale.upscaling.reading import area_from_dataset, law_from_dataset, require_law
from multiscale.upscaling.resolution import LOWEST_ORDER, SAFETY, estimate_grid_error
from multiscale.upscaling.response_observations import area_observations, normal_observations
from multiscale.upscaling.scales import ScaleSeparation

__all__ = [
    "FEW_CELLS",
    "NORMAL",
    "STATED",
    "Sampling",
    "Term",
    "compared",
    "fit_term",
    "grid_term",
    "increment_term",
    "parts_of_cells",
    "sampling_term",
    "scatter_term",
    "separation_term",
    "slope_term",
    "students",
    "values_of_cells",
]

FIT_ERRORS = {
    "fit_error": "gap_fit_share",
    "area_fit_error": "area_fit_share",
    "stiffness_fit_error": "stiffness_fit_share",
}
"""From the errors at points that a fit has not seen to the shares that are left between them."""

FEWEST_UNSEEN = 3  # errors at points that a fit has not seen: five pressures have so many
GROWTH = 10.0  # of differences from one interval to the next, beyond which nothing can be continued
FEW_CELLS = "few cells"
"""Term of one part, whose interface holds few cells; the mean law does not have it."""

STATED = "stated values"
"""Term of values that a case states with a half-width of their own."""

NORMAL = 1.959963984540054  # standard deviations to 95 %


@dataclass(frozen=True, eq=False)
class Term:
    """One part of the error of an answer.

    Attributes
    ----------
    how : str, how it was estimated, or what would tell it
    half_width : ndarray, shape (quantities, steps), or None
        Half-width of the 95 % interval, relative to the value; NaN where it is not known, None if
        nothing was given to estimate it from.
    bias : ndarray, shape (quantities, steps), or 0, part whose sign is known, relative to the value
    """

    how: str
    half_width: np.ndarray | None = None
    bias: np.ndarray | float = 0.0

    def at(self, steps: slice) -> "Term":
        """Return the term at some of its steps."""
        half, bias = self.half_width, np.asarray(self.bias)
        return replace(
            self,
            half_width=None if half is None else half[..., steps],
            bias=bias[..., steps] if bias.ndim else self.bias,
        )

    def smooth(self, pressure: np.ndarray) -> "Term":
        """Return the term with a parabola over the logarithm of the pressure (Pa) as bias.

        The half-width holds the distance from it. A bias of few cells, which differs by chance
        from step to step, would make a law uneven that is corrected by it.
        """
        x, bias = np.log(pressure), np.asarray(self.bias)
        known = np.isfinite(bias).all(axis=0)
        degree = max(0, min(2, int(known.sum()) - 2))
        powers = np.vander(x - x.mean(), degree + 1)
        even = (powers @ np.linalg.lstsq(powers[known], bias[:, known].T, rcond=None)[0]).T
        half = np.hypot(np.asarray(self.half_width), bias - even)
        return replace(self, bias=even, half_width=half)

    def taken_out(self, source: str) -> "Term":
        """Return what is left where the bias is taken out of an answer."""
        return replace(self, how=f"taken out: {self.how} ({source})", bias=0.0)


@dataclass(frozen=True, eq=False)
class Sampling:
    """Half-widths (3, steps) by the sampling of realisations, and the scatter of single cells."""

    half_width: np.ndarray
    scatter: np.ndarray


def sampling_term(
    response: Dataset,
    law: Dataset,
    sizes: Mapping[float, Dataset] | None,
    control: Dataset | None = None,
) -> Sampling:
    r"""Half-widths from the scatter of the realisations.

    One rule serves all quantities and numbers of realisations: Student's interval of the mean.
    Gap and contact fraction are means over the realisations, and so is the compliance
    :math:`1/K` of a law through mean gaps, whose relative interval is the one of the stiffness;
    each realisation has a law of its own. Two realisations give an interval, one gives none: NaN.

    With a control, the mean is a sum of the independent means of two ensembles, see
    :class:`~.control_variates.Control`: the residuals of the pairs, and the cheap cells. The
    squares of their intervals add up, and so do their variances to the scatter of single cells.
    The interval of a sum by Welch and Satterthwaite covers less where pairs are few: 92 % of 1500
    repeats with 4 pairs and a correlation of .98, where this one covers 96 %.

    The scatter of ``sizes``, cells of other sizes apart from the response, counts too, unless
    there is a control. It falls as :math:`1/L`, so that with :math:`\nu_i = N_i - 1` and the sizes
    :math:`r_i` relative to the response

    .. math:: \mathrm{CoV}^2 = \frac{\sum_i \nu_i\, (r_i\, \mathrm{CoV}_i)^2}{\sum_i \nu_i},
        \qquad w = t_{0.975,\, \sum \nu_i}\, \mathrm{CoV} / \sqrt{N_0}.
    """
    from scipy.special import stdtrit

    gap = normal_observations(response, control)
    parts = parts_of_cells(response, control, law)
    parts[2] = [(1.0 / stiffness, freedom) for stiffness, freedom in parts[2]]
    others: dict[float, tuple[np.ndarray, ...]] = {}
    if sizes and gap.control is None:
        for ratio, one in compared(response, sizes, apart=True).items():
            g, a, k = values_of_cells(one)
            others[ratio] = g, a, 1.0 / k
    half, scatter = np.full((2, 3, gap.pressure.size), np.nan)
    for k, ensembles in enumerate(parts):
        sums = [_squares(one, len(one) - freedom) for one, freedom in ensembles]
        square, freedom, n = (np.array(one) for one in zip(*sums, strict=True))
        for ratio, values in others.items():
            more, free, _ = _squares(values[k], 1)
            square, freedom = square + ratio**2 * more, freedom + free
        known = np.all((freedom > 0) & (n > 0), axis=0)
        variance = square / np.maximum(freedom, 1)
        factor = stdtrit(np.maximum(freedom, 1), 0.975) / np.sqrt(np.maximum(n, 1))
        half[k] = np.where(known, np.linalg.norm(factor * np.sqrt(variance), axis=0), np.nan)
        scatter[k] = np.where(known, np.sqrt(variance.sum(axis=0)), np.nan)
    return Sampling(half, scatter)


def _squares(values: np.ndarray, spent: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum of the squares about the mean over its square, scaled to a freedom; the freedom, and n.

    The values (realisations, steps) have ``spent`` degrees of freedom less than their number; their
    variance is that of one degree less.
    """
    counted = np.isfinite(values)
    n = counted.sum(axis=0)
    mean = np.where(counted, values, 0.0).sum(axis=0) / np.maximum(n, 1)
    spread = np.where(counted, values - mean, 0.0)
    size = np.where(mean == 0.0, np.nan, mean)
    freedom = np.maximum(n - spent, 0)
    scale = freedom / np.maximum(n - 1, 1)
    return scale * np.sum(spread**2, axis=0) / size**2, freedom, n


def fit_term(law: Dataset, p: np.ndarray) -> np.ndarray:
    """Half-widths from the errors at steps that the fit has not seen.

    The half-width is the root mean square of these errors, times the share that the decay with the
    spacing leaves, see :func:`~.spline_law.decay_share`, times Student's factor of their number,
    since few are small by chance; fewer than :data:`FEWEST_UNSEEN` tell no decay, and their whole
    error is taken as it is. A family with parameters has no decay. At the ends of the data, which
    have a neighbour on one side only, the error of the gap at the step beside counts whole. A
    stiffness counts the error of the step itself as well, and at the ends its distance from the
    slopes of the gap continued, see :func:`_end_error`. The gaps that were observed lie within the
    half-width, and so does the stiffness by the gaps on both sides where it falls, as it does in no
    convex law. Where some gaps are negative, their errors are not compared over the gaps, which
    pass through zero, but over the distance in which the pressure changes by its own size.
    """
    require_law(law, *FIT_ERRORS, *FIT_ERRORS.values())
    from scipy.special import stdtrit

    rows, errors = [], []
    gap, one = law["fit_mean_gap"].to_numpy(), law_from_dataset(law)
    size = np.abs(gap) if np.all(gap > 0.0) else np.abs(np.gradient(gap, np.log(p)))
    to_gap = size / np.maximum(np.abs(gap), 1e-300)
    for name, share in FIT_ERRORS.items():
        error = law[name].to_numpy()
        if name == "fit_error":
            error = error / to_gap
        known = error[np.isfinite(error)]
        rms = np.sqrt(np.mean(known**2)) if known.size else np.nan
        factor = stdtrit(known.size, 0.975) if known.size >= FEWEST_UNSEEN else NORMAL
        rows.append(np.full(p.size, factor * float(law[share]) * rms))
        errors.append(NORMAL * np.abs(error))
    rows[0][[0, -1]] = np.fmax(rows[0][[0, -1]], errors[0][[1, -2]])
    rows[2] = np.fmax(rows[2], errors[2])
    rows[0] = to_gap * np.fmax(rows[0], np.abs(one.gap_at(p) - gap) / size)
    stiffness = one.stiffness(one.gap_at(p))
    observed, between = p / np.abs(np.gradient(gap, np.log(p))), np.diff(p) / np.abs(np.diff(gap))
    falls = np.pad(between[1:] < between[:-1], 1)
    rows[2] = np.fmax(rows[2], np.where(falls, np.abs(stiffness / observed - 1.0), 0.0))
    own = np.log(p / stiffness)
    ends = [_end_error(gap[::k], np.log(p)[::k], own[::k]) for k in (-1, 1)]
    rows[2][[0, -1]] = np.fmax(rows[2][[0, -1]], NORMAL * np.array(ends))
    return np.array(rows)


def _end_error(gap: np.ndarray, x: np.ndarray, own: np.ndarray) -> float:
    r"""Distance of the last compliance of a law from the mean ones of the intervals, continued.

    Let :math:`c_1, c_2, c_3` be the logarithms of the mean slopes :math:`|\Delta g / \Delta x|`,
    :math:`x = \ln p`, of the last three intervals, the last one first. If their differences grow
    by one factor :math:`\gamma`, Newton's series of backward differences, half a step on, gives

    .. math:: c = c_1 + (c_1 - c_2)\, \frac{(1 - r)^{-1/2} - 1}{r}, \qquad
        r = 1 - 1/\gamma, \quad \gamma = \frac{c_1 - c_2}{c_2 - c_3},

    with :math:`1 \le \gamma \le` :data:`GROWTH`; :math:`\gamma = 1` continues a power law.
    """
    c = np.log(np.abs(np.diff(gap) / np.diff(x)))[::-1]
    last, before = c[0] - c[1], c[1] - c[2] if c.size > 2 else 0.0
    growth = last / before if last * before > 0.0 else 1.0
    r = 1.0 - 1.0 / np.clip(growth, 1.0 + 1e-6, GROWTH)
    return float(abs(own[-1] - c[0] - last * ((1.0 - r) ** -0.5 - 1.0) / r))


def values_of_cells(response: Dataset) -> np.ndarray:
    """Gap, contact fraction and stiffness, (3, realisations, steps); NaN where missing."""
    return np.array([values for ((values, _),) in parts_of_cells(response)])


def parts_of_cells(
    response: Dataset, control: Dataset | None = None, law: Dataset | None = None
) -> list[list[tuple[np.ndarray, int]]]:
    """Ensembles whose means add up to gap, contact fraction and stiffness, with their freedoms.

    One each, (realisations, steps), or two with a control; NaN where a value is missing.
    """
    gap, area = normal_observations(response, control), area_observations(response, control)
    return [
        [(one.masked, freedom) for one, freedom in gap.parts],
        [(one.masked, freedom) for one, freedom in area.parts],
        [(stiffness_of_each(one, law), freedom) for one, freedom in gap.parts],
    ]


def compared(
    response: Dataset, others: Mapping[float, Dataset], *, apart: bool
) -> dict[float, Dataset]:
    """Responses that are compared, by their ratios: they were pressed alike.

    The response itself, of the ratio 1, is one of them unless the others are apart from it.
    """
    if apart and len(others) < 2:
        raise CaseError(
            f"ensembles apart from the response are compared among themselves, so that two are "
            f"needed, got {len(others)}"
        )
    own = normal_observations(response).pressure
    for ratio, other in others.items():
        p = normal_observations(other).pressure
        if p.size != own.size or not np.allclose(p, own, rtol=1e-6):
            raise CaseError(
                f"the response at the ratio {ratio:g} has other pressures; press it as the first"
            )
    return dict(others) if apart else {1.0: response, **others}


def grid_term(
    response: Dataset, resolutions: Mapping[float, Dataset], *, apart: bool = False
) -> Term:
    """Bias and half-widths from the same realisations on several grids.

    The bias is the difference from the grid of the response, or the grid compared that is nearest
    to it, to the finest grid, both of which were solved: the sum of the mean differences between
    neighbouring grids, each of the realisations of the finer one. The half-width is the error that
    the finest grid leaves by the order observed, or the lowest. The mean difference of few
    realisations may pass through zero: the intervals of the differences are added, and their
    variance is taken out of the square of the mean, which holds it.
    """
    from scipy.special import stdtrit

    found = {
        ratio: values_of_cells(one)
        for ratio, one in sorted(compared(response, resolutions, apart=apart).items())
    }
    ratios = np.array([*found])
    for (_, fine), (ratio, coarse) in pairwise(found.items()):
        if coarse.shape[1] < fine.shape[1]:
            raise CaseError(
                f"the response at the ratio {ratio:g} has {coarse.shape[1]} realisations, not "
                f"{fine.shape[1]}; solve the same ones on every grid"
            )
    near = ratios[np.argmin(np.abs(np.log(ratios)))]
    rows, biases, how = [], [], ""
    for values in zip(*found.values(), strict=True):
        steps = [coarse[: len(fine)] - fine for fine, coarse in pairwise(values)]
        change = np.array([np.nanmean(one, axis=0) for one in steps])
        finest = np.nanmean(values[0], axis=0)
        means = zip(ratios[1:] / ratios[0], finest + np.cumsum(change, axis=0), strict=True)
        estimate = estimate_grid_error(finest, dict(means))
        order = estimate.order if np.isfinite(estimate.order) else LOWEST_ORDER
        solved = 1.0 * (ratios[1:] <= near)
        weight = solved + np.eye(len(steps))[0] / ((ratios[1] / ratios[0]) ** order - 1.0)
        freedom = np.array([max(len(one) - 1, 1) for one in steps])
        deviation = [np.nanstd(one, axis=0) for one in steps] / np.sqrt(freedom)[:, None]
        variance = np.sum(weight[:, None] * deviation, axis=0) ** 2  # as if all were correlated
        spread = (weight * stdtrit(freedom, 0.975)) @ deviation
        square = (weight @ change) ** 2
        sure = np.sqrt(np.maximum(square - variance, 0.0) / np.maximum(square, 1e-300))
        scale = near**-order / np.abs(finest)
        rows.append(scale * np.hypot(sure * estimate.half_width, spread))
        biases.append(scale * (solved @ change))
        how = how or estimate.how
    return Term(how, np.array(rows), np.array(biases))


def increment_term(response: Dataset) -> Term:
    """Half-widths from the increments of a body that flows, by halved ones of one realisation."""
    gap = normal_observations(response)
    if "flowing_fraction" not in response.variables:
        nothing = np.zeros((3, gap.pressure.size))
        return Term("nothing: no body of the cells flows in increments", nothing)
    if "mean_gap_increment_error" not in response.variables:
        told = "not known: no cell was solved with halved increments too"
        return Term(told, np.full((3, gap.pressure.size), np.nan))
    return _term_of_errors(response, "increment", "halved in one realisation")


def slope_term(response: Dataset) -> Term:
    """Half-widths from slopes that the cells take as small, which their expansion in them tells.

    Conforming cells take them as small where their one body stands for two.
    """
    if "mean_gap_slope_error" not in response.variables:
        return Term("not known: solve one flat cell with slope_order 1 and 2, or conforming cells")
    return _term_of_errors(response, "slope", str(response.attrs["small_slopes"]))


def _term_of_errors(response: Dataset, cause: str, how: str) -> Term:
    """Half-widths from relative errors of gap and area at the steps of a response."""
    gap = normal_observations(response)
    error, area = (
        response[f"{name}_{cause}_error"].to_numpy()[gap.order]
        for name in ("mean_gap", "contact_fraction")
    )
    mean, x = np.nanmean(gap.masked, axis=0), np.log(gap.pressure)
    slope = np.gradient(mean, x) / np.gradient(mean * (1.0 + error), x)  # of pressure over gap
    term = SAFETY * np.abs([error, area, slope - 1.0])
    if np.any(term > 0.0):
        worst = ", ".join(f"{100.0 * one:.2g} %" for one in term.max(axis=1))
        how += f": up to {worst} of gap, area and stiffness"
    return Term(how, term)


def students(variances: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """95 % half-width of a sum of terms with variances (terms, steps) and freedoms (terms, 1).

    The freedom of the sum is the one of Welch and Satterthwaite.
    """
    from scipy.special import stdtrit

    total = np.maximum(variances.sum(axis=0), 0.0)
    single = np.sum(variances**2 / np.maximum(freedom, 1), axis=0)
    whole = np.where(single > 0.0, total**2 / np.where(single > 0.0, single, 1.0), np.inf)
    factor = stdtrit(np.maximum(whole, 1.0), 0.975)
    return np.asarray(np.where(np.isfinite(whole), factor, NORMAL) * np.sqrt(total))


def scatter_term(scatter: np.ndarray, scales: ScaleSeparation) -> np.ndarray:
    r"""Half-widths from the few cells of the edge L that one interface of :math:`\ell` holds.

    They are :math:`1.96\, \mathrm{CoV}\, L/\ell` with the coefficients of variation of cells,
    (3, steps); a scatter that is not finite, as the one of one realisation, counts as none.
    """
    return np.asarray(NORMAL * np.nan_to_num(scatter, posinf=0.0) * scales.cell_ratio)


def separation_term(law: Dataset, p: np.ndarray, scales: ScaleSeparation) -> np.ndarray:
    r"""Half-widths from pressure that is not even over the longest wave.

    They are :math:`\tfrac12 f''(p)\, (\varepsilon p)^2 / 12` of each quantity :math:`f`, with
    :math:`\varepsilon = \lambda_l/\ell`.
    """
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
        uneven = 0.5 * np.abs(second - first) * scales.wavelength_ratio**2 / 12.0  # p^2 f''
        rows.append(uneven / np.abs(middle))
    return np.array(rows)
