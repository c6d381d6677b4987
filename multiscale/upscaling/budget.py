"""The error budget of answers: terms, grid errors, totals, intervals, and their dataset."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import ERROR_BUDGET, MACRO_RESULT, Dataset, Schema

FEW_CELLS, MODEL = "few cells", "model discrepancy"
OF_ONE_PART = (FEW_CELLS, MODEL)
"""Terms of a single specimen that was not measured, with few cells in its interface; the mean law
does not have them."""

STATED = "stated values"  # term of values that a case states with a half-width

NORMAL = 1.959963984540054  # standard deviations to 95 %

MACRO = "macro discretisation"  # term of the mesh and of the steps of a structure

ERROR_TERMS = (
    "sampling",
    "fit",
    "cell size",
    "micro discretisation",
    "increments",
    "small slopes",
    "surface",
    "friction bed",
    "scale separation",
    FEW_CELLS,
    MODEL,
    STATED,
    "macro discretisation",
)
"""Labels of the dimension ``error_term``."""

ALWAYS = ("sampling", "fit", "increments", "surface")
"""Terms of every total; the others enter if data to estimate them are given."""

ONE_SIDED = 6.0  # standard deviations from which a bias leaves a single tail

TAIL = 1.6448536269514722  # standard deviations to 95 % of one side

LABELS = ("quantity", "error_term", "parameter")  # labels of the dimensions of a budget

ORDERS = (0.5, 3.0)  # of believed observed orders

LOWEST_ORDER = 1.0

ALIKE = 0.5  # cosine of the differences over the steps

SAFETY = 1.25

UNSURE = 3.0


@dataclass(frozen=True, eq=False)
class Term:
    """A contribution to the error of an answer."""

    how: str  # how it was estimated, or the data that are missing
    half_width: np.ndarray | None = None  # over the value; NaN where unknown, None if not estimated
    bias: np.ndarray | float = 0.0  # over the value, with its sign

    def at(self, steps: slice) -> "Term":
        """Return the term at some of its steps."""
        half, bias = self.half_width, np.asarray(self.bias)
        return replace(
            self,
            half_width=None if half is None else half[..., steps],
            bias=bias[..., steps] if bias.ndim else self.bias,
        )


NO_PART = Term("not in a law without the scales of a structure")


NO_STATED = Term("not in a law: values of the structure that are given with +-")


def has_budget(law: Dataset | None) -> TypeGuard[Dataset]:
    """Whether there is a law with an error budget."""
    return law is not None and "error_half_width" in law


def with_budget(dataset: Dataset, budget: Dataset) -> Dataset:
    """Return a law or a macro result with its error budget at the same steps.

    Raises
    ------
    CaseError
        If the steps differ in number.
    """
    ERROR_BUDGET.check(budget)
    if dataset.sizes.get("step") != budget.sizes["step"]:
        raise CaseError(
            f"the budget has {budget.sizes['step']} steps, the dataset "
            f"{dataset.sizes.get('step')}; estimate the budget of this dataset"
        )
    variables = budget.drop_vars("nominal_pressure", errors="ignore")
    return dataset.merge(variables, join="exact").assign_attrs(
        {name: value for name, value in budget.attrs.items() if name not in dataset.attrs}
    )


def known_terms(law: Dataset) -> tuple[str, ...]:
    """Return the terms of the budget of a law that have a value for a quantity at a step."""
    estimated = of_this_version(law)["error_half_width"].notnull().any(("quantity", "step"))
    return tuple(term for term in ERROR_TERMS[:-1] if estimated.sel(error_term=term))


def of_this_version(law: Dataset) -> Dataset:
    """Return a law with its budget; one of an earlier version is without the discrepancy."""
    if MODEL in law["error_term"].values:
        return law
    law = law.reindex(error_term=list(ERROR_TERMS)).fillna({"error_bias": 0.0})
    return law.assign_attrs({how_attribute(MODEL): "not in a law of an earlier version"})


def how_attribute(term: str) -> str:
    """Return the name of the attribute with the text of a term."""
    return "how_" + term.replace(" ", "_")


def is_absent(how: str) -> bool:
    """Whether a law has no such term, by its text in a budget."""
    return how.startswith("not in a law")


def total_error(bias: np.ndarray, half_width: np.ndarray) -> np.ndarray:
    r"""Return the bound that an error with a bias keeps with a probability of 95 %."""
    from scipy.special import chndtrix

    b, s = np.abs(bias), np.asarray(half_width) / NORMAL
    ratio = np.where(s > 0.0, b / np.where(s > 0.0, s, 1.0), np.inf)
    near = s * np.sqrt(chndtrix(0.95, 1.0, np.minimum(ratio, ONE_SIDED) ** 2))
    return np.asarray(np.where(ratio < ONE_SIDED, near, b + TAIL * s))


def add_terms(half: np.ndarray, bias: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Add half-widths and biases (quantity, term, step) of terms; NaN where one is unknown."""
    counted = np.isin(ERROR_TERMS, ALWAYS) | given
    return total_error(bias.sum(axis=1), np.sqrt(np.sum(half[:, counted] ** 2, axis=1)))


