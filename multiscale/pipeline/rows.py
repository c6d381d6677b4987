"""Results as rows of text under a head.

A ``result`` follows ``MACRO_RESULT``, a result of grains ``GRANULATE``, of a sweep ``SWEEP``.
"""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from multiscale.plotting.budget_figures import estimated_steps, step_labels
from multiscale.schema import Dataset
from multiscale.units import Unit, stiffness_unit
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
    "Table",
    "joint_unit",
    "list_bolts",
    "list_cycles",
    "list_facts",
    "list_missing",
    "padded",
    "round_by",
    "say_answer",
    "say_beside",
    "say_cell",
    "say_ends",
    "say_share",
    "say_sides",
    "say_slip",
    "say_total",
    "say_value",
    "tabulate",
    "tabulate_budget",
    "tabulate_cycles",
    "tabulate_grains",
    "tabulate_links",
    "tabulate_prediction",
    "tabulate_preloads",
]

Table: TypeAlias = tuple[tuple[str, ...], list[tuple[str, ...]]]
"""Head and rows."""

INTERVALS = {"mean_law": "mean law, 95 %", "one_part": "one part, 95 %"}
"""Both intervals of an answer; see :func:`multiscale.upscaling.with_intervals`."""

FURTHER = {
    "unloading_stiffness": ("unloading", None),
    "tangential_stiffness": ("tangential, no slip", None),
    "thermal_conductance": ("heat", Unit("kW/m²K", 1e-3)),
    "electrical_conductance": ("current", Unit("S/mm²", 1e-6)),
}
"""Answers that a joint has where its law has such a branch: heads, and units but of stiffnesses."""

TWO_DIGITS = 3.55
"""Leading digits of an error up to which two of them are written, by the rule of the PDG."""

MOST_ROWS = 11
"""Of the table of a structure of links."""

MOST_BUDGETS = 6
"""Steps of an error budget in its table."""

NEGLIGIBLE = 1e-5
"""Relative error below which its number is not written in an error budget."""

ROUNDING = 1e-9
"""Relative error up to which an answer has none but rounding."""

FOUR_DIGITS = 5e-4
"""Relative error below which an answer has four digits if a term of its error is not known."""

SLIDING = ("slipping_load", "cycle_slip")
"""Answers that are shares of the contact force at sliding."""

LOWER_BOUND = " + ?"
"""Stands behind errors and intervals that lack a term that is not known: they are lower bounds."""


def tabulate(result: Dataset) -> Table:
    """Return head and rows of text for a joint."""
    stiffness = joint_unit(result)
    further = {
        name: (label, unit or stiffness)
        for name, (label, unit) in FURTHER.items()
        if name in result
    }

    touches = bool(result["contact_fraction"].notnull().any())  # which tables do not tell

    def rest(step: Dataset) -> tuple[str, ...]:
        real = f"{100.0 * float(step['contact_fraction']):.3g}", _part(step, "real_pressure", 1e-6)
        return (
            f"{1e6 * float(step['mean_gap']):.4g}",
            *(real if touches else ()),
            *(_part(step, name, unit.scale) for name, (_, unit) in further.items()),
        )

    beside = ("mean gap (µm)", *(("contact (%)", "real pressure (MPa)") if touches else ()))
    more = (f"{label} ({unit.name})" for label, unit in further.values())
    head = (*_head(stiffness), *beside, *more)
    return head, _rows_of_preloads(result, head, rest)


def joint_unit(result: Dataset) -> Unit:
    """Return the unit in which stiffnesses of a joint are shown, one for all of them."""
    return stiffness_unit(result["joint_stiffness"].to_numpy())


def _head(stiffness: Unit) -> tuple[str, ...]:
    """Head of joints at their preloads."""
    return (
        "preload (MPa)",
        f"joint stiffness ({stiffness.name})",
        *INTERVALS.values(),
        "error (%)",
        f"interface ({stiffness.name})",
        f"bodies ({stiffness.name})",
    )


