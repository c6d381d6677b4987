"""How wrong a law is: every term estimated and none assumed."""

from collections.abc import Mapping
from typing import TypeGuard

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import ERROR_BUDGET, INTERFACE_LAW, Dataset
from multiscale.upscaling.budget_terms import (
    FEW_CELLS,
    NORMAL,
    STATED,
    Term,
    fit_term,
    grid_term,
    increment_term,
    sampling_term,
    scatter_term,
    separation_term,
    slope_term,
)
from multiscale.upscaling.cell_size import size_term, surface_term
from multiscale.upscaling.response_observations import normal_observations, up_to_limit
from multiscale.upscaling.scales import ScaleSeparation
from multiscale.upscaling.shear_budget import NORMAL_ALONE, tangential_terms

__all__ = [
    "ERROR_TERMS",
    "NO_PART",
    "NO_STATED",
    "add_terms",
    "assemble_budget",
    "error_budget",
    "has_budget",
    "how_attribute",
    "is_absent",
    "known_error",
    "mean_law_error",
    "total_error",
    "unknown_terms",
    "with_budget",
]

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
    STATED,
    "macro discretisation",
)
"""Labels of the dimension ``error_term``."""

ALWAYS = ("sampling", "fit", "increments", "surface")
"""Terms that every total holds; the others enter if something was given to estimate them."""

ONE_SIDED = 6.0  # standard deviations from which a bias leaves one tail alone
TAIL = 1.6448536269514722  # standard deviations to 95 % of one side

NO_PART = Term("not in a law without the scales of a structure")
NO_STATED = Term("not in a law: values of the structure that are given with +-")

QUANTITIES = ("mean_gap", "contact_fraction", "stiffness")