def known_error(budget: Dataset, *without: str) -> np.ndarray:
    """Add the known terms, but for the terms ``without``."""
    half, bias = (
        budget[name].transpose("quantity", "error_term", ...).values
        for name in ("error_half_width", "error_bias")
    )
    left_out = np.isin(budget["error_term"].values, without)
    counted = ~np.isnan(half) & ~left_out.reshape(-1, *(1,) * (half.ndim - 2))
    half, bias = (np.where(counted, values, 0.0) for values in (half, bias))
    error = total_error(np.nansum(bias, axis=1), np.sqrt(np.sum(half**2, axis=1)))
    unknown = np.isnan(budget["error_total"].values) & (error == 0.0)
    return np.where(counted.any(axis=1) & ~unknown, error, np.nan)


def mean_law_error(budget: Dataset) -> np.ndarray:
    """Add the known terms that the mean specimen has: the error of the mean specimen."""
    return known_error(budget, *OF_ONE_PART)


def unknown_terms(budget: Dataset, *quantities: str) -> list[str]:
    """Return the terms that are missing at a step in totals of a budget, or of some quantities."""
    names, terms = (list(map(str, budget[name].values)) for name in ("quantity", "error_term"))
    half = np.reshape(budget["error_half_width"].values, (len(names), len(terms), -1))
    chosen = [names.index(name) for name in quantities] if quantities else range(len(names))
    of_law = ~np.isin(terms, [STATED, ERROR_TERMS[-1]])
    texts = [str(budget.attrs.get(how_attribute(term), "")) for term in terms]
    present = np.array([not is_absent(how) for how in texts])
    present |= np.isfinite(half).any(axis=(0, 2))  # of another answer
    missing = np.zeros(len(terms), dtype=bool)
    always = np.isin(terms, ALWAYS)
    for k in chosen:
        width = half[k][:, np.isfinite(half[k][always]).any(axis=0)]  # (terms, steps that count)
        passed = width[of_law & np.isfinite(width).any(axis=1)]
        counts = present & ~(of_law & (passed.size > 0 and not np.nan_to_num(passed).any()))
        missing |= counts & np.isnan(width).any(axis=1)
    return [term for term, is_missing in zip(terms, missing, strict=True) if is_missing]


def assemble_budget(
    terms: Mapping[str, Term],
    quantities: tuple[str, ...],
    pressure: np.ndarray | None,
    steps: int | None = None,
) -> Dataset:
    """Assemble the terms, their totals and the list of unknown terms."""
    n = steps if pressure is None else pressure.size
    half = np.full((len(quantities), len(ERROR_TERMS), n or 0), np.nan)
    bias = np.zeros(half.shape)
    for k, term in enumerate(terms[name] for name in ERROR_TERMS):
        bias[:, k] = term.bias
        if term.half_width is not None:
            half[:, k] = term.half_width
    half[~np.isfinite(half)] = np.nan
    bias[~np.isfinite(bias)] = 0.0
    unknown = [
        term
        for k, term in enumerate(ERROR_TERMS)
        if np.all(np.isnan(half[:, k])) and not is_absent(terms[term].how)
    ]
    given = np.array([terms[term].half_width is not None for term in ERROR_TERMS])
    total = add_terms(half, bias, given)
    values = {"error_half_width": half, "error_bias": bias, "error_total": total}
    if pressure is not None:
        values["nominal_pressure"] = pressure
    return ERROR_BUDGET.build(
        values,
        **{how_attribute(term): terms[term].how for term in ERROR_TERMS},
        unknown=", ".join(unknown),
        confidence=0.95,
    ).assign_coords(quantity=list(quantities), error_term=list(ERROR_TERMS))


