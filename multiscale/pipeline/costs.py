"""Seconds of each stage of a run, error of each source, and seconds that halve it."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from multiscale.pipeline.plans.knob_errors import SourceCost, halving_seconds
from multiscale.pipeline.plans.knobs import CaseKnob
from multiscale.pipeline.showing import format_error
from multiscale.pipeline.stage import Section, Shown, Stage
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting.budget_figures import plot_costs
from multiscale.plotting.figure import WIDE, on_axes
from multiscale.schema import Dataset
from multiscale.upscaling.budget import has_budget, total_error

HEAD = ("stage or source of error", "seconds", "error (%)", "seconds to halve it")
SECONDS, INTERVALS = "seconds", "interval_seconds"
"""Attributes of the dataset of a stage: its time, and the part for its intervals, s."""

LEAST = 1e-5
"""Error below which a source is not shown."""


def stage_seconds(datasets: Mapping[str, Dataset], stages: Iterable[Shown]) -> dict[str, float]:
    """Return the time of stages, of their intervals and of cells of earlier runs, s."""
    seconds: dict[str, float] = {}
    for stage in stages:
        dataset = datasets[stage.name]
        time = float(dataset.attrs.get(SECONDS, 0.0))
        if isinstance(stage, Stage) and stage.folders and "wall_time" in dataset:
            time = max(time, float(dataset["wall_time"].sum()))  # with cells of earlier runs
        if again := float(dataset.attrs.get(INTERVALS, 0.0)):
            seconds[f"intervals of {stage.name}"] = again
        seconds[stage.name] = max(time - again, 0.0)
    return seconds


def knobs_of(case: Case, stages: Iterable[Shown]) -> list[CaseKnob]:
    """Return the knobs that stages name, and that the case has."""
    asked = [stage for stage in stages if isinstance(stage, Stage) and stage.asked_for(case.tables)]
    named = {knob.name: knob for stage in asked for knob in stage.knobs(case)}
    return [knob for knob in named.values() if knob.applies(case)]


def source_costs(
    knobs: Sequence[CaseKnob], result: Dataset, seconds: Mapping[str, float]
) -> list[SourceCost]:
    """Return the terms of the first answer of a result, with the time that halves them, s."""
    budget = result.isel(quantity=0)
    half = total_error(budget["error_bias"].values, budget["error_half_width"].values)
    costs = list[SourceCost]()
    terms = map(str, budget["error_term"].values)
    for term, values in zip(terms, half, strict=True):
        error = float(np.nanmax(values, initial=0.0))
        knob, time = next((knob for knob in knobs if term in knob.terms), None), np.nan
        if knob is not None:
            order = float(np.mean(knob.orders))
            time = halving_seconds(seconds, knob.costs, order, knob.adds)
        costs.append(SourceCost(term, error, time))
    return sorted(costs, key=lambda cost: -cost.error)


def cost_section(seconds: Mapping[str, float], costs: Iterable[SourceCost], answer: str) -> Section:
    """Show the seconds of stages next to the errors of sources, per cent."""
    shown = {name: time for name, time in seconds.items() if time >= 0.005}
    costs = [cost for cost in costs if cost.error > LEAST]
    rows = [(name.replace("_", " "), f"{time:.3g}", "", "") for name, time in shown.items()]
    for cost in costs:
        halved = f"{cost.seconds:.3g}" if cost.seconds > 0.0 else "not known"
        if np.isnan(cost.seconds):
            halved = "no setting reduces it"
        rows.append((cost.name, "", format_error(cost.error), halved))
    figure = on_axes(plot_costs, shown, [(c.name, c.error, c.seconds) for c in costs], size=WIDE)
    text = (
        f"Time of the stages, and the largest 95 % error of the {answer} by its sources; the last "
        f"column is the time of a finer setting with half of the error."
    )
    return Section("Time and error", [text], HEAD, rows, {"time_and_error": figure}, printed=False)


def run_costs(
    case: Case, stages: Iterable[Shown], datasets: Mapping[str, Dataset]
) -> list[Section]:
    """Return the section on time and error of a run; empty without an error budget."""
    listed = [stage for stage in stages if stage.name in datasets]
    seconds = stage_seconds(datasets, listed)
    for stage in listed[::-1]:
        result = datasets[stage.name]
        if has_budget(result):
            answer = str(result["quantity"].values[0]).replace("_", " ")
            return [
                cost_section(seconds, source_costs(knobs_of(case, listed), result, seconds), answer)
            ]
    return []