def error_budget(
    response: Dataset,
    law: Dataset,
    *,
    resolutions: Mapping[float, Dataset] | None = None,
    sizes: Mapping[float, Dataset] | None = None,
    scales: ScaleSeparation | None = None,
    apart: bool = False,
    tangential: Mapping[float, Dataset] | None = None,
    control: Dataset | None = None,
    known: Mapping[str, Term] = {},
) -> Dataset:
    r"""Estimate how wrong the gap, the contact fraction and the stiffness of a law are.

    Parameters
    ----------
    response : Dataset, follows ``MICRO_RESPONSE``
    law : Dataset, follows ``INTERFACE_LAW``; fitted to the response by :func:`fit_law`
    resolutions : mapping of float to Dataset, optional
        From the ratio of the spacings (coarser over response: 2, or 2 and 4) to the response of
        the same realisations on a coarser grid.
    sizes : mapping of float to Dataset, optional
        From the ratio of the sizes of the cells (other over response, for instance 0.5) to a
        response of cells with the same spectrum.
    scales : ScaleSeparation, optional, from :func:`compare_scales`
    apart : bool, default False
        Whether resolutions and sizes, two at least of each, are ensembles of their own that are
        compared among themselves: the same small cells on several grids, and many cells of
        several sizes on a coarse grid. Their scatter then counts for the response too.
    tangential : mapping of float to Dataset, optional
        If given, the tangential traction of the law, over full slip, has a budget too; see
        :func:`~.shear_budget.tangential_terms`. From the ratio of the spacings to the law of the
        same realisations, pressed and sheared on a coarser grid, and of fewer ones on the grid of
        the law under 1; may be empty.
    control : Dataset, optional, as of :func:`fit_law`
    known : mapping of str to Term, optional
        Terms that are known otherwise, such as those whose bias is taken out of the response.

    Returns
    -------
    Dataset
        Follows ``ERROR_BUDGET``: half-widths of 95 % intervals relative to the value, for each
        quantity, term and step of the law; NaN for a term that nothing was given for. A bias,
        answer minus truth, is zero where no sign is known, and never taken out. The total holds
        :data:`ALWAYS` and every term that something was given for; the attribute ``unknown`` lists
        those that are not known, and ``how_...`` says of each term how it was estimated, or what
        would tell it. A term that cannot be computed from what was given, such as the sampling of
        one realisation, makes the total unknown, NaN, at its quantity and step, and never smaller.

    Raises
    ------
    CaseError
        If the law does not belong to the response, or a response has other steps.

    Notes
    -----
    How a term is estimated stands with its function: :func:`~.budget_terms.sampling_term`,
    :func:`~.budget_terms.fit_term`, :func:`~.cell_size.size_term`,
    :func:`~.budget_terms.grid_term` (micro discretisation),
    :func:`~.budget_terms.increment_term`, :func:`~.budget_terms.slope_term`,
    :func:`~.cell_size.surface_term`, :func:`~.budget_terms.separation_term` and, for few cells,
    :func:`~.budget_terms.scatter_term`; see :func:`mean_law_error`.

    Terms are independent of each other. With the sum :math:`b` of the biases and the standard
    deviation :math:`s` from the root of the sum of the squares of the half-widths about them, the
    total :math:`w` is such that :math:`|b + s\, \mathcal{N}(0, 1)| \le w` with a probability of
    95 %; without a bias it is that root itself.
    """
    INTERFACE_LAW.check(law)
    response = up_to_limit(response, law)
    control = None if control is None else up_to_limit(control, law)
    resolutions, sizes = (
        {ratio: up_to_limit(one, law) for ratio, one in (others or {}).items()}
        for others in (resolutions, sizes)
    )
    known = {name: term.at(slice(law.sizes["step"])) for name, term in known.items()}
    gap = normal_observations(response, control)
    p = gap.pressure
    if law.sizes["step"] != p.size or not np.allclose(law["fit_pressure"], p, rtol=1e-6):
        raise CaseError(
            f"the law was fitted at {law.sizes['step']} pressures that are not the {p.size} of the "
            f"response; fit it to this response"
        )
    pooled = sizes if apart else None
    sampling = sampling_term(response, law, pooled, control)
    how = f"Student's interval of {gap.n_realisations} realisations"
    if gap.control is not None:
        how += f" with {gap.control}"
    elif control is not None:
        how += " alone, since they and the control cells follow each other by chance alone"
    elif pooled:
        how = "Student's interval, with the scatter of the sizes, which falls as 1/L"
    if not np.any(np.isfinite(sampling.half_width)):
        how = "not known: one realisation tells nothing of the scatter, solve 3"
    terms = {
        "sampling": Term(how, sampling.half_width),
        "fit": Term("error at pressures that the fit has not seen", fit_term(law, p)),
        "cell size": Term("not known: pass sizes, responses of cells of another size"),
        "micro discretisation": Term(
            "not known: pass resolutions, the same realisations on coarser grids"
        ),
        "increments": increment_term(response),
        "small slopes": slope_term(response),
        "surface": surface_term(response, law, p),
        "friction bed": NORMAL_ALONE,
        "scale separation": Term("not known: pass scales from compare_scales"),
        FEW_CELLS: NO_PART,
        STATED: NO_STATED,
        "macro discretisation": Term("not in a law: see structure_budget"),
    }
    if sizes and "cell size" not in known:
        terms["cell size"] = size_term(response, sizes, apart=apart)
    if resolutions:
        terms["micro discretisation"] = grid_term(response, resolutions, apart=apart)
    terms |= known
    if scales is not None:
        terms["scale separation"] = Term(str(scales), separation_term(law, p, scales))
        few = scatter_term(sampling.scatter, scales)
        terms[FEW_CELLS] = Term(scales.count_cells(), few)
    if tangential is None:
        budget = assemble_budget(terms, QUANTITIES, p)
    else:
        rows = (*QUANTITIES, "tangential_traction")
        budget = assemble_budget(tangential_terms(terms, law, p, tangential), rows, p)
    scatter = np.full((budget.sizes["quantity"], p.size), np.nan)
    scatter[:3] = sampling.scatter
    return ERROR_BUDGET.assign(budget, {"cell_scatter": scatter})


