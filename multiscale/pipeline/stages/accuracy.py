"""Stage: the setting of least time at which an answer reaches a target for its error."""

import json
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import make_folder, write_bytes
from multiscale.needs import Choice, Needs
from multiscale.pipeline.costs import cost_section, knobs_of, stage_seconds
from multiscale.pipeline.plans.case_knobs import refuse_surfaces
from multiscale.pipeline.plans.knob_errors import Outcome, SourceCost
from multiscale.pipeline.plans.knobs import CaseKnob, Setting
from multiscale.pipeline.plans.planner import Planner, Reached
from multiscale.pipeline.showing import format_error, round_by
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.cells import CELLS
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import ACCURACY, INTERFACE_LAW, SHOWN, Dataset
from multiscale.units import readable
from multiscale.upscaling.budget import OF_ONE_PART, has_budget, unknown_terms

logger = logging.getLogger(__name__)

INPUTS = ("fit_pressure", "nominal_pressure", "preload", "sliding_speed", "porosity")
"""Variables next to the answers of stages that have no error."""

PRESSURES = INPUTS[:3]

PLAN = "plan"
"""Folder of the settings in a run folder."""

HEAD = (
    "round",
    "error (%)",
    "expected error",
    "seconds",
    "expected seconds",
    "powers of two of settings, over the case as it is given",
)

SAME = 0.01
"""Relative difference of pressures that are the same."""

OF_LAW = ("mean_gap", "contact_fraction", "stiffness")
"""Answers by ``quantity`` that are of the interface law."""


@dataclass(frozen=True, eq=False)
class Asked:
    """An answer of a stage."""

    stage: Stage
    name: str

    @property
    def label(self) -> str:
        """Its name in words."""
        return SHOWN[self.name].answer

    def values(self, datasets: Datasets) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the answer and the ends of its interval, if it has any."""
        compared = self.stage.compared(datasets[self.stage.name])
        value, band = compared[self.name], compared.get(f"{self.name}_mean_law")
        ends = None if band is None else band.transpose("limit", *value.dims).to_numpy()
        return value.to_numpy().ravel(), None if ends is None else ends.reshape(2, -1)

    def pressures(self, datasets: Datasets) -> np.ndarray | None:
        """Return the pressures of its places, Pa; None if it does not depend on a pressure."""
        compared = self.stage.compared(datasets[self.stage.name])
        for name in PRESSURES:
            if name in compared and compared[name].dims == compared[self.name].dims:
                return np.asarray(compared[name].to_numpy())
        return None

    def is_at(self, pressures: np.ndarray | None, asked: float) -> np.ndarray:
        """Whether a place of the answer is at a pressure, Pa."""
        if pressures is None:
            raise CaseError(
                f"at in [accuracy] is a pressure, and the {self.label} depends on no pressure; "
                f"leave it out"
            )
        near = np.abs(pressures / asked - 1.0) < SAME  # zero may be among them
        if not near.any():
            listed = ", ".join(f"{1e-6 * p:.4g}" for p in pressures)
            raise CaseError(
                f"at in [accuracy] is {1e-6 * asked:.4g} MPa, and the {self.label} is computed at "
                f"{listed} MPa; give one of these pressures"
            )
        return np.asarray(near)

    def errors(
        self, datasets: Datasets, places: Sequence[int]
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return relative half-widths and biases of the mean law at places, by terms."""
        dataset, (value, ends) = datasets[self.stage.name], self.values(datasets)
        compared = self.stage.compared(dataset)
        if "step" in compared[self.name].dims and has_budget(compared):
            dataset = compared  # with the budget at the steps of the answer, such as the first mode
        half_widths, biases = dict[str, np.ndarray](), dict[str, np.ndarray]()
        names = self.quantities(dataset)
        if not names and ends is not None:
            half_widths["sampling"] = 0.5 * np.ptp(ends[:, places], axis=0) / np.abs(value[places])
        for term in map(str, dataset["error_term"].values) if names else ():
            half, bias = (
                dataset[name].sel(quantity=names, error_term=term).transpose("quantity", "step")
                for name in ("error_half_width", "error_bias")
            )
            widths, shifts = half.to_numpy(), bias.to_numpy()
            certain, shifted = np.isfinite(widths).all(axis=0), np.any(shifts, axis=0)
            if term in OF_ONE_PART or not np.any(certain | shifted):
                continue
            for rows, of_term, given in (
                (half_widths, widths, certain),
                (biases, shifts, shifted),
            ):
                if len(names) == 1 and of_term.shape[1] == value.size:  # of every step
                    every = of_term[0]
                else:  # of the last step that has it, of every load
                    every = of_term[:, np.flatnonzero(given)[-1] if given.any() else -1]
                if every.size != value.size:
                    every = np.full(value.size, every[np.argmax(np.abs(every))])
                rows[term] = every[places]
        return half_widths, biases

    def quantities(self, dataset: Dataset) -> list[str]:
        """Return the quantities of the budget that are this answer, such as one for each load."""
        if not has_budget(dataset):
            return []
        named = map(str, dataset["quantity"].values)
        return [name for name in named if name == self.name or name.startswith(f"{self.name} ")]


