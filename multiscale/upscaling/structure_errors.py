"""How wrong an answer of the structure is, from the error budget of its law."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import ModifiedLaw, NormalLaw
from multiscale.schema import ERROR_BUDGET, MACRO_RESULT, Dataset, Schema
from multiscale.upscaling.bootstrap import half_range
from multiscale.upscaling.budget import (
    ALWAYS,
    ERROR_TERMS,
    add_terms,
    assemble_budget,
    has_budget,
    how_attribute,
    is_absent,
    known_error,
    mean_law_error,
)
from multiscale.upscaling.budget_terms import FEW_CELLS, Term, scatter_term, separation_term
from multiscale.upscaling.observations import observe
from multiscale.upscaling.reading import fitted_laws, law_from_dataset, require_law
from multiscale.upscaling.resolution import estimate_grid_error
from multiscale.upscaling.scales import ScaleSeparation
from multiscale.upscaling.shear_budget import STEEPEST
from multiscale.upscaling.spline_law import fit_each

__all__ = [
    "STRETCH",
    "Dependence",
    "add_budgets",
    "changed_laws",
    "interval_errors",
    "limits",
    "over_steps",
    "structure_budget",
    "with_intervals",
    "with_scales",
]

STRETCH = 0.02
"""Relative change of a parameter of the law, to see how an answer depends on it."""

LABELS = ("quantity", "error_term", "parameter")
"""Labels of the dimensions of a budget."""

FEWEST_SAMPLES = 40  # for a percentile interval


@dataclass(frozen=True, eq=False)
class Dependence:
    """How answers depend on a parameter of the law beside its normal branch, and its errors.

    Attributes
    ----------
    change : ndarray, shape (answers, steps)
        Relative change of the answers over a relative change of the parameter.
    half_width : mapping of str to ndarray
        From a term to the half-width of the 95 % interval of the parameter over its value, of a
        shape that goes with (answers, steps). Terms that are missing add nothing.
    """

    change: np.ndarray
    half_width: Mapping[str, np.ndarray | float]


def structure_budget(
    name: str | Sequence[str],
    law: Dataset,
    solve: Callable[[NormalLaw], np.ndarray],
    *,
    answer: np.ndarray | None = None,
    pressure: np.ndarray | None = None,
    coarser: Mapping[float, np.ndarray] | None = None,
    exact: str = "",
    samples: np.ndarray | int = 100,
    others: Sequence[Dependence] = (),
    own: Mapping[str, Term] | None = None,
    cells: np.ndarray | float = 1.0,
    changed: Mapping[str, np.ndarray] | None = None,
) -> Dataset:
    """Carry the error budget of a law to an answer of the structure, or to several.

    Parameters
    ----------
    name : str or sequence of str
        Name of the answer, for instance ``"joint_stiffness"``. Several answers have an axis of
        their own before the axis of the steps, here and in the arrays below.
    law : Dataset, follows ``INTERFACE_LAW`` and carries its budget; see :func:`with_budget`
    solve : callable, from a normal law to the answer, shape (steps,), any unit: a macro solver
    answer : ndarray, shape (steps,), optional, answer with the mean law, if it is known
    pressure : ndarray, shape (steps,), optional
        Pressure of the interface at each step, Pa, at which the errors of the law count; their
        root mean square over its data if not given.
    coarser : mapping of float to ndarray, shape (steps,), optional
        Answers with the mean law on coarser meshes, by the ratio of the spacings; see
        :func:`estimate_grid_error`.
    exact : str, optional
        Why the structure with a law is solved without an error of its own, if it is.
    samples : int or ndarray, shape (samples, steps)
        How many bootstrap samples of the law are solved, from the first on, or their answers.
        With fewer than 40, sampling enters as the other terms do.
    others : sequence of Dependence
        Parameters of the law beside its normal branch, such as those of its friction.
    own : mapping of str to Term, optional
        Parts of terms that answers have of their own, whatever the law passes on: half-widths and
        biases of the shape (answers, steps), zero for those that have none.
    cells : float or ndarray, shape (answers, steps)
        Number of cells over which the answers average, over the number that the scales of the law
        tell; see :func:`effective_cells`.
    changed : mapping of str to ndarray, shape (steps,), optional
        Answers with the laws of :func:`changed_laws`, by their names, if they are known.

    Returns
    -------
    Dataset
        Follows ``ERROR_BUDGET``, with a quantity for each answer. *Sampling* comes from the
        samples of the law. The other terms of the law enter by the change of the answer when all
        gaps are larger by the term of the gap, and when the law is softer about the mean pressure
        by the term of the stiffness; a bias by solving with a law of free form through the gaps
        without it. A term of the law that is not known at a pressure, or without samples not for
        the stiffness, makes the total unknown, NaN.

    Raises
    ------
    CaseError
        If the law carries no budget.
    """
    if not has_budget(law):
        raise CaseError(
            "the law carries no error budget; add it by with_budget(law, error_budget(...))"
        )
    mean_law, names = law_from_dataset(law), (name,) if isinstance(name, str) else tuple(name)

    def solved(one: NormalLaw) -> np.ndarray:
        return _rows(solve(one), names)

    value = solved(mean_law) if answer is None else _rows(answer, names)
    require_law(law, "fit_mean_gap", "error_bias", *map(how_attribute, ERROR_TERMS))
    if changed is None:
        changed = {key: solved(one) for key, one in changed_laws(law, pressure).items()}
    changed = {key: _rows(one, names) for key, one in changed.items()}
    terms = _law_terms(law, changed, value, pressure)
    if not isinstance(samples, np.ndarray):
        n = min(samples, int(law.sizes.get("sample", 0)))
        n = n if n >= FEWEST_SAMPLES else 0
        samples = np.array([solved(one) for one in fitted_laws(law, range(n))])
    if len(samples):
        rows = np.reshape(samples, (len(samples), *value.shape))
        told = f"{len(samples)} bootstrap samples of the law"
        terms["sampling"] = replace(
            terms["sampling"], how=told, half_width=half_range(rows) / np.abs(value)
        )
    if exact:
        terms["macro discretisation"] = Term(exact, np.zeros(value.shape))
    elif coarser:
        estimate = estimate_grid_error(value, {r: _rows(a, names) for r, a in coarser.items()})
        terms["macro discretisation"] = Term(estimate.how, estimate.half_width / np.abs(value))
    for one in others:
        for name, half_width in one.half_width.items():
            passed = terms[name].half_width
            if passed is not None:
                added = np.where(one.change == 0.0, 0.0, one.change * half_width)
                terms[name] = replace(terms[name], half_width=np.hypot(passed, added))
    for name, term in (own or {}).items():
        known = [one for one in (terms[name].half_width, term.half_width) if one is not None]
        terms[name] = Term(
            f"{terms[name].how}; {term.how}",
            np.sqrt(sum(one**2 for one in known)) if known else None,
            terms[name].bias + term.bias,
        )
    few = terms[FEW_CELLS].half_width
    if few is not None:
        terms[FEW_CELLS] = replace(terms[FEW_CELLS], half_width=few / np.sqrt(cells))
    return assemble_budget(terms, names, None, steps=value.shape[1])


def with_intervals(
    result: Dataset,
    along: Mapping[str, tuple[str, int]] | None = None,
    schema: Schema = MACRO_RESULT,
) -> Dataset:
    """Return a result of a structure with the 95 % intervals of all answers of its budget.

    ``..._mean_law`` is where the answer of the mean law lies, ``..._one_part`` where the next part
    lies, whose interface holds only so many cells; where a term of the budget is not known they
    have the others, and are lower bounds. Of answers for each cycle the last one has
    intervals, which the budget has at the last step. No answer lies below zero, and no joint is
    stiffer than its bodies: its ``uncertain_part``, in series with them, has the error. ``along``
    names variable and place of answers that are one of several loads or interfaces.
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
            part = schema.optional[name].uncertain_part
            share = value / result[part].to_numpy() if part else 1.0
            values[f"{name}_{kind}"] = limits(value, half, share)
    return schema.assign(result, values)