def tabulate_preloads(result: Dataset) -> Table:
    """Head and rows of bodies with joints at their preloads."""
    states, unit = {"slip": "sliding", "open": "open"}, joint_unit(result)

    def rest(step: Dataset) -> tuple[str, ...]:
        return (
            _part(step, "tangential_stiffness", unit.scale),
            say_share(float(step["slipping_load"])),
            *(say_share(float(step[f"{state}_fraction"])) for state in states),
            _part(step, "real_pressure", 1e-6),
        )

    shares = ("sliding force (%)", *(f"{said} area (%)" for said in states.values()))
    head = (*_head(unit), f"tangential, no slip ({unit.name})", *shares, "real pressure (MPa)")
    pressed = int(np.argmax(result["shear"].values != 0.0)) or result.sizes["step"]
    return head, _rows_of_preloads(result.isel(step=slice(pressed)), head, rest)


def _rows_of_preloads(
    result: Dataset, head: tuple[str, ...], rest: Callable[[Dataset], tuple[str, ...]]
) -> list[tuple[str, ...]]:
    """Rows of stiffnesses and their errors at every step, and of the rest."""
    rows: list[tuple[str, ...]] = []
    scale = joint_unit(result).scale
    for k in range(result.sizes["step"]):
        step = result.isel(step=k)
        preload = f"{1e-6 * float(step['preload']):.4g}"
        if not int(step["converged"]) or ("known" in step and np.isnan(step["approach"])):
            missing = "unknown" if int(step["converged"]) else "not converged"
            rows.append(padded((preload, missing), head))
            continue
        row = (
            preload,
            _value(step, "joint_stiffness", scale),
            *_intervals(step, "joint_stiffness", scale),
            _error(step, "joint_stiffness"),
            _part(step, "interface_stiffness", scale),
            _part(step, "solid_stiffness", scale),
        )
        rows.append(row + rest(step))
    return rows


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


def _intervals(step: Dataset, name: str, scale: float) -> list[str]:
    """Both intervals of an answer; empty where there are none, unknown where they are unknown."""
    said, bound = [], _bound(step, name)
    for kind in INTERVALS:
        if f"{name}_{kind}" not in step:
            said.append("")
            continue
        ends = scale * step[f"{name}_{kind}"].values
        said.append(say_ends(scale * float(step[name]), ends, bound))
    return said


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


def _value(step: Dataset, name: str, scale: float) -> str:
    """Answer with the digits that the error of the mean law leaves."""
    half, value = 0.0, float(step[name])
    if f"{name}_mean_law" in step:
        half = 0.5 * float(np.ptp(step[f"{name}_mean_law"].values))
    if _bound(step, name) and half < FOUR_DIGITS * abs(value):
        half = 0.0
    if name in SLIDING and value < NEGLIGIBLE:
        return say_share(value)
    return round_by(scale * value, scale * half)


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


def say_answer(step: Dataset, name: str, scale: float, unit: str = "") -> str:
    """Report an answer with its unit and, in brackets, its intervals, and what they lack."""
    return f"{_value(step, name, scale)}{unit}{say_intervals(step, name, scale)}"


def say_cell(step: Dataset, name: str, scale: float) -> str:
    """Write an answer for a table, in brackets its intervals, with the mark of lower bounds."""
    said = _join_intervals(_intervals(step, name, scale))
    return f"{_value(step, name, scale)}{f' ({said})' if said else ''}"


def say_intervals(step: Dataset, name: str, scale: float) -> str:
    """Report both intervals of an answer, in brackets; nothing if there are none."""
    intervals, missing = _intervals(step, name, scale), _missing(step, name)
    said = _join_intervals(intervals)
    if said and missing and set(intervals) == {"unknown"}:
        said = f"error unknown: {missing}"
    elif said and missing:
        said = f"{said.replace(LOWER_BOUND, '')}; or wider, without {missing}, not known"
    return f" ({said})" if said else ""