def find_answers(case: Case, stages: Sequence[Stage]) -> list[Asked]:
    """Return the answers that ``[accuracy]`` may mean, the last stage first."""
    accuracy = case.accuracy
    every = [
        Asked(stage, name)
        for stage in stages[::-1]
        for name in stage.answers
        if name not in INPUTS and stage.asked_for(case.tables)
    ]
    if accuracy.quantity is not None:
        of_law = accuracy.quantity in OF_LAW
        answers = [
            asked
            for asked in every
            if asked.name == accuracy.quantity
            and (asked.stage.name == INTERFACE_LAW.name or not of_law)
        ]
    elif accuracy.of is None:
        answers = every[:1]
    else:
        words = set(accuracy.of.lower().replace("_", " ").split())
        exact = [asked for asked in every if accuracy.of in (asked.name, asked.label)]
        answers = exact or [
            asked
            for asked in every
            if words <= {*asked.name.split("_"), *asked.label.lower().split()}
        ]
    if not answers:
        raise CaseError(
            f"{case.title}: {accuracy.answer!r} in [accuracy] is not an answer of this case; its "
            f"answers are {_listed(every) or 'none'}"
        )
    if len({asked.name for asked in answers}) > 1:
        raise CaseError(
            f"{case.title}: {accuracy.answer!r} in [accuracy] may be "
            f"{_listed(answers)}; give one of these names as of"
        )
    return answers


def _listed(answers: Sequence[Asked]) -> str:
    return ", ".join(dict.fromkeys(f"{asked.name!r} ({asked.label})" for asked in answers))