def interval_errors(budget: Dataset) -> dict[str, np.ndarray]:
    """Half-widths of both kinds of intervals over the answers of a budget, (quantities, steps).

    Where a term is not known, they have the others: lower bounds.
    """
    total = budget["error_total"].to_numpy()
    one_part = np.where(np.isfinite(total), total, known_error(budget))
    return {"mean_law": mean_law_error(budget), "one_part": one_part}


def limits(value: np.ndarray, error: np.ndarray, share: "np.ndarray | float" = 1.0) -> np.ndarray:
    """Return both ends of intervals, shape (2, ...), none below zero; the error is relative.

    If the answer is a stiffness in series, one part with this share of the compliance has the
    error, and the ends are those of the series.
    """
    part = np.maximum(1.0 + np.stack([-error, error]) / share, 0.0)
    return np.asarray(value * part / (share + (1.0 - share) * part))


def over_steps(budget: Dataset, steps: np.ndarray, count: int) -> Dataset:
    """Return a budget of some steps, by their numbers, as one of ``count`` steps, NaN at others."""
    values = {}
    for name, one in budget.data_vars.items():
        values[str(name)] = np.full((*one.shape[:-1], count), np.nan)
        values[str(name)][..., steps] = one.to_numpy()
    labels = {name: budget[name].values for name in LABELS if name in budget}
    return ERROR_BUDGET.build(values, **budget.attrs).assign_coords(labels)


