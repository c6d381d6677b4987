"""Stage: two blocks pressed together through the law of their interface."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from multiscale import macro, upscaling
from multiscale.convergence import Status
from multiscale.errors import ConvergenceError
from multiscale.laws import NormalLaw
from multiscale.needs import Choice, Needs
from multiscale.pipeline import real_contact, showing
from multiscale.pipeline.body_sources import UNKNOWN_LAW
from multiscale.pipeline.case_cells import joint_scales
from multiscale.pipeline.stage import Datasets, Section, Stage, list_cautions, with_sample_band
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.third_body import THIRD_BODY_LAW
from multiscale.pipeline.tables.made_bodies import Blocks
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting.budget_figures import plot_error_budget
from multiscale.plotting.figure import WIDE, on_axes
from multiscale.plotting.law_figures import plot_joint_stiffness
from multiscale.schema import MACRO_RESULT, Dataset, with_cautions
from multiscale.upscaling.budget import MACRO, Term, has_budget, known_terms
from multiscale.upscaling.fit import branch_origins
from multiscale.upscaling.reading import TABLE
from multiscale.upscaling.scales import compare_scales
from multiscale.upscaling.shear_budget import shear_errors

TANGENTIAL, AREA = "tangential_stiffness", "area_pressure"

STIFFNESSES = ("joint_stiffness", "interface_stiffness", "solid_stiffness")
"""Stiffnesses of the joint with its bodies, of the interface and of the bodies, with a budget."""

STIFFNESS = (
    "joint_stiffness",
    *(f"joint_stiffness:{form}" for form in ("mean_law", "one_part", "error")),
    "interface_stiffness:±",
    "solid_stiffness:±",
)
"""Columns of the stiffness of joints."""

HEADS = {"interface_stiffness": "interface", "solid_stiffness": "bodies"}

ANSWERS = (
    "preload",
    "joint_stiffness",
    TANGENTIAL,
    "interface_stiffness",
    "mean_gap",
    "contact_fraction",
    "real_pressure",
    "unloading_stiffness",
    *upscaling.CONDUCTANCES,
)

JOINT_TABLE = showing.Table(
    (
        "preload",
        *STIFFNESS,
        "mean_gap",
        "contact_fraction",
        *(f"{name}:±" for name in ("real_pressure", "unloading_stiffness", TANGENTIAL)),
        *(f"{name}:±" for name in upscaling.CONDUCTANCES),
    ),
    HEADS | {"unloading_stiffness": "unloading", TANGENTIAL: "tangential, no slip"},
    answer="joint_stiffness",
)

SENTENCES = (
    "At a preload of {preload} the joint has a stiffness of {joint_stiffness:±}.",
    "{contact_fraction} of its area touches, under a mean pressure of {real_pressure:±}.",
    "The interface has {interface_stiffness:±}, the bodies {solid_stiffness:±}.",
    "At the start of unloading the stiffness of the joint is {unloading_stiffness:±}.",
)


@dataclass(frozen=True, eq=False)
class _PressedBlocks:
    """Blocks of a case with the law of their interface, and what follows from its stiffness."""

    joint: macro.RoughJoint
    law: Dataset
    ratio: float | None  # tangential over normal stiffness, none without friction
    conducts: Mapping[str, float]  # conductances over the stiffness

    @classmethod
    def of(cls, case: Case, law: Dataset) -> "_PressedBlocks":
        """Build the blocks of a case."""
        blocks = cast(Blocks, case.structure)
        lower, upper = (
            macro.Block(blocks.height, body.youngs_modulus, body.poissons_ratio)
            for body in case.bodies
        )
        shears = upscaling.tangential_values(law)
        # without friction there are no tangential springs
        ratio = None if shears.get("friction") == 0.0 else shears.get("stiffness_ratio")
        joint = macro.RoughJoint((blocks.width, blocks.width), lower, upper)
        return cls(joint, law, ratio, upscaling.conductance_ratios(law))

    def from_stiffness(self, K: np.ndarray, ratio: float | None) -> dict[str, np.ndarray]:
        """Return the answers that follow from the stiffness of the interface, Pa/m."""
        values = {name: share * K for name, share in self.conducts.items()}
        if ratio is None:
            return values
        # kappa K in series with blocks in even shear, without slip
        blocks = self.joint.lower.shear_compliance + self.joint.upper.shear_compliance  # m/Pa
        return {TANGENTIAL: 1.0 / (1.0 / (ratio * K) + blocks)} | values

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the answers with an error budget."""
        shear = [TANGENTIAL] * (self.ratio is not None)
        return (*STIFFNESSES, *shear, *self.conducts, *["real_pressure"] * (AREA in self.law))

    def answers(self, preload: np.ndarray, law: NormalLaw, ratio: float | None) -> np.ndarray:
        """Press the blocks through another law: answers over preloads; the real pressure stays."""
        pressed = macro.press_joint(self.joint, law, preload, extrapolate=True)
        values = {name: pressed[name].to_numpy() for name in STIFFNESSES}
        values |= self.from_stiffness(values["interface_stiffness"], ratio)
        return np.stack([values.get(name, np.ones(preload.size)) for name in self.names])