@dataclass(eq=False)
class Campaign:
    """The settings of a case that were solved, also in an earlier run."""

    case: Case  # without a target
    knobs: Sequence[CaseKnob]
    stages: Sequence[Stage]
    answers: Sequence[Asked]
    job: Job
    file: Path  # record of all settings
    pressure: float | None = None  # of the answer, Pa
    record: dict[str, dict[str, Any]] = field(default_factory=dict)
    counted: set[str] = field(default_factory=set)  # settings of this plan
    places: list[int] = field(default_factory=list)  # of the answer in its array
    pressures: list[float] = field(default_factory=list)  # of the places, Pa; empty without any
    missing: list[str] = field(default_factory=list)  # unknown terms of the last budget
    answer: int = 0  # its number

    def at(self, setting: Setting) -> Case:
        """Return the case at a setting."""
        case = self.case
        for knob in self.knobs:
            case = knob.change(case, setting[knob.name])
        return case

    def solve(self, setting: Setting, whole: bool) -> Outcome:
        """Return the answer at a setting, solved or from the record."""
        case = self.at(setting)
        first = self.answers[0]
        asked = first.stage.name, first.name, self.pressure, case.checksum()[:16], whole
        key = " ".join(map(str, asked))
        if key not in self.record:
            begin = perf_counter()
            datasets = self.job.solve(self.folder(case), case, whole)
            self.record[key] = self._entry(case, datasets, whole, perf_counter() - begin)
            write_bytes(self.file, json.dumps(self.record).encode())
        entry = self.record[key]
        self.counted.add(key)
        if whole:
            self.answer, self.places = entry["answer"], entry["places"]
            self.pressures, self.missing = entry.get("pressures", []), entry["missing"]
        half, bias = (
            {term: np.array(values) for term, values in entry[kind].items()}
            for kind in ("half_width", "bias")
        )
        ratio = {knob.name: knob.ratio(case) for knob in self.knobs if whole and knob.measured}
        return Outcome(np.array(entry["value"]), half, entry["seconds"], bias, ratio)

    def folder(self, case: Case) -> Path:
        """Return the folder of a case: settings with the same cells share them."""
        return Path(PLAN) / case.identity()[:12]

    def spent(self) -> float:
        """Time of the settings of this plan, s."""
        return sum(float(self.record[key]["elapsed"]) for key in self.counted)

    def _entry(self, case: Case, datasets: Datasets, whole: bool, elapsed: float) -> dict[str, Any]:
        """Return the record of a solved setting: the answer at its places, errors and times."""
        half, bias = dict[str, np.ndarray](), dict[str, np.ndarray]()
        missing = list[str]()
        if whole:
            read = [asked.values(datasets) for asked in self.answers]
            self.answer = next((k for k, (_, ends) in enumerate(read) if ends is not None), 0)
            value, ends = read[self.answer]
            asked = self.answers[self.answer]
            known = np.isfinite(value if ends is None else ends.sum(axis=0))
            known &= value != 0.0  # no error is relative to zero
            pressures = asked.pressures(datasets)
            if self.pressure is not None:
                known &= asked.is_at(pressures, self.pressure)
            self.places = np.flatnonzero(known).tolist()
            if not self.places:
                raise CaseError(
                    f"{case.title}: the {asked.label} is zero or not known, and has no relative "
                    f"error; choose another answer, or another pressure by at in [accuracy]"
                )
            value = value[self.places]
            self.pressures = [] if pressures is None else pressures[self.places].tolist()
            half, bias = asked.errors(datasets, self.places)
            names = asked.quantities(datasets[asked.stage.name])
            missing = unknown_terms(datasets[asked.stage.name], *names) if names else []
        else:
            value = self.answers[self.answer].values(datasets)[0][self.places]
        asked_for = [stage for stage in self.stages if stage.asked_for(case.tables)]
        return {
            "value": value.tolist(),
            "half_width": {term: rows.tolist() for term, rows in half.items()},
            "bias": {term: rows.tolist() for term, rows in bias.items()},
            "seconds": stage_seconds(datasets, asked_for),
            "elapsed": elapsed,
            "answer": self.answer,
            "places": self.places,
            "pressures": self.pressures,
            "missing": missing,
        }


def open_campaign(case: Case, stages: Sequence[Stage], job: Job) -> Campaign:
    """Return the campaign of a case with a target."""
    bare = case.model_copy(update={"accuracy": None})
    if case.has_cells:  # the knobs of the grid compare the answers instead
        micro = case.micro.model_copy(update={"coarser": 0})
        bare = bare.model_copy(update={"micro": micro})
    file = make_folder(job.out / PLAN) / "settings.json"
    record = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    knobs = knobs_of(bare, stages)
    answers, pressure = find_answers(case, stages), case.accuracy.at
    return Campaign(bare, knobs, stages, answers, job, file, pressure, record)