def _join_intervals(intervals: Sequence[str]) -> str:
    """Join both intervals of an answer, those that are alike once."""
    kinds: dict[str, str] = {}
    for name, one in zip(INTERVALS.values(), intervals, strict=True):
        kind = name.removesuffix(", 95 %")
        kinds[one] = f"{kinds[one]} and {kind}" if one in kinds else kind
    return "; ".join(f"{kind} {one}" for one, kind in kinds.items() if one)


def say_value(step: Dataset, name: str, unit: Unit) -> str:
    """Say an answer with its unit and its total error, if it has one."""
    return f"{_value(step, name, unit.scale)} {unit.name}{say_beside(_error(step, name))}"


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


def _part(step: Dataset, name: str, scale: float) -> str:
    """Answer with its error, which is left out if it is exact; empty in an earlier version."""
    if name not in step:
        return ""
    error = _error(step, name)
    if error in {"", "0"}:
        return _value(step, name, scale)
    if error == "unknown":
        return f"{_value(step, name, scale)}, error unknown"
    bound = LOWER_BOUND if error.endswith(LOWER_BOUND) else ""
    return f"{_value(step, name, scale)}{say_beside(error.removesuffix(LOWER_BOUND))}{bound}"


def tabulate_prediction(quantity: str, pressure: np.ndarray, found: Prediction) -> Table:
    """Head and rows of predictions of a law at pressures, Pa, with their intervals."""
    unit = Unit("µm", 1e6) if quantity == "gap" else stiffness_unit(found.value)
    rows = []
    for p, value, *ends in zip(
        pressure, found.value, found.mean_law.T, found.next_specimen.T, strict=True
    ):
        half = 0.5 * unit.scale * np.ptp(ends, axis=1)
        least = float(np.nanmin(half)) if np.isfinite(half).any() else 0.0
        said = (say_ends(unit.scale * value, unit.scale * np.array(pair)) for pair in ends)
        rows.append((f"{1e-6 * p:.4g}", round_by(unit.scale * value, least), *said))
    name = quantity.removeprefix("normal_").replace("_", " ")
    intervals = "mean law, 95 %", "next specimen, 95 %"
    return ("pressure (MPa)", f"{name} ({unit.name})", *intervals), rows


def tabulate_links(result: Dataset) -> Table:
    """Return head and rows of text for a structure of links, at most ``MOST_ROWS`` of its steps."""
    along, name = ("time", "time (s)") if "time" in result.coords else ("load_factor", "load")
    rows: list[tuple[str, ...]] = []
    for k in _steps_shown(result):
        step = result.isel(step=k)
        found = ("not converged", "")
        if int(step["converged"]):
            slack, largest = int((step["slack"] > 0.0).sum()), float(step["tension"].max())
            found = (f"{slack}", f"{1e-3 * largest:.4g}")
        rows.append((f"{float(step[along]):.4g}", *found, f"{float(step['residual']):.1e}"))
    return (name, "slack links", "largest tension (kN)", "residual"), rows


def tabulate_grains(result: Dataset) -> Table:
    """Return head and rows of text for a granulate, at most ``MOST_ROWS`` of its steps."""
    names = ("time", "n_contacts", "kinetic_energy", "penetration", "iterations", "residual")
    head = ("time (s)", "contacts", "kinetic (J)", "overlap / R", "sweeps", "error")
    rows = [tuple(f"{float(result[name][k]):.4g}" for name in names) for k in _steps_shown(result)]
    if "stress" not in result:
        return head, rows
    from multiscale.macro.granulate import biaxial_curve

    curve = biaxial_curve(result).isel(step=_steps_shown(result))
    more = zip(curve["axial_strain"].values, curve["stress_ratio"].values, strict=True)
    return (*head, "axial strain", "q/p"), [
        (*row, f"{strain:.4g}", f"{ratio:.4g}")
        for row, (strain, ratio) in zip(rows, more, strict=True)
    ]


