"""Tables, sentences and lists of a dataset, with labels, units and digits of its variables."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from string import Formatter
from typing import Any, TypeAlias

import numpy as np

from multiscale.plotting.budget_figures import estimated_steps, step_labels
from multiscale.schema import SHOWN, Dataset, unit_in
from multiscale.units import Unit
from multiscale.upscaling.budget import (
    MODEL,
    NO_PART,
    has_budget,
    how_attribute,
    is_absent,
    known_error,
    total_error,
    unknown_terms,
)

Rows: TypeAlias = tuple[tuple[str, ...], list[tuple[str, ...]]]  # head and rows of text

INTERVALS = {"mean_law": "mean law, 95 %", "one_part": "one part, 95 %"}
"""Both intervals of an answer; see :func:`multiscale.upscaling.with_intervals`."""

TWO_DIGITS = 3.55  # leading digits of an error with two digits, at most, by the rule of the PDG
REPORTED = 0.1  # share of the error of an answer above which a sensitivity is shown
MOST_BUDGETS = 6  # largest number of steps in the table of an error budget
NEGLIGIBLE = 1e-5  # relative error below which a budget shows a bound in place of the number
ROUNDING = 1e-9  # relative error up to which an error is rounding only
FOUR_DIGITS = 5e-4  # relative error below which an answer with unknown terms has four digits
LOWER_BOUND = " + ?"  # mark of errors and intervals without a term that is not known


@dataclass(frozen=True, eq=False)
class View:
    """Formats of the variables of a dataset, with all stiffnesses in the same unit."""

    data: Dataset
    labels: Mapping[str, str] = field(default_factory=dict)  # in place of the labels of ``SHOWN``

    def unit(self, name: str) -> Unit:
        """Return the unit of a variable."""
        return unit_in(self.data, name)

    def head(self, name: str) -> str:
        """Return the label of a variable with its unit."""
        unit, label = self.unit(name).name, self.labels.get(name, SHOWN[name].label)
        return label if unit == "1" else f"{label} ({unit})"

    def text(self, step: Dataset, name: str, form: str = "") -> str:
        """Write a variable at a step, with the digits that its interval allows, in a form."""
        # forms: error behind it (±), its intervals in brackets (()), only the error (error), an
        # interval (mean_law, one_part), both intervals, or one if they are equal (both)
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
            return format_interval(unit.scale * float(step[name]), ends, bound)
        value = self._value(step, name, unit, bound)
        if form == "()":
            intervals = _join_intervals([self.text(step, name, kind) for kind in INTERVALS])
            return f"{value} ({intervals})" if intervals else value
        error = _error(step, name) if form == "±" else ""
        if error == "unknown":
            return f"{value}, error unknown"
        return (
            f"{value}{format_error_behind(error.removesuffix(LOWER_BOUND))}{bound if error else ''}"
        )

    def _value(self, step: Dataset, name: str, unit: Unit, bound: str) -> str:
        value, show, half = float(step[name]), SHOWN[name], 0.0
        if np.isnan(value):
            return "unknown"
        if f"{name}_mean_law" in step and show.digits > 2:
            half = 0.5 * float(np.ptp(step[f"{name}_mean_law"].to_numpy()))
        if bound and half < FOUR_DIGITS * abs(value):
            half = 0.0
        if show.unit == "%" and abs(value) < NEGLIGIBLE:
            return format_share(value)
        if half > NEGLIGIBLE * abs(value):
            return round_by(unit.scale * value, unit.scale * min(half, abs(value)))
        return f"{unit.shown(value):.{show.digits}g}"

    def phrase(self, step: Dataset, name: str, form: str = "") -> str:
        """Write a variable in a sentence, with its unit, and its error or both intervals."""
        unit = self.unit(name)
        suffix = "" if unit.name == "1" else f" {unit.name}"
        if form in INTERVALS:
            return f"{self.text(step, name, form)}{suffix}"
        value = f"{self._value(step, name, unit, _bound(step, name))}{suffix}"
        if form == "±":
            return f"{value}{format_error_behind(_error(step, name))}"
        if form == "intervals":
            return self.brackets(step, name)
        return f"{value}{self.brackets(step, name)}" if form == "()" else value

    def brackets(self, step: Dataset, name: str) -> str:
        """Write both intervals of an answer in brackets, with the terms they do not contain."""
        intervals = [self.text(step, name, kind) for kind in INTERVALS]
        missing, text = _missing(step, name), _join_intervals(intervals)
        if text and missing and set(intervals) == {"unknown"}:
            text = f"error unknown: {missing}"
        elif text and missing:
            text = f"{text.replace(LOWER_BOUND, '')}; or wider: {missing} not known"
        return f" ({text})" if text else ""

    def sentences(self, step: Dataset, *sentences: str, **others: object) -> Iterator[str]:
        """Fill variables, attributes and others into sentences without unknown variables."""
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
    row ends behind the columns that identify its step.
    """

    columns: tuple[str, ...]
    heads: Mapping[str, str] = field(
        default_factory=dict
    )  # labels in place of the labels of variables
    answer: str = ""
    at: int = 1  # number of leading columns that identify the step
    along: tuple[str, ...] = ("step",)  # dimensions of the rows
    most: int = 0  # largest number of rows, evenly spread; all rows for 0
    missing: str = "not converged"  # text of a row without a solution

    def rows(self, data: Dataset) -> Rows:
        """Return head and rows of text."""
        view = View(data, {name: label for name, label in self.heads.items() if ":" not in name})
        columns = [
            (name, form)
            for k, (name, _, form) in enumerate(column.partition(":") for column in self.columns)
            if name in data and (name == self.answer or k == self.at or data[name].notnull().any())
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
    """Return at most ``most`` of ``count`` steps, evenly spread, with the first and the last."""
    if not count:
        return []
    return [*map(int, np.unique(np.linspace(0, count - 1, min(count, most)).round()))]


def round_by(value: float, half_width: float) -> str:
    """Write a value with the digits of its error: two for an error up to 3.5, otherwise one digit.

    >>> round_by(18.7, 0.14), round_by(18.56, 0.14), round_by(17.893, 0.8), round_by(18.7034, 0.0)
    ('18.70', '18.56', '17.9', '18.7')
    """
    if not half_width > NEGLIGIBLE * abs(value):
        return f"{value:.4g}"
    return f"{value:.{max(0, -int(np.floor(np.log10(half_width / TWO_DIGITS))))}f}"


def format_interval(value: float, ends: np.ndarray, bound: str = "") -> str:
    """Write an interval, in per cent if its ends have the same digits; empty if rounding."""
    low, high = ends
    half, size = 0.5 * (high - low), abs(value)
    if not np.isfinite(half) or (bound and half <= ROUNDING * size):
        return "unknown"
    if half <= ROUNDING * size:
        return ""
    if half < (FOUR_DIGITS if bound else NEGLIGIBLE) * size:
        return f"± {format_error(half / size)} %{bound}"
    return f"{round_by(low, half)} ... {round_by(high, half)}{bound}"


def format_error(total: float) -> str:
    """Write a relative error in per cent, or that it is unknown."""
    if not np.isfinite(total):
        return "unknown"
    if ROUNDING < total < NEGLIGIBLE:
        return f"< {100.0 * NEGLIGIBLE:g}"
    return f"{100.0 * total:{'.0f' if total >= 1.0 else '.2g'}}" if total > ROUNDING else "0"


def format_share(share: float) -> str:
    """Write a share in per cent with three digits, or fewer where only rounding is left.

    >>> format_share(0.20931), format_share(5e-8), format_share(1.3e-17)
    ('20.9', '< 0.001', '0')
    """
    return format_error(share) if share < NEGLIGIBLE else f"{100.0 * share:.3g}"


def format_total_error(step: Dataset, name: str) -> str:
    """Error of a quantity of a budget, per cent, from its interval if known."""
    known = known_error(step.sel(quantity=[name])).item()
    bound = _bound(step, name)
    if not known > ROUNDING:
        return "unknown" if bound or np.isnan(known) else "0"
    if f"{name}_one_part" in step:
        return format_sides(float(step[name]), step[f"{name}_one_part"].values, bound)
    return f"{format_error(known)}{bound}"


def format_sides(value: float, ends: np.ndarray, bound: str = "") -> str:
    """Error of a value, per cent, by its interval: its larger side, or both if far apart."""
    sides = np.abs(np.asarray(ends) / value - 1.0)
    if not sides.max() > min(2.0 * sides.min(), 1.0):
        return f"{format_error(sides.max())}{bound}"
    below, above = map(format_error, sides)
    return f"-{below}, +{above}{bound}"


def _bound(step: Dataset, name: str) -> str:
    """Return the mark of a lower bound, if a term of the budget of an answer is not known."""
    return LOWER_BOUND if _missing(step, name) else ""


def _missing(step: Dataset, name: str) -> str:
    """Names of the unknown terms of the budget of an answer; empty without a budget."""
    if "error_half_width" not in step:
        return ""
    quantity = (name,) if name in step["quantity"].values else ()
    return ", ".join(unknown_terms(step, *quantity))


def _join_intervals(intervals: Sequence[str]) -> str:
    """Join both intervals of an answer; equal intervals are written once."""
    kinds: dict[str, str] = {}
    for name, interval in zip(INTERVALS.values(), intervals, strict=True):
        kind = name.removesuffix(", 95 %")
        kinds[interval] = f"{kinds[interval]} and {kind}" if interval in kinds else kind
    return "; ".join(f"{kind} {interval}" for interval, kind in kinds.items() if interval)


def format_error_behind(error: str) -> str:
    """Write an error of :func:`format_total_error` to follow its answer; empty without an error."""
    if error in {"", "0"}:
        return ""
    if error == "unknown":
        return " ± an unknown error"
    more = " or more" if error.endswith(LOWER_BOUND) else ""
    number = error.removesuffix(LOWER_BOUND)
    return f" ({number} %{more})" if number.startswith("-") else f" ± {number} %{more}"


def padded(row: tuple[str, ...], head: Sequence[str]) -> tuple[str, ...]:
    """Return a row as long as its head, with empty fields at its end."""
    return row + ("",) * (len(head) - len(row))


def _error(step: Dataset, name: str) -> str:
    """Error of a quantity, per cent; empty if nothing was estimated."""
    if "error_total" not in step or name not in step["quantity"].values:
        return ""
    return format_total_error(step, name)


def list_facts(result: Dataset) -> list[str]:
    """Return the remarks below the table of a result, such as yielding and the size of a cell."""
    return str(result.attrs.get("facts", "")).splitlines()


def list_missing(dataset: Dataset) -> list[str]:
    """List the unknown terms of the budget of a law or a result, if any, and its discrepancy."""
    if not has_budget(dataset):
        return []
    lines, mark = list[str](), LOWER_BOUND.strip()
    if missing := ", ".join(unknown_terms(dataset)):
        lines.append(f"Error terms that are unknown and not included ({mark}): {missing}.")
    if not is_absent(how := str(dataset.attrs.get(how_attribute(MODEL), NO_PART.how))):
        lines.append(f"Intervals of one part contain a discrepancy of {how}.")
    return lines


def list_bolts(result: Dataset, tightening: np.ndarray) -> list[str]:
    """Report the force of each bolt at the last step of tightening, and in the steps after it."""
    force = 1e-3 * result["bolt_force"].to_numpy()
    locked, lines = int(np.flatnonzero(np.diff(tightening, prepend=0.0))[-1]), []
    for bolt, (tightened, *rest) in enumerate(force[locked:].T):
        known = np.array(rest)[np.isfinite(rest)]
        changes = f", then carries {known.min():.4g} to {known.max():.4g} kN" if known.size else ""
        lines.append(f"Bolt {bolt} is tightened to {tightened:.4g} kN{changes}.")
    return lines


def tabulate_budget(result: Dataset, quantity: str | None = None) -> Rows:
    """Head and rows of an error budget: half-widths in per cent of each term, and their total."""
    name = quantity or str(result["quantity"].values[0])
    steps = estimated_steps(result, name)
    some = np.unique(np.linspace(0, steps.size - 1, MOST_BUDGETS).round().astype(int))
    shown = result.isel(step=steps[some[some >= 0]])
    budget = shown.sel(quantity=name)
    half = total_error(budget["error_bias"].values, budget["error_half_width"].values)
    missing = unknown_terms(result, name)
    rows: list[tuple[str, ...]] = []
    nothing, absent = list[str](), list[str]()
    for term, values in zip(map(str, budget["error_term"].values), half, strict=True):
        how = str(result.attrs[how_attribute(term)])
        if term not in missing and (is_absent(how) or np.all(values <= ROUNDING)):
            (absent if is_absent(how) else nothing).append(term)
        else:
            rows.append((term, *map(format_error, values), how))
    others = {"contribute nothing": nothing, "do not apply": absent}
    if nothing or absent:
        text = "; ".join(f"{why}: {', '.join(names)}" for why, names in others.items() if names)
        rows.append(("all others", *("0" for _ in half[0]), text))
    lacking = f"; lower bounds, without unknown terms: {', '.join(missing)}" if missing else ""
    each = [shown.isel(step=k) for k in range(shown.sizes["step"])]
    total = [
        format_total_error(step.drop_vars(f"{name}_one_part", errors="ignore"), name)
        for step in each
    ]
    rows.append(("total", *total, f"root of the sum of squares{lacking}"))
    if f"{name}_one_part" in shown and shown[name].dims == ("step",):
        ends = [format_total_error(step, name) for step in each]
        if ends != total:
            why = "ends of the interval of an answer that is nonlinear in its errors"
            rows.append(("interval", *ends, why))
    return ("error (%) at", *step_labels(shown, unit=" MPa"), "source"), rows


def tabulate_sensitivity(result: Dataset) -> Rows:
    """Head and rows of the changes of answers, per cent, if a parameter grows by its half-width."""
    known = np.flatnonzero(result["sensitivity"].notnull().any(("parameter", "quantity")))
    some = known[np.unique(np.linspace(0, known.size - 1, MOST_BUDGETS).round().astype(int))]
    shown = result.isel(step=some)
    changes, error = shown["sensitivity"].to_numpy(), np.nan_to_num(known_error(shown))

    def write(change: float) -> str:
        if np.isnan(change):
            return "-"
        return "0" if abs(change) <= ROUNDING else f"{100.0 * change:+.3g}"

    rows = [
        (parameter, quantity, *map(write, changes[k, i]))
        for k, parameter in enumerate(map(str, shown["parameter"].values))
        for i, quantity in enumerate(map(str, shown["quantity"].values))
        if np.any(np.abs(changes[k, i]) > np.maximum(ROUNDING, REPORTED * error[i]))
    ]
    return ("increased parameter", "change (%) of", *step_labels(shown, unit=" MPa")), rows


SLIP = (
    "{slipping_load} of the contact force is at sliding{slipping_load:intervals}, and more than "
    "half of the local force on {slip_fraction} of the nominal area"
)
"""Phrase about the slip at a step."""


def list_cycles(result: Dataset) -> list[str]:
    """Report the loss of every cycle of a joint, and the slip at the amplitude."""
    if "cycle_energy" not in result:
        return []
    view, lines = View(result), []
    unknown = "unknown" if result["converged"].to_numpy().all() else "not closed"
    for k in range(count := result.sizes["cycle"]):
        cycle = result.isel(cycle=k)
        last = "{cycle_energy:intervals}" if k + 1 == count else ""
        lost = [*view.sentences(cycle, f"{{cycle_energy}} dissipated{last}")]
        lines.append(f"cycle {k}: {lost[0] if lost else unknown}")
    slips = view.sentences(result.isel(step=-1), f"At the amplitude, {SLIP}")
    return [*lines, *(slips if "slipping_load" in result else [])]


def answer_columns(
    answers: Sequence[str], values: Mapping[str, np.ndarray]
) -> dict[str, list[Any]]:
    """Return labels, units and scales of the answers of runs as columns of ``SWEEP``."""
    columns: dict[str, list[Any]] = {
        f"answer_{column}": [] for column in ("label", "over", "drawn")
    }
    columns |= {"answer_unit": [], "answer_scale": []}
    overs = {name: next(filter(answers.__contains__, SHOWN[name].over), "") for name in answers}
    for name in answers:
        unit = SHOWN[name].in_unit(values[name].ravel())
        row = (SHOWN[name].answer, overs[name], name not in overs.values())
        for column, value in zip(columns.values(), (*row, unit.name, unit.scale), strict=True):
            column.append(value)
    return columns


def format_mean(values: np.ndarray) -> str:
    """Write the mean of the finite values, and their standard deviation."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "unknown"
    mean, spread = known.mean(), known.std(ddof=1) if known.size > 1 else 0.0
    if spread <= ROUNDING * abs(mean):
        return f"{mean:.4g}"
    return f"{round_by(mean, spread)} ± {spread:.2g}"