def planned_case(case: Case, plan: Dataset, stages: Sequence[Stage], job: Job) -> tuple[Path, Case]:
    """Return the case at the last setting of a plan, and its folder in the run folder."""
    campaign = open_campaign(case, stages, job)
    rungs = plan["rung"].isel(round=-1)
    setting = {str(name): int(rungs.sel(knob=name)) for name in plan["knob"].values}
    chosen = campaign.at(setting)
    return campaign.folder(chosen), chosen


def _plan(case: Case, stages: Sequence[Stage], job: Job) -> Dataset:
    """Solve settings until the answer reaches its target, or the time is over."""
    campaign, accuracy = open_campaign(case, stages, job), case.accuracy
    if not campaign.knobs:
        raise CaseError(
            f"{case.title}: no stage of the case has a setting that [accuracy] may change"
        )
    lines = list[str]()

    def report(line: str) -> None:
        lines.append(line)
        logger.info("%s", line)

    planner = Planner(
        campaign.knobs,
        campaign.solve,
        {knob.name: knob.lowest(campaign.case) for knob in campaign.knobs},
        inf if accuracy.target is None else accuracy.target,
        inf if accuracy.time is None else accuracy.time,
        campaign.spent,
        report,
        lambda done, total: job.progress(round(done), round(total), "s until the target"),
    )
    reached = planner.run()
    asked = campaign.answers[campaign.answer]
    replaced = {term for knob in campaign.knobs if knob.measured for term in knob.terms}
    missing = [term for term in campaign.missing if term not in replaced]
    if fixed := reached.state.fixed(float(reached.error.max())):
        listed = ", ".join(f"{term} ({100.0 * half:.2g} %)" for term, half in fixed.items())
        lines.append(f"No setting reduces: {listed}.")
    if isfinite(planner.time):
        left = max(planner.time - campaign.spent(), 0.0)
        lines.append(f"{left:.3g} s of the time remain.")
    if reached.halving is not None:
        lines.append(
            f"Half of the error takes about {reached.halving.expected_seconds:.3g} s more."
        )
    return _dataset(case, asked, reached, lines, campaign, missing)


def _dataset(
    case: Case,
    asked: Asked,
    reached: Reached,
    lines: Sequence[str],
    campaign: Campaign,
    missing: Sequence[str],
) -> Dataset:
    rounds, sources, state = reached.rounds, reached.sources, reached.state
    knobs = [knob.name for knob in campaign.knobs]
    unit = SHOWN[asked.name].in_unit(state.value)
    cautions = [reached.stopped] if reached.stopped else []
    if missing:
        cautions.append(f"the error of the answer lacks unknown terms: {', '.join(missing)}")
    if case.has_cells and case.cell.depth is not None:
        cautions.append(
            f"depth in [cell] is {readable(f'{case.cell.depth:.4g} m')} for the cells of all "
            f"sizes that [accuracy] compares, so their errors include errors of the depth; "
            f"leave depth out, and it grows with the cells"
        )
    seconds = state.outcome.seconds
    dataset = ACCURACY.build(
        {
            "value": state.value,
            "error": reached.error,
            "solved_value": state.outcome.value,
            **({"pressure": campaign.pressures} if campaign.pressures else {}),
            "rung": [[done.setting[name] for name in knobs] for done in rounds],
            "round_error": [done.error for done in rounds],
            "round_seconds": [done.seconds for done in rounds],
            "expected_error": [done.expected_error for done in rounds],
            "expected_seconds": [done.expected_seconds for done in rounds],
            "source_error": [source.error for source in sources],
            "halving_seconds": [source.seconds for source in sources],
            "stage_seconds": [*seconds.values()],
        },
        title=case.title,
        answer=asked.name,
        label=asked.label,
        unit=unit.name,
        scale=unit.scale,
        target=case.accuracy.target or np.nan,
        plan="\n".join(lines),
        stopped=reached.stopped,
        cautions="\n".join(cautions),
    )
    names = [source.name for source in sources]
    return dataset.assign_coords(knob=knobs, source=names, stage=[*seconds])