def total_error(bias: np.ndarray, half_width: np.ndarray) -> np.ndarray:
    r"""Bound that an error with a bias keeps with a probability of 95 %."""
    from scipy.special import chndtrix

    b, s = np.abs(bias), np.asarray(half_width) / NORMAL
    ratio = np.where(s > 0.0, b / np.where(s > 0.0, s, 1.0), np.inf)
    near = s * np.sqrt(chndtrix(0.95, 1.0, np.minimum(ratio, ONE_SIDED) ** 2))
    return np.asarray(np.where(ratio < ONE_SIDED, near, b + TAIL * s))


def mean_law_error(budget: Dataset) -> np.ndarray:
    """Known total of a budget without what one part has by its few cells: error of the mean part.

    It is as of :func:`known_error`, shape (quantities, steps).
    """
    return known_error(budget, FEW_CELLS)


def known_error(budget: Dataset, *without: str) -> np.ndarray:
    """Total of the terms that are known, but for those that are left out.

    It is a lower bound of the error where :func:`unknown_terms` names any, relative to the value,
    shape (quantities, steps); NaN where no term is known, or those that are have no part in it.
    """
    counted = budget["error_half_width"].notnull() & ~budget["error_term"].isin(without)
    half, bias = (budget[name].where(counted) for name in ("error_half_width", "error_bias"))
    spread = (half**2).sum("error_term") ** 0.5
    error = total_error(bias.sum("error_term").values, spread.values)
    lacking = budget["error_total"].isnull().values & (error == 0.0)
    return np.where(counted.any("error_term").values & ~lacking, error, np.nan)


def unknown_terms(budget: Dataset, *quantities: str) -> list[str]:
    """Terms that totals of a budget, or of some of its quantities, hold not or not at every step.

    Steps at which none of :data:`ALWAYS` was estimated do not count, and terms of a law do not for
    an answer on which the known terms of the law have no influence.
    """
    names, terms = (list(map(str, budget[name].values)) for name in ("quantity", "error_term"))
    half = np.reshape(budget["error_half_width"].values, (len(names), len(terms), -1))
    asked = [names.index(name) for name in quantities] if quantities else range(len(names))
    of_law = ~np.isin(terms, [STATED, ERROR_TERMS[-1]])
    said = [str(budget.attrs.get(how_attribute(term), "")) for term in terms]
    told = np.array([not is_absent(how) for how in said])
    told |= np.isfinite(half).any(axis=(0, 2))  # of another answer
    missing = np.zeros(len(terms), dtype=bool)
    always = np.isin(terms, ALWAYS)
    for one in (half[k][:, np.isfinite(half[k][always]).any(axis=0)] for k in asked):
        passed = one[of_law & np.isfinite(one).any(axis=1)]
        counts = told & ~(of_law & (passed.size > 0 and not np.nan_to_num(passed).any()))
        missing |= counts & np.isnan(one).any(axis=1)
    return [term for term, is_missing in zip(terms, missing, strict=True) if is_missing]


def is_absent(how: str) -> bool:
    """Whether a law has no such term, by what a budget tells of it."""
    return how.startswith("not in a law")


def has_budget(law: Dataset | None) -> TypeGuard[Dataset]:
    """Whether there is a law, and it carries its error budget."""
    return law is not None and "error_half_width" in law


def with_budget(dataset: Dataset, budget: Dataset) -> Dataset:
    """Return a law or a macro result that carries its error budget, which has its steps.

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


def how_attribute(term: str) -> str:
    """Return the attribute that says how a term was estimated."""
    return "how_" + term.replace(" ", "_")


def add_terms(half: np.ndarray, bias: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Totals of half-widths and biases (quantity, term, step), with the terms that were given.

    NaN where one of these, or of :data:`ALWAYS`, is not known.
    """
    counted = np.isin(ERROR_TERMS, ALWAYS) | given
    return total_error(bias.sum(axis=1), np.sqrt(np.sum(half[:, counted] ** 2, axis=1)))


def assemble_budget(
    terms: Mapping[str, Term],
    quantities: tuple[str, ...],
    pressure: np.ndarray | None,
    steps: int | None = None,
) -> Dataset:
    """Arrange the terms, add them up and say which are not known."""
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