def interval_errors(budget: Dataset) -> dict[str, np.ndarray]:
    """Return half-widths of both kinds of intervals over the answers, (quantities, steps)."""
    return {"mean_law": mean_law_error(budget), "one_part": known_error(budget)}


def limits(value: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return both ends of intervals, shape (2, ...), not below zero; the error is relative."""
    return np.asarray(value * np.maximum(1.0 + np.stack([-error, error]), 0.0))


def _limits_in_series(budget: Dataset, name: str, spring: str) -> dict[str, np.ndarray]:
    """Return both ends of both intervals of a stiffness k in series with an uncertain spring K."""
    # Terms of which K has at least half, e_t <= 2 s e_Kt with its share s = k / K of the
    # compliance, are errors of K, and the ends are of the series; the mesh is of the bodies. Both
    # add as squares.
    row, value = budget.sel(quantity=[name]), budget[name].to_numpy()
    share, half = value / budget[spring].to_numpy(), row["error_half_width"]
    of_spring = half <= 2.0 * share * budget["error_half_width"].sel(quantity=spring)
    of_spring &= row["error_term"] != MACRO
    parts = [row.assign(error_half_width=half.where(of_spring, 0.0))]
    parts += [row.assign(error_half_width=half.where(~of_spring, 0.0), error_bias=0.0 * half)]
    ends = {}
    for kind, (error,) in interval_errors(parts[0]).items():
        rest = interval_errors(parts[1])[kind][0]
        unknown = np.isnan(error) & np.isnan(rest)
        error, rest = np.nan_to_num(error), np.where(unknown, np.nan, np.nan_to_num(rest))
        factor = np.maximum(1.0 + np.stack([-error, error]) / share, 0.0)  # of the spring
        moved = factor / (share + (1.0 - share) * factor) - 1.0
        widths = np.hypot(moved, rest) * [[-1.0], [1.0]]
        ends[kind] = value * np.maximum(1.0 + widths, 0.0)
    return ends


def with_intervals(
    result: Dataset,
    along: Mapping[str, tuple[str, int]] | None = None,
    schema: Schema = MACRO_RESULT,
) -> Dataset:
    """Return a result of a structure with the 95 % intervals of all answers of its budget.

    ``..._mean_law`` is the interval of the answer by the mean law, ``..._one_part`` the interval of
    the next specimen, with the scatter of the cells in its interface and the discrepancy of joints
    from their cells. If a term is unknown, they contain the others and are lower bounds. Answers
    for each cycle have intervals at the last cycle, by the budget of the last step. No answer is
    below zero, and no error of an interface makes its joint stiffer than the bodies: the error is
    in ``uncertain_part``, in series with them. ``along`` is variable and place of an answer if
    there are several loads or interfaces.
    """
    values: dict[str, np.ndarray] = {}
    for kind, error in interval_errors(result).items():
        for name, half in zip(map(str, result["quantity"].values), error, strict=True):
            if along and name in along:
                variable, at = along[name]
                value = result[variable].to_numpy()
                ends = values.setdefault(f"{variable}_{kind}", np.full((2, *value.shape), np.nan))
                ends[..., at] = limits(value[:, at], half)
                continue
            value = result[name].to_numpy()
            if result[name].dims != ("step",):
                half = np.append(np.full(value.size - 1, np.nan), half[-1])
            values[f"{name}_{kind}"] = limits(value, half)
    for name in map(str, result["quantity"].values):
        if spring := (name in schema.optional and schema.optional[name].uncertain_part):
            in_series = _limits_in_series(result, name, spring)
            values |= {f"{name}_{kind}": limit for kind, limit in in_series.items()}
    return schema.assign(result, values)


def over_steps(budget: Dataset, steps: np.ndarray, count: int) -> Dataset:
    """Expand a budget of some steps, by their numbers, to ``count`` steps, NaN at the others."""
    values = {}
    for name, variable in budget.data_vars.items():
        values[str(name)] = np.full((*variable.shape[:-1], count), np.nan)
        values[str(name)][..., steps] = variable.to_numpy()
    labels = {name: budget[name].values for name in LABELS if name in budget}
    return ERROR_BUDGET.build(values, **budget.attrs).assign_coords(labels)


@dataclass(frozen=True, eq=False)
class GridEstimate:
    """Error of an answer by coarser grids."""

    error: np.ndarray  # answer minus limit, in the unit of the answer
    half_width: np.ndarray  # about a 95 % bound on its size, same unit
    order: float  # observed, of all answers and steps; NaN if none is observed
    how: str  # the estimate in words


def estimate_grid_error(answer: np.ndarray, coarser: Mapping[float, np.ndarray]) -> GridEstimate:
    r"""Estimate the error of an answer by Richardson's extrapolation.

    Parameters
    ----------
    answer : ndarray, shape (..., steps), on the finest grid; any unit, which may differ by answer
    coarser : mapping of float to ndarray, shape (..., steps)
        From the ratio :math:`r > 1` of the spacings to the answer there; one or two grids, the
        second with :math:`r^2`.

    Raises
    ------
    CaseError
        If there is no coarser grid or a ratio is not above 1.

    Notes
    -----
    With :math:`d_1 = f_1 - f_2` from the finest two grids and :math:`d_2 = f_2 - f_3`, and norms
    over the steps of differences relative to :math:`f_1`,

    .. math::
        q = \frac{\ln (\|d_2\| / \|d_1\|)}{\ln r}, \qquad e = -\frac{d_1}{r^q - 1}, \qquad
        |e_{95}| = 1.25\, |e|.    \tag{1}

    The order is common to all answers and steps. At a step where a difference passes through zero,
    the ratio of differences is arbitrary, and the bound is at least the root mean square of
    :math:`e_{95}` over the steps. With a single coarser grid the order is 1, the order of the
    contact fraction and the lowest of the averages; this bound is used at all steps of an answer if
    :math:`d_1` changes its sign over them. If three grids have no order between 0.5 and 3, or their
    differences are not similar (a cosine below a half), the bound is three times the largest
    difference. The factors are from the grid convergence index [1]_. If a coarser grid has no
    answer, NaN, the error is unknown.

    References
    ----------
    .. [1] P. J. Roache, J. Fluids Eng. 116 (1994) 405-413, doi:10.1115/1.2910291.
    """
    if not coarser:
        raise CaseError("the error of a grid is estimated from at least one coarser grid")
    ratios = sorted(coarser)
    r = ratios[0]
    if not r > 1.0:
        raise CaseError(f"a coarser grid must have a ratio of spacings above 1, got {r:g}")
    fine = np.asarray(answer, dtype=float)
    d1 = fine - coarser[r]
    scale = np.where(fine != 0.0, np.abs(fine), 1.0)
    if len(ratios) == 1 or abs(ratios[1] - r**2) > 0.05 * r**2:
        error = -d1 / (r**LOWEST_ORDER - 1.0)
        falls, rises = (np.any(sign, axis=-1, keepdims=True) for sign in (d1 < 0.0, d1 > 0.0))
        how = f"one coarser grid (spacing {r:g} times), order taken as {LOWEST_ORDER:g}"
        return GridEstimate(error, SAFETY * _size(error, scale, ~(falls & rises)), np.nan, how)
    # the order from the norms of both differences, where they are alike
    d2 = coarser[r] - coarser[ratios[1]]
    product, *squares = (float(np.nansum(x / scale**2)) for x in (d1 * d2, d1**2, d2**2))
    how = f"two coarser grids (spacing {r:g} and {ratios[1]:g} times), observed order "
    order = 0.5 * np.log(squares[1] / squares[0]) / np.log(r) if min(squares) > 0.0 else np.nan
    alike = product > ALIKE * np.sqrt(squares[0] * squares[1])
    if not (alike and ORDERS[0] <= order <= ORDERS[1]):
        unsure = UNSURE * np.maximum(np.abs(d1), np.abs(d2)) / (r - 1.0)
        return GridEstimate(-d1 / (r**LOWEST_ORDER - 1.0), unsure, np.nan, how + "none")
    error = -d1 / (r**order - 1.0)
    size = _size(error, scale, d1 * d2 > 0.0)
    return GridEstimate(error, SAFETY * size, float(order), how + f"{order:.2g}")


def _size(error: np.ndarray, scale: np.ndarray, sure: np.ndarray) -> np.ndarray:
    """Return sizes of errors; if not sure, at least the root mean square over the steps."""
    square = (error / scale) ** 2
    finite = np.isfinite(square)
    count = np.maximum(np.count_nonzero(finite, axis=-1, keepdims=True), 1)
    usual = scale * np.sqrt(np.sum(square, axis=-1, keepdims=True, where=finite) / count)
    return np.asarray(np.where(sure, np.abs(error), np.maximum(np.abs(error), usual)))