def _answer(plan: Dataset) -> Iterator[str]:
    attributes = plan.attrs
    value, error = float(attributes["scale"]) * plan["value"].values, plan["error"].values
    unit = "" if attributes["unit"] == "1" else f" {attributes['unit']}"
    pressures = plan["pressure"].values if "pressure" in plan else np.full(value.size, np.nan)
    listed = ", ".join(
        f"{round_by(x, e * abs(x))}{unit} ± {format_error(e)} %"
        + (f" at {1e-6 * p:.4g} MPa" if isfinite(p) else "")
        for x, e, p in zip(value, error, pressures, strict=True)
    )
    target, done = float(attributes["target"]), plan.sizes["round"]
    below = f", below the target of {100.0 * target:.3g} %" if error.max() <= target else ""
    spent = float(plan["round_seconds"].sum())
    yield (
        f"The {attributes['label']} is {listed} (95 %){below}, after {done} "
        f"round{'s' * (done > 1)} and {spent:.3g} s."
    )
    added = plan["value"].values / plan["solved_value"].values - 1.0
    if np.any(np.abs(added) > 1e-6):
        most = added[np.argmax(np.abs(added))]
        yield (
            f"It contains corrections of up to {100.0 * most:+.2g} % from the differences to "
            f"coarser settings; the tables of the last setting do not contain them."
        )


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    plan = datasets[ACCURACY.name]
    remarks = str(plan.attrs["plan"]).splitlines()
    rows = [_row(plan.isel(round=k), k + 1) for k in range(plan.sizes["round"])]
    yield Section("Accuracy", (), HEAD, rows, remarks=remarks, notes=True)
    sources = [
        SourceCost(str(name), float(error), float(time))
        for name, error, time in zip(
            *(plan[name].values for name in ("source", "source_error", "halving_seconds")),
            strict=True,
        )
    ]
    seconds = dict(zip(map(str, plan["stage"].values), plan["stage_seconds"].values, strict=True))
    yield cost_section(seconds, sources, str(plan.attrs["label"]))


def _row(done: Dataset, number: int) -> tuple[str, ...]:
    rungs = zip(map(str, done["knob"].values), done["rung"].values, strict=True)
    moved = ", ".join(f"{name} {int(rung):+d}" for name, rung in rungs if rung)
    formats = {"error": format_error, "seconds": "{:.3g}".format}
    values = [
        (form, float(done[f"{kind}_{what}"]))
        for what, form in formats.items()
        for kind in ("round", "expected")
    ]
    shown = (form(value) if isfinite(value) else "" for form, value in values)
    return (str(number), *shown, moved)


def _prepare(case: Case, stages: Sequence[Stage]) -> None:
    """Refuse a wrong target."""
    find_answers(case, stages)
    if not case.has_cells:
        return
    refuse_surfaces(case)
    needs, time = CELLS.needs(case), case.accuracy.time
    cell = needs.seconds / case.micro.realisations
    if time is not None and time < cell:
        raise CaseError(
            f"{case.title}: time in [accuracy] is {time:.3g} s, and a cell takes about "
            f"{cell:.3g} s; give more time, or fewer points"
        )


def accuracy_stage(stages: tuple[Stage, ...]) -> Stage:
    """Return the stage that plans the settings of other stages."""

    def needs(case: Case) -> Needs:
        knobs = ", ".join(knob.name for knob in knobs_of(case, stages))
        return Needs(
            choices=(
                Choice(
                    "planner",
                    f"starts from coarser settings than these and chooses the settings of the "
                    f"answer: {knobs}",
                ),
            )
        )

    return Stage(
        schema=ACCURACY,
        tables=("accuracy",),
        reads={"accuracy"},
        takes=stages,
        run=lambda case, datasets, job: _plan(case, stages, job),
        needs=needs,
        prepare=lambda case: _prepare(case, stages),
        sections=_sections,
        question="How large is the answer, with an error below the target?",
        answer=_answer,
        failure=lambda plan: str(plan.attrs["stopped"]),
        folders=(PLAN,),
    )