def _steps_shown(result: Dataset) -> np.ndarray:
    """At most ``MOST_ROWS`` steps, evenly spread, the first and the last among them."""
    steps = result.sizes["step"]
    return np.unique(np.linspace(0, steps - 1, min(steps, MOST_ROWS)).round().astype(int))


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


def tabulate_budget(result: Dataset, quantity: str | None = None) -> Table:
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


def tabulate_sensitivity(result: Dataset) -> Table:
    """Head and rows of relative changes of answers, in per cent, if parameters are larger.

    Each parameter is larger by its half-width; steps are as of :func:`tabulate_budget`. Answers
    that a parameter does not change have no row.
    """
    known = np.flatnonzero(result["sensitivity"].notnull().any(("parameter", "quantity")))
    some = known[np.unique(np.linspace(0, known.size - 1, MOST_BUDGETS).round().astype(int))]
    one = result.isel(step=some)
    changes = one["sensitivity"].to_numpy()
    rows = [
        (
            parameter,
            quantity,
            *("0" if abs(x) <= ROUNDING else f"{100.0 * x:+.3g}" for x in changes[k, i]),
        )
        for k, parameter in enumerate(map(str, one["parameter"].values))
        for i, quantity in enumerate(map(str, one["quantity"].values))
        if np.any(np.abs(changes[k, i]) > ROUNDING)
    ]
    return ("larger parameter", "change (%) of", *step_labels(one, unit=" MPa")), rows


def tabulate_cycles(result: Dataset) -> Table:
    """Head and rows of the closed cycles at every preload and amplitude, with their intervals."""
    both, unit = (" / ".join(INTERVALS.values()),), joint_unit(result)
    head = (
        "preload (MPa)",
        "amplitude (MPa)",
        *(f"secant stiffness ({unit.name})", *both),
        *("loss per cycle (mJ)", *both),
        *("contact force at sliding (%)", *both),
    )
    shown = (("secant_stiffness", unit.scale), ("cycle_loss", 1e3), ("cycle_slip", 100.0))
    rows: list[tuple[str, ...]] = []
    for level in range(result.sizes["level"]):
        for amplitude in range(result.sizes["amplitude"]):
            one = result.isel(level=level, amplitude=amplitude)
            at = (f"{1e-6 * float(one[name]):.4g}" for name in ("cycle_preload", "cycle_shear"))
            row = []
            for name, scale in shown:
                both_intervals = dict.fromkeys(_intervals(one, name, scale))  # once if alike
                row += [_value(one, name, scale), " / ".join(both_intervals)]
            known = np.isfinite(one["cycle_loss"])
            rows.append((*at, *(row if known else ["unknown", *[""] * (len(row) - 1)])))
    return head, rows


def list_cycles(result: Dataset) -> list[str]:
    """Say what every cycle of a joint has lost, and what slips; nothing for other results."""
    if "cycle_energy" not in result:
        return []
    missing, last = "unknown" if result["converged"].values.all() else "not closed", result.sizes
    told = []
    for k, loss in enumerate(result["cycle_energy"].values):
        one = result.isel(cycle=k)
        at_end = k + 1 == last["cycle"]
        intervals = say_intervals(one, "cycle_energy", 1e3) if at_end else ""
        lost = f"{_value(one, 'cycle_energy', 1e3)} mJ lost{intervals}"
        told.append(f"cycle {k}: {missing if np.isnan(loss) else lost}")
    end = result.isel(step=-1)
    if "slipping_load" in result and not np.isnan(end["slipping_load"]):
        told.append(f"At the amplitude, {say_slip(end)}")
    return told


def say_slip(step: Dataset) -> str:
    """Say which share of the contact force is at sliding, with its intervals, and of the area."""
    return (
        f"{_value(step, 'slipping_load', 100.0)} % of the contact force is at "
        f"sliding{say_intervals(step, 'slipping_load', 100.0)}, more than half of the local "
        f"pressure on {say_share(float(step['slip_fraction']))} % of the nominal area"
    )