def solve_joint(case: Case, law: Dataset) -> Dataset:
    """Press two blocks together through the law and its samples."""
    blocks, preload = _PressedBlocks.of(case, law), np.array(case.statics.preloads)
    samples = upscaling.fitted_laws(law, range(law.sizes.get("sample", 0)))
    result = macro.press_joint(
        blocks.joint,
        upscaling.law_from_dataset(law),
        preload,
        samples=samples,
        extrapolate=case.extrapolate,
    )
    # real contact, unloading, shear and conduction
    fraction = np.full(preload.shape, np.nan)
    if AREA in law:
        fraction = upscaling.area_from_dataset(law).contact_fraction(preload)
    areas = {
        "contact_fraction": fraction,
        "real_pressure": real_contact.real_pressure(preload, fraction),
    }
    areas |= _unloading_stiffness(law, result)
    areas |= blocks.from_stiffness(result["interface_stiffness"].to_numpy(), blocks.ratio)
    solved = np.isfinite(result["joint_stiffness"].to_numpy())
    areas = {name: np.where(solved, value, np.nan) for name, value in areas.items()}
    # scales of cells and joint, cautions and facts
    law, cautions, share = _compare(case, blocks.joint.section[0], law)
    cautions = [*cautions, *real_contact.zero_of_gap(law)]
    if not has_budget(law) and law.attrs.get("family") != TABLE:  # a table has this caution already
        cautions = [*cautions, UNKNOWN_LAW.format(number=0)]
    result = MACRO_RESULT.assign(with_cautions(result, *cautions), areas)
    below = real_contact.negative_gap(result["mean_gap"].to_numpy(), law)
    facts = [*real_contact.behaviour(law), *share, *below, *_tangential_facts(law, blocks.ratio)]
    result = result.assign_attrs(title=case.title, facts="\n".join(facts))
    steps = np.flatnonzero(solved & (result["known"].values == 1))
    if not steps.size or not has_budget(law):
        return result
    budget = _budget(replace(blocks, law=law), samples, result.isel(step=steps), preload[steps])
    return upscaling.with_intervals(
        upscaling.with_budget(result, upscaling.over_steps(budget, steps, preload.size))
    )


def _budget(
    blocks: _PressedBlocks, samples: Sequence[NormalLaw], known: Dataset, preload: np.ndarray
) -> Dataset:
    law, names, ratio = blocks.law, blocks.names, blocks.ratio
    # samples of the same number of normal law and stiffness ratio were drawn together
    jointly = ratio is not None and len(samples) == law.sizes.get("shear_sample", 0)
    ratios = [ratio] * len(samples)
    if jointly:
        ratios = [float(np.nanmean(row)) for row in law["shear_stiffness_ratio_sample"].values]
    drawn = [blocks.answers(preload, *pair) for pair in zip(samples, ratios, strict=True)] or None
    real = np.array(names) == "real_pressure"
    answer = np.stack([known[name].to_numpy() for name in names])
    answer[real] = 1.0
    exact = "none: blocks and law in series have a closed form under uniform pressure"
    sources: list[upscaling.Source] = [
        *upscaling.law_sources(law, preload, drawn=drawn),
        real_contact.contact_source(law, preload, real),
        upscaling.Bound(name="closed form", bounds={MACRO: Term(exact, np.zeros(answer.shape))}),
    ]
    if blocks.conducts:
        conducting = np.isin(names, list(blocks.conducts))[:, None] * np.ones(preload.size)
        sources.append(upscaling.elastic_source(law, conducting))
    if ratio is not None and branch_origins(law).get("shear") == "measured":
        K = known["interface_stiffness"].to_numpy()
        rate = np.where(np.array(names)[:, None] == TANGENTIAL, answer / (ratio * K), 0.0)
        errors = shear_errors(law, preload).get("stiffness_ratio", {})
        half_width = {term: errors[term] for term in known_terms(law) if term in errors}
        if jointly:
            half_width.pop("sampling", None)
        sources.append(
            upscaling.Uncertainty(name="stiffness ratio", half_width=half_width, rate=rate)
        )

    def again(changed: NormalLaw) -> np.ndarray:
        return blocks.answers(preload, changed, ratio)

    return upscaling.propagate(names, sources, again, answer)


def _tangential_facts(law: Dataset, ratio: float | None) -> list[str]:
    if ratio is None:
        return []
    source = branch_origins(law)["shear"]
    return [
        f"Before slip the tangential stiffness of the interface is {ratio:.3g} times its normal "
        f"stiffness (shear branch of the law: {source}). The tangential stiffness of the joint has "
        f"the interface in series with the blocks in uniform shear, without bending."
    ]


