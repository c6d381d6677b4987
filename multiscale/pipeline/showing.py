"""Tables, sentences and lists of a dataset, from what the schema says of its variables.

:data:`multiscale.schema.SHOWN` has labels, units and digits. A table is a list of columns, which
name variables and how each is written; a sentence has variables in braces, ``{joint_stiffness:±}``.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from string import Formatter
from typing import Any, TypeAlias

import numpy as np

from multiscale.plotting.budget_figures import estimated_steps, step_labels
from multiscale.schema import SHOWN, Dataset, unit_in
from multiscale.units import Unit
from multiscale.upscaling import Prediction
from multiscale.upscaling.budget import (
    has_budget,
    how_attribute,
    is_absent,
    known_error,
    total_error,
    unknown_terms,
)

__all__ = [
    "LOWER_BOUND",
    "ROUNDING",
    "SLIP",
    "Rows",
    "Table",
    "View",
    "answer_columns",
    "list_bolts",
    "list_cycles",
    "list_facts",
    "list_missing",
    "padded",
    "round_by",
    "say_beside",
    "say_ends",
    "say_error",
    "say_mean",
    "say_share",
    "say_sides",
    "say_total",
    "some_steps",
    "tabulate_budget",
    "tabulate_prediction",
    "tabulate_sensitivity",
]

Rows: TypeAlias = tuple[tuple[str, ...], list[tuple[str, ...]]]
"""Head and rows of text."""

INTERVALS = {"mean_law": "mean law, 95 %", "one_part": "one part, 95 %"}
"""Both intervals of an answer; see :func:`multiscale.upscaling.with_intervals`."""

TWO_DIGITS = 3.55
"""Leading digits of an error up to which two of them are written, by the rule of the PDG."""

TELLING = 0.1  # of the error of an answer, from which its change by a parameter is shown

MOST_BUDGETS = 6
"""Steps of an error budget in its table."""

NEGLIGIBLE = 1e-5
"""Relative error below which its number is not written in an error budget."""

ROUNDING = 1e-9
"""Relative error up to which an answer has none but rounding."""

FOUR_DIGITS = 5e-4
"""Relative error below which an answer has four digits if a term of its error is not known."""

LOWER_BOUND = " + ?"
"""Stands behind errors and intervals that lack a term that is not known: they are lower bounds."""


@dataclass(frozen=True, eq=False)
class View:
    """How the variables of a dataset are shown, all stiffnesses in one unit."""

    data: Dataset
    labels: Mapping[str, str] = field(default_factory=dict)  # in place of those of ``SHOWN``

    def unit(self, name: str) -> Unit:
        """Return the unit of a variable."""
        return unit_in(self.data, name)

    def head(self, name: str) -> str:
        """Return the label of a variable with its unit."""
        unit, label = self.unit(name).name, self.labels.get(name, SHOWN[name].label)
        return label if unit == "1" else f"{label} ({unit})"

    def text(self, step: Dataset, name: str, form: str = "") -> str:
        """Write a variable at a step of the dataset.

        Forms are the value with the digits that its interval leaves, with its error behind it
        (``±``) or its intervals in brackets (``()``), the error by itself (``error``), an interval
        (``mean_law``, ``one_part``), and both, once if they are alike (``both``).
        """
        if name not in step:
            return ""
        unit, bound = self.unit(name), _bound(step, name)
        if form == "error":
            return _error(step, name)
        if form == "both":
            return " / ".join(dict.fromkeys(self.text(step, name, kind) for kind in INTERVALS))
        if form in INTERVALS or f"{name}_{form}" in step:
            if f"{name}_{form}" not in step:
                return ""
            ends = unit.scale * step[f"{name}_{form}"].to_numpy()
            if (digits := SHOWN[name].digits) < 3:
                known = f"{ends[0]:.{digits}g} ... {ends[1]:.{digits}g}"
                return known if np.isfinite(ends).all() else "unknown"
            return say_ends(unit.scale * float(step[name]), ends, bound)
        value = self._value(step, name, unit, bound)
        if form == "()":
            said = _join_intervals([self.text(step, name, kind) for kind in INTERVALS])
            return f"{value}{f' ({said})' if said else ''}"
        error = _error(step, name) if form == "±" else ""
        if error == "unknown":
            return f"{value}, error unknown"
        return f"{value}{say_beside(error.removesuffix(LOWER_BOUND))}{bound if error else ''}"

    def _value(self, step: Dataset, name: str, unit: Unit, bound: str) -> str:
        value, show, half = float(step[name]), SHOWN[name], 0.0
        if np.isnan(value):
            return "unknown"
        if f"{name}_mean_law" in step and show.digits > 2:
            half = 0.5 * float(np.ptp(step[f"{name}_mean_law"].to_numpy()))
        if bound and half < FOUR_DIGITS * abs(value):
            half = 0.0
        if show.unit == "%" and abs(value) < NEGLIGIBLE:
            return say_share(value)
        if half > NEGLIGIBLE * abs(value):
            return round_by(unit.scale * value, unit.scale * half)
        return f"{unit.shown(value):.{show.digits}g}"

    def phrase(self, step: Dataset, name: str, form: str = "") -> str:
        """Write a variable in a sentence, with its unit, and its error or both intervals."""
        unit = self.unit(name)
        beside = "" if unit.name == "1" else f" {unit.name}"
        if form in INTERVALS:
            return f"{self.text(step, name, form)}{beside}"
        value = f"{self._value(step, name, unit, _bound(step, name))}{beside}"
        if form == "±":
            return f"{value}{say_beside(_error(step, name))}"
        if form == "intervals":
            return self.brackets(step, name)
        return f"{value}{self.brackets(step, name)}" if form == "()" else value

    def brackets(self, step: Dataset, name: str) -> str:
        """Report both intervals of an answer in brackets, and what they lack; or nothing."""
        intervals = [self.text(step, name, kind) for kind in INTERVALS]
        missing, said = _missing(step, name), _join_intervals(intervals)
        if said and missing and set(intervals) == {"unknown"}:
            said = f"error unknown: {missing}"
        elif said and missing:
            said = f"{said.replace(LOWER_BOUND, '')}; or wider, without {missing}, not known"
        return f" ({said})" if said else ""

    def sentences(self, step: Dataset, *sentences: str, **others: object) -> Iterator[str]:
        """Fill in variables of a step, attributes and others; not where a variable is unknown."""
        words = _Words(self, step, others)
        for sentence in sentences:
            names = [name for _, name, _, _ in words.parse(sentence) if name]
            named = [name for name in names if name not in {**step.attrs, **others}]
            if all(name in step and np.isfinite(step[name]).all() for name in named):
                yield words.format(sentence)


class _Words(Formatter):
    """Fills variables of a step with their units, attributes and others into a sentence."""

    def __init__(self, view: View, step: Dataset, others: Mapping[str, object]) -> None:
        self.view, self.step, self.others = view, step, others

    def get_field(self, field_name: str, args: object, kwargs: object) -> tuple[str, str]:
        return field_name, field_name

    def format_field(self, value: str, format_spec: str) -> str:
        given = {**self.step.attrs, **self.others}
        if value in given:
            return format(given[value], format_spec)
        return self.view.phrase(self.step, value, format_spec)


@dataclass(frozen=True, eq=False)
class Table:
    """A table of a dataset, a row for each of its steps.

    Columns are variables, each with the form of :meth:`View.text` behind a colon. Those that the
    dataset lacks, or that are known nowhere, are left out, but not the ``answer``, without which a
    row ends behind the columns that say which step it is of.
    """

    columns: tuple[str, ...]
    heads: Mapping[str, str] = field(default_factory=dict)  # labels in place of those of variables
    answer: str = ""
    at: int = 1  # columns that say which step a row is of
    along: tuple[str, ...] = ("step",)  # dimensions of the rows
    most: int = 0  # rows, evenly spread; all for 0
    missing: str = "not converged"  # what a row has of a step without a solution

    def rows(self, data: Dataset) -> Rows:
        """Return head and rows of text."""
        view = View(data, {name: label for name, label in self.heads.items() if ":" not in name})
        columns = [
            (name, form)
            for name, _, form in (column.partition(":") for column in self.columns)
            if name in data and (name == self.answer or data[name].notnull().any())
        ]
        head = tuple(self._head(view, name, form) for name, form in columns)
        rows: list[tuple[str, ...]] = []
        places = [*np.ndindex(*(data.sizes[dim] for dim in self.along))]
        for k in some_steps(len(places), self.most or len(places)):
            step = data.isel(dict(zip(self.along, places[k], strict=True)))
            row = tuple(self._cell(view, step, name, form) for name, form in columns)
            solved = "step" not in self.along or int(step.get("converged", 1))
            known = not self.answer or np.isfinite(step[self.answer]).any()
            if not solved or not known:
                missing = ("unknown" if solved else self.missing,)
                row = padded((*row[: self.at], *missing), head)
            rows.append(row)
        return head, rows

    def _head(self, view: View, name: str, form: str) -> str:
        if f"{name}:{form}" in self.heads:
            return self.heads[f"{name}:{form}"].format(unit=view.unit(name).name)
        if form == "both":
            return " / ".join(INTERVALS.values())
        return "error (%)" if form == "error" else INTERVALS.get(form) or view.head(name)

    def _cell(self, view: View, step: Dataset, name: str, form: str) -> str:
        if SHOWN[name].words:
            return SHOWN[name].words[int(step[name])]
        if step[name].dtype.kind == "U":
            return str(step[name].item())
        return view.text(step, name, form)


def some_steps(count: int, most: int) -> list[int]:
    """Return the numbers of at most so many steps, evenly spread, with the first and the last."""
    if not count:
        return []
    return [*map(int, np.unique(np.linspace(0, count - 1, min(count, most)).round()))]


def round_by(value: float, half_width: float) -> str:
    """Write a value with the digits that its error leaves: two of an error up to 3.5, else one.

    Examples
    --------
    >>> round_by(18.7, 0.14), round_by(18.56, 0.14), round_by(17.893, 0.8), round_by(18.7034, 0.0)
    ('18.70', '18.56', '17.9', '18.7')
    """
    if not half_width > NEGLIGIBLE * abs(value):
        return f"{value:.4g}"
    return f"{value:.{max(0, -int(np.floor(np.log10(half_width / TWO_DIGITS))))}f}"


def say_ends(value: float, ends: np.ndarray, bound: str = "") -> str:
    """Write an interval about a value; in per cent where its ends would have the same digits.

    It is empty if nothing but rounding is wrong with the value, and has the ``bound`` at its end.
    """
    low, high = ends
    half, size = 0.5 * (high - low), abs(value)
    if not np.isfinite(half) or (bound and half <= ROUNDING * size):
        return "unknown"
    if half <= ROUNDING * size:
        return ""
    if half < (FOUR_DIGITS if bound else NEGLIGIBLE) * size:
        return f"± {say_error(half / size)} %{bound}"
    return f"{round_by(low, half)} ... {round_by(high, half)}{bound}"


def say_error(total: float) -> str:
    """Total of an error budget in per cent, or that a term it must hold could not be computed."""
    if not np.isfinite(total):
        return "unknown"
    if ROUNDING < total < NEGLIGIBLE:
        return f"< {100.0 * NEGLIGIBLE:g}"
    return f"{100.0 * total:{'.0f' if total >= 1.0 else '.2g'}}" if total > ROUNDING else "0"


def say_share(share: float) -> str:
    """Write a share in per cent with three digits, without those that are mere rounding.

    Examples
    --------
    >>> say_share(0.20931), say_share(5e-8), say_share(1.3e-17)
    ('20.9', '< 0.001', '0')
    """
    return say_error(share) if share < NEGLIGIBLE else f"{100.0 * share:.3g}"


def say_total(step: Dataset, name: str) -> str:
    """Error of a quantity of a budget, per cent, as its interval if it has one.

    It ends with the mark of a lower bound if a term is not known; without any known term it is
    unknown.
    """
    known = known_error(step.sel(quantity=[name])).item()
    bound = _bound(step, name)
    if not known > ROUNDING:
        return "unknown" if bound or np.isnan(known) else "0"
    if f"{name}_one_part" in step:
        return say_sides(float(step[name]), step[f"{name}_one_part"].values, bound)
    return f"{say_error(known)}{bound}"


def say_sides(value: float, ends: np.ndarray, bound: str = "") -> str:
    """Error of a value, per cent, by its interval: its larger side, or both if they differ much.

    They do if one is more than twice as long as the other, or than the value.

    Examples
    --------
    >>> say_sides(20.0, np.array([19.0, 21.1])), say_sides(23.0, np.array([0.0, 24.0]))
    ('5.5', '-100, +4.3')
    """
    sides = np.abs(np.asarray(ends) / value - 1.0)
    if not sides.max() > min(2.0 * sides.min(), 1.0):
        return f"{say_error(sides.max())}{bound}"
    below, above = map(say_error, sides)
    return f"-{below}, +{above}{bound}"


def _bound(step: Dataset, name: str) -> str:
    """Return the mark of a lower bound, if a term of the budget of an answer is not known."""
    return LOWER_BOUND if _missing(step, name) else ""


def _missing(step: Dataset, name: str) -> str:
    """Names of the terms of the budget of an answer that are not known; empty without a budget.

    An answer of a load, an interface or a cycle has those of any quantity.
    """
    if "error_half_width" not in step:
        return ""
    own = (name,) if name in step["quantity"].values else ()
    return ", ".join(unknown_terms(step, *own))


def _join_intervals(intervals: Sequence[str]) -> str:
    """Join both intervals of an answer, those that are alike once."""
    kinds: dict[str, str] = {}
    for name, one in zip(INTERVALS.values(), intervals, strict=True):
        kind = name.removesuffix(", 95 %")
        kinds[one] = f"{kinds[one]} and {kind}" if one in kinds else kind
    return "; ".join(f"{kind} {one}" for one, kind in kinds.items() if one)


def say_beside(error: str) -> str:
    """Write an error, as of :func:`say_total`, behind its answer; nothing if there is none."""
    if error in {"", "0"}:
        return ""
    if error == "unknown":
        return " ± an unknown error"
    more = " or more" if error.endswith(LOWER_BOUND) else ""
    number = error.removesuffix(LOWER_BOUND)
    return f" {'' if number.startswith('-') else '± '}{number} %{more}"


def padded(row: tuple[str, ...], head: Sequence[str]) -> tuple[str, ...]:
    """Return a row as long as its head, with empty fields at its end."""
    return row + ("",) * (len(head) - len(row))


def _error(step: Dataset, name: str) -> str:
    """Error of a quantity, per cent; empty if nothing was estimated."""
    if "error_total" not in step or name not in step["quantity"].values:
        return ""
    return say_total(step, name)


def tabulate_prediction(quantity: str, pressure: np.ndarray, found: Prediction) -> Rows:
    """Head and rows of predictions of a law at pressures, Pa, with their intervals."""
    import xarray as xr

    name, ends = "mean_gap" if quantity == "gap" else "stiffness", ("limit", "step")
    values = {
        "nominal_pressure": ("step", pressure),
        name: ("step", found.value),
        f"{name}_mean_law": (ends, found.mean_law),
        f"{name}_next": (ends, found.next_specimen),
    }
    heads = {f"{name}:next": "next specimen, 95 %"}
    columns = ("nominal_pressure", *(f"{name}{form}" for form in ("", ":mean_law", ":next")))
    return Table(columns, heads).rows(xr.Dataset(values))


def list_facts(result: Dataset) -> list[str]:
    """Say what stands beside the table of a result: what flows, and how large a cell is."""
    return str(result.attrs.get("facts", "")).splitlines()


def list_missing(dataset: Dataset) -> list[str]:
    """Name the terms that the errors of a law or a result lack; nothing without a budget."""
    missing = ", ".join(unknown_terms(dataset)) if has_budget(dataset) else ""
    told = f"Terms of the error that are not known and not counted ({LOWER_BOUND.strip()})"
    return [f"{told}: {missing}."] if missing else []


def list_bolts(result: Dataset, tightening: np.ndarray) -> list[str]:
    """Say of each bolt what it carries where it is tightened last, and in the steps after that."""
    force = 1e-3 * result["bolt_force"].to_numpy()
    locked, told = int(np.flatnonzero(np.diff(tightening, prepend=0.0))[-1]), []
    for bolt, (tightened, *rest) in enumerate(force[locked:].T):
        known = np.array(rest)[np.isfinite(rest)]
        changes = f", then carries {known.min():.4g} to {known.max():.4g} kN" if known.size else ""
        told.append(f"Bolt {bolt} is tightened to {tightened:.4g} kN{changes}.")
    return told


def tabulate_budget(result: Dataset, quantity: str | None = None) -> Rows:
    """Head and rows of an error budget: half-widths in per cent of each term, and their total.

    They are of one quantity of the budget, the first if not given, at no more than
    ``MOST_BUDGETS`` steps; the last column says what a term rests on. Terms without a part in it
    share a row.
    """
    name = quantity or str(result["quantity"].values[0])
    steps = estimated_steps(result, name)
    some = np.unique(np.linspace(0, steps.size - 1, MOST_BUDGETS).round().astype(int))
    shown = result.isel(step=steps[some[some >= 0]])
    one = shown.sel(quantity=name)
    half = total_error(one["error_bias"].values, one["error_half_width"].values)
    missing = unknown_terms(result, name)
    rows: list[tuple[str, ...]] = []
    nothing: list[str] = []
    for term, values in zip(map(str, one["error_term"].values), half, strict=True):
        how = str(result.attrs[how_attribute(term)])
        if term not in missing and (is_absent(how) or np.all(values <= ROUNDING)):
            nothing.append(term)
        else:
            rows.append((term, *map(say_error, values), how))
    if nothing:
        rows.append(("all others", *("0" for _ in half[0]), f"no part in it: {', '.join(nothing)}"))
    beside = f"; lower bounds, without what is not known: {', '.join(missing)}" if missing else ""
    each = [shown.isel(step=k) for k in range(shown.sizes["step"])]
    total = [say_total(step.drop_vars(f"{name}_one_part", errors="ignore"), name) for step in each]
    rows.append(("total", *total, f"terms add as squares{beside}"))
    if f"{name}_one_part" in shown and shown[name].dims == ("step",):
        ends = [say_total(step, name) for step in each]
        if ends != total:
            why = "ends of the interval, where the answer does not follow its error in proportion"
            rows.append(("interval", *ends, why))
    return ("error (%) at", *step_labels(shown, unit=" MPa"), "rests on"), rows


def tabulate_sensitivity(result: Dataset) -> Rows:
    """Head and rows of relative changes of answers, in per cent, if parameters are larger.

    Each parameter is larger by its half-width; steps are as of :func:`tabulate_budget`. Answers
    that a parameter changes by less than a tenth of their error have no row.
    """
    known = np.flatnonzero(result["sensitivity"].notnull().any(("parameter", "quantity")))
    some = known[np.unique(np.linspace(0, known.size - 1, MOST_BUDGETS).round().astype(int))]
    one = result.isel(step=some)
    changes, error = one["sensitivity"].to_numpy(), np.nan_to_num(known_error(one))

    def write(change: float) -> str:
        if np.isnan(change):
            return "-"
        return "0" if abs(change) <= ROUNDING else f"{100.0 * change:+.3g}"

    rows = [
        (parameter, quantity, *map(write, changes[k, i]))
        for k, parameter in enumerate(map(str, one["parameter"].values))
        for i, quantity in enumerate(map(str, one["quantity"].values))
        if np.any(np.abs(changes[k, i]) > np.maximum(ROUNDING, TELLING * error[i]))
    ]
    return ("larger parameter", "change (%) of", *step_labels(one, unit=" MPa")), rows


SLIP = (
    "{slipping_load} of the contact force is at sliding{slipping_load:intervals}, more than half "
    "of the local pressure on {slip_fraction} of the nominal area"
)
"""What slips at a step."""


def list_cycles(result: Dataset) -> list[str]:
    """Say what every cycle of a joint has lost, and what slips; nothing for other results."""
    if "cycle_energy" not in result:
        return []
    view, told = View(result), []
    unknown = "unknown" if result["converged"].to_numpy().all() else "not closed"
    for k in range(count := result.sizes["cycle"]):
        cycle = result.isel(cycle=k)
        last = "{cycle_energy:intervals}" if k + 1 == count else ""
        lost = [*view.sentences(cycle, f"{{cycle_energy}} lost{last}")]
        told.append(f"cycle {k}: {lost[0] if lost else unknown}")
    slips = view.sentences(result.isel(step=-1), f"At the amplitude, {SLIP}")
    return [*told, *(slips if "slipping_load" in result else [])]


def answer_columns(
    answers: Mapping[str, str], values: Mapping[str, np.ndarray]
) -> dict[str, list[Any]]:
    """Return how answers of runs are shown: columns of ``SWEEP`` from their names and labels."""
    columns: dict[str, list[Any]] = {f"answer_{it}": [] for it in ("label", "over", "drawn")}
    columns |= {"answer_unit": [], "answer_scale": []}
    overs = {name: next(filter(answers.__contains__, SHOWN[name].over), "") for name in answers}
    for name, label in answers.items():
        unit = SHOWN[name].in_unit(values[name].ravel())
        row = (label or SHOWN[name].label, overs[name], name not in overs.values())
        for column, value in zip(columns.values(), (*row, unit.name, unit.scale), strict=True):
            column.append(value)
    return columns


def say_mean(values: np.ndarray) -> str:
    """Say the mean of the values that are known, and their standard deviation."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "unknown"
    mean, spread = known.mean(), known.std(ddof=1) if known.size > 1 else 0.0
    if spread <= ROUNDING * abs(mean):
        return f"{mean:.4g}"
    return f"{round_by(mean, spread)} ± {spread:.2g}"