def _rows(answer: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Answers as rows over the steps, one for each name."""
    return np.reshape(np.asarray(answer, dtype=float), (len(names), -1))


def changed_laws(law: Dataset, pressure: np.ndarray | None = None) -> dict[str, NormalLaw]:
    """Return the normal laws with which a structure tells how its answers depend on a law.

    ``law`` carries its budget; ``pressure`` is as of :func:`structure_budget`. They are the law of
    larger gaps, ``"mean_gap"``, the softer one, ``"stiffness"``, and for each term with a bias, by
    its name, the law without the bias of its gaps.
    """
    mean_law, data = law_from_dataset(law), law["fit_pressure"].to_numpy()
    p = data if pressure is None else np.asarray(pressure)
    middle = float(mean_law.gap_at(np.array(np.exp(np.nanmean(np.log(p))))))
    laws: dict[str, NormalLaw] = {
        "mean_gap": ModifiedLaw(mean_law, shift=_shift(law)),
        "stiffness": ModifiedLaw(mean_law, factor=1.0 + STRETCH, centre=middle),
    }
    known = law["error_half_width"].notnull().any(("quantity", "step"))
    for term in ERROR_TERMS[:-1]:
        bias = law["error_bias"].sel(quantity="mean_gap", error_term=term).to_numpy()
        if known.sel(error_term=term) and np.any(bias):
            less = law["fit_mean_gap"].to_numpy() * (1.0 - bias)
            unbiased = observe("gap", data, less)
            laws[term] = fit_each(unbiased, unbiased.values)[0]
    return laws


def _shift(law: Dataset) -> float:
    """By how much the gaps of the first of :func:`changed_laws` are larger, m."""
    return STRETCH * float(np.ptp(law["fit_mean_gap"].to_numpy()))


def add_budgets(budgets: Sequence[Dataset], names: Sequence[str]) -> Dataset:
    """Add up what independent laws pass on to the same answers.

    Parameters
    ----------
    budgets : sequence of Dataset
        Each follows ``ERROR_BUDGET``. A term that one of them does not know adds nothing of it,
        unless it always counts; the macro discretisation is as the first one tells it.
    names : sequence of str, what each is of, in words

    Returns
    -------
    Dataset
        Follows ``ERROR_BUDGET``: half-widths by the root of the sum of squares, and biases by
        their sum.
    """
    first = budgets[0]
    if len(budgets) == 1:
        return first
    terms = {}
    for k, term in enumerate(ERROR_TERMS):
        counted = budgets if term != ERROR_TERMS[-1] else budgets[:1]
        own = [one["error_half_width"].to_numpy()[:, k] for one in counted]
        known = [bool(np.isfinite(one).any()) for one in own]
        passed = [one for one, is_known in zip(own, known, strict=True) if is_known]
        half = np.sqrt(sum(one**2 for one in passed)) if passed else None
        if term in ALWAYS and not all(known):
            half = None
        bias = sum(one["error_bias"].to_numpy()[:, k] for one in counted)
        said = [str(one.attrs[how_attribute(term)]) for one in counted]
        told = said[0]
        if len(set(said)) > 1:  # laws without the term say nothing beside those with it
            pairs = [pair for pair in zip(names, said, strict=True) if not is_absent(pair[1])]
            told = "; ".join(f"{x}: {how}" for x, how in pairs) or told
        terms[term] = Term(told, half, np.asarray(bias))
    quantities = tuple(map(str, first["quantity"].values))
    return assemble_budget(terms, quantities, None, steps=first.sizes["step"])


def _law_terms(
    law: Dataset,
    changed: Mapping[str, np.ndarray],
    answer: np.ndarray,
    pressure: np.ndarray | None,
) -> dict[str, Term]:
    """Terms of the answer from the terms of the law.

    Half-widths are by how it depends on gaps and stiffness, biases by solving with laws without
    the biases of their gaps.
    """
    data = law["fit_pressure"].to_numpy()
    of_gap = np.abs(changed["mean_gap"] / answer - 1.0) / _shift(law)  # 1/m
    of_stiffness = np.abs(changed["stiffness"] / answer - 1.0) / STRETCH
    known = law["error_half_width"].notnull().any(("quantity", "step"))
    terms = {term: Term(str(law.attrs[how_attribute(term)])) for term in ERROR_TERMS[:-1]}
    for term in terms:
        if known.sel(error_term=term):
            parts = []
            for quantity, unit, change in (
                ("mean_gap", np.abs(law["fit_mean_gap"].to_numpy()), of_gap),
                ("stiffness", 1.0, of_stiffness),
            ):
                half = unit * law["error_half_width"].sel(error_term=term, quantity=quantity)
                at = np.sqrt(np.mean(half.to_numpy() ** 2))
                if pressure is not None:
                    at = np.interp(np.log(pressure), np.log(data), half.to_numpy())
                # nothing is unknown of an answer that does not change
                parts.append(np.where(change == 0.0, 0.0, change * at))
            terms[term] = replace(terms[term], half_width=np.hypot(*parts))
            if term in changed:
                bias = (answer - changed[term]) / np.abs(answer)
                terms[term] = replace(terms[term], bias=bias)
    last = Term("not known: pass coarser, the answers on coarser meshes")
    return terms | {ERROR_TERMS[-1]: last}


def with_scales(law: Dataset, scales: ScaleSeparation) -> Dataset:
    """Return a law, which carries its budget, with the scale separation of another structure.

    A budget that lacks a term, as a budget of an earlier version may, is refused.
    """
    require_law(law, "error_bias", "cell_scatter", *map(how_attribute, ERROR_TERMS))
    half, bias = law["error_half_width"].copy(deep=True), law["error_bias"]
    p = law["fit_pressure"].to_numpy()
    scatter = law["cell_scatter"].to_numpy()
    terms = {
        "scale separation": separation_term(law, p, scales),
        FEW_CELLS: scatter_term(scatter[:3], scales),
    }
    for term, rows in terms.items():
        follow = STEEPEST * rows[2:] * np.ones((len(scatter) - 3, 1))  # of the tangential traction
        half.loc[{"error_term": term}] = np.vstack([rows, follow])
    given = half.notnull().any(("quantity", "step")).to_numpy()
    total = law["error_total"].copy(data=add_terms(half.to_numpy(), bias.to_numpy(), given))
    unknown = [one for one in str(law.attrs["unknown"]).split(", ") if one != "scale separation"]
    return law.assign(error_half_width=half, error_total=total).assign_attrs(
        {
            "cell_ratio": scales.cell_ratio,
            how_attribute("scale separation"): str(scales),
            how_attribute(FEW_CELLS): scales.count_cells(),
            "unknown": ", ".join(unknown),
        }
    )