def _compare(case: Case, width: float, law: Dataset) -> tuple[Dataset, Sequence[str], list[str]]:
    """Compare cells and width of the joint, m: adapted law, cautions, and facts."""
    if case.has_cells:
        scales, share = joint_scales(case), upscaling.cell_share(max(case.cell.size), width)
        return law, scales.cautions if scales else (), [share]
    of_file = [f"its law: {caution}" for caution in list_cautions(law)]
    if not {"longest_wave", "cell_size"} <= set(law.attrs):
        return law, of_file, real_contact.unknown_cells(law)
    wave, cell = float(law.attrs["longest_wave"]), float(law.attrs["cell_size"])
    scales = compare_scales(wave, cell, width)
    known = upscaling.with_scales(law, scales) if "cell_scatter" in law else law
    return known, [*of_file, *scales.cautions], [upscaling.cell_share(cell, width)]


def _unloading_stiffness(law: Dataset, result: Dataset) -> dict[str, np.ndarray]:
    """Stiffness of the joint at the start of unloading, and its samples, if cells were unloaded."""
    if "unloading_stiffness_ratio" not in law:
        return {}
    K, solid = (result[name].to_numpy() for name in ("interface_stiffness", "solid_stiffness"))
    ratio: dict[str, Any] = {"unloading_stiffness": float(law["unloading_stiffness_ratio"])}
    if law.sizes.get("unloading_sample"):
        upscaling.require_law(law, "unloading_stiffness_ratio_sample")
        drawn = law["unloading_stiffness_ratio_sample"].to_numpy()[:, None]
        ratio["unloading_stiffness_sample"] = drawn
    return {name: 1.0 / (1.0 / (beta * K) + 1.0 / solid) for name, beta in ratio.items()}


def _needs(case: Case) -> Needs:
    exact = "the pressure on the joint is uniform, and the closed form is exact"
    return Needs(
        choices=(
            Choice("joint", "blocks and interface law in series, in closed form"),
            Choice("joint mesh", exact, built=False),
        ),
        libraries=("matplotlib",),  # the report
        seconds=1.0,
    )


def _check(result: Dataset) -> None:
    if not result["converged"].values.any():
        raise ConvergenceError(
            f"the joint did not converge at any of {result.sizes['step']} preloads: "
            f"{Status.MAX_ITERATIONS.value}"
        )
    if not np.isfinite(result["joint_stiffness"].values).any():
        raise ConvergenceError(f"the joint is unknown at every preload: {result.attrs['cautions']}")


def _answer(result: Dataset) -> Iterator[str]:
    done = np.flatnonzero(np.isfinite(result["joint_stiffness"].values))
    if not done.size:
        yield "No preload has an answer."
        return
    yield from showing.View(result).sentences(result.isel(step=done[done.size // 2]), *SENTENCES)


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    result = datasets[JOINT.name]
    remarks = [*showing.list_missing(result), *showing.list_facts(result)]
    stiffness = {"joint_stiffness": on_axes(plot_joint_stiffness, result, size=WIDE)}
    yield Section("Joint", (), *JOINT_TABLE.rows(result), stiffness, remarks=remarks)
    yield from (replace(section, printed=False) for section in budget_sections(result))


def budget_sections(result: Dataset, *further: str) -> Iterator[Section]:
    """Tabulate the budgets of the first and of ``further`` quantities, then the sensitivities."""
    if "error_total" not in result:
        yield Section("Error budget", ["No error was estimated."])
        return
    drawn = on_axes(plot_error_budget, result, size=WIDE)
    for quantity in (str(result["quantity"].values[0]), *further):
        name = quantity.replace("_", " ")
        yield Section(
            f"Error budget of the {name}" if further else "Error budget",
            [f"Half-widths of 95 % intervals of the {name}, in per cent."],
            *showing.tabulate_budget(result, quantity),
            figures={} if quantity in further else {"error_budget": drawn},
            notes=True,
        )
    head, rows = showing.tabulate_sensitivity(result) if "sensitivity" in result else ((), [])
    if rows:
        caption = (
            "Relative changes of the answers, to first order, if a parameter increases by the "
            "half-width of its 95 % interval and all other parameters are unchanged."
        )
        yield Section("Sensitivity", [caption], head, rows)


JOINT = Stage(
    schema=MACRO_RESULT,
    tables=("structure", "joint"),
    reads={"structure", "interface", "statics", "body_1", "body_2"},
    takes=(FITTED_LAW, THIRD_BODY_LAW),
    run=lambda case, datasets, job: solve_joint(case, case.interface_law(datasets, job.read_law)),
    needs=_needs,
    check=_check,
    question="How stiff is the joint of the two bodies at its preloads, and how much area touches?",
    answer=_answer,
    sections=_sections,
    answers=ANSWERS,
    compared=lambda result: with_sample_band(result, "joint_stiffness"),
)
