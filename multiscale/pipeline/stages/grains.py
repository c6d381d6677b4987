"""Stage: rigid grains in frictional contact."""

from collections.abc import Iterator
from dataclasses import replace
from math import ceil

import numpy as np

from multiscale.io.fields import write_grain_fields
from multiscale.macro import granulate
from multiscale.macro.granulate.model import grain_needs
from multiscale.needs import Needs
from multiscale.pipeline.showing import Rows, Table
from multiscale.pipeline.stage import Datasets, Job, Section
from multiscale.pipeline.structure_stage import structure_stage
from multiscale.pipeline.tables.grain_settings import Granulate
from multiscale.pipeline.tables.meshed_bodies import doubt_density
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting.figure import on_axes
from multiscale.plotting.grain_figures import grain_pictures
from multiscale.schema import GRANULATE, Dataset, with_cautions

STEP_TIME, GRAIN_TIME = 1.5e-3, 1e-5  # s of a step, and of a grain in it, about
LAST = 0.2  # share of the motion over which means are taken
UNSETTLED = 0.05  # relative difference of load and weight above which grains are in motion
STEADY = 3.0  # diameters of a grain after which a layer may slide steadily
MOVING = 0.01  # kinetic energy of grains that still run, over its largest value
RIGID = 5.0  # times more sweeps of rigid contacts, about


def _solve(given: Granulate, case: Case, datasets: Datasets, job: Job) -> Dataset:
    """Follow the grains; the attribute ``cautions`` counts steps that missed the tolerance."""
    grains, motion = case.grains, case.motion
    steps = ceil(motion.duration / motion.step)  # at least: an accuracy makes more
    job.progress(0, steps, "time steps")  # the time of the first step gives the remaining time
    result = granulate.simulate_grains(
        given.build(grains, motion),
        motion.duration,
        motion.step,
        accuracy=motion.accuracy,
        solver=motion.solver,
        n_frames=motion.frames,
        callback=lambda step, _: job.progress(step + 1, max(step + 1, steps), "time steps"),
    )
    result = given.measured(result).assign_attrs(question=given.question)
    return with_cautions(result, *doubt_density("the material of the grains", grains.density))


def _needs(given: Granulate, case: Case) -> Needs:
    grains, motion = case.grains, case.motion
    needs = grain_needs(
        grains.number,
        motion.frames,
        grains.law,
        motion.solver,
        wall_friction=given.roughest_wall,
        strained=given.strained,
    )
    each = GRAIN_TIME * (1.0 if grains.law.compliance > 0.0 else RIGID)
    steps = motion.duration / motion.step
    return replace(needs, seconds=(STEP_TIME + each * grains.number) * steps)


def _answer(result: Dataset) -> Iterator[str]:
    for name, report in REPORTS.items():
        if name in result:
            yield from report(result)
    sweeps, seconds = (float(result[name].mean()) for name in ("iterations", "wall_time"))
    yield (
        f"A step of {result.sizes['grain']} grains takes on average {sweeps:.3g} sweeps and "
        f"{1e3 * seconds:.3g} ms."
    )


def _late(result: Dataset, name: str, share: float) -> tuple[float, float, float]:
    """Mean of a quantity over the last share of the motion, and its least and largest value."""
    values = result[name].to_numpy()[-max(1, round(share * result.sizes["step"])) :]
    return float(values.mean()), float(values.min()), float(values.max())


def _report_weight(result: Dataset) -> Iterator[str]:
    sides, least, most = _late(result, "side_share", LAST)
    floor, *_ = _late(result, "floor_share", LAST)
    yield (
        f"In the last fifth of the motion the side walls carry {100.0 * sides:.3g} % of the weight "
        f"of the grains ({100.0 * least:.3g} to {100.0 * most:.3g} %), the floor "
        f"{100.0 * floor:.3g} %."
    )
    if abs(sides + floor - 1.0) > UNSETTLED:
        yield (
            f"Together they carry {100.0 * (sides + floor):.3g} %: the grains are not at rest; use "
            f"a longer duration."
        )
    force = np.linalg.norm(granulate.network(result)[1], axis=1)
    if force.size:
        weight = -granulate.Model.gravity[2] * float(result["mass"].mean())
        yield f"The largest contact force is {force.max() / weight:.3g} times a grain's weight."


def _report_run_out(result: Dataset) -> Iterator[str]:
    last, energy = float(result["run_out"][-1]), result["kinetic_energy"].to_numpy()
    when = f"After {float(result['time'][-1]):.3g} s"
    if last > 0.0:
        edge = (result["position"][-1, :, 0] + result["radius"]).to_numpy()
        most = 1e3 * (np.percentile(edge - edge.max(), 95.0) + last)
        yield (
            f"{when} the farthest grain is {1e3 * last:.4g} mm beyond the gate, and 95 % of the "
            f"grains are within {most:.4g} mm of it."
        )
    else:
        yield f"{when} no grain has passed the gate."
    if energy[-1] > MOVING * energy.max():
        yield (
            f"The grains still move, with {100.0 * energy[-1] / energy.max():.3g} % of their "
            f"largest kinetic energy: they spread farther; use a longer duration."
        )


def _report_plate(result: Dataset) -> Iterator[str]:
    shear, *ends = (1e-3 * value for value in _late(result, "plate_shear", 0.5))
    pressure = 1e-3 * _late(result, "plate_pressure", 0.5)[0]
    if not pressure > 0.0:
        yield (
            "In the second half of the motion the grains carry no load of the plate, so the "
            "friction coefficient is unknown; start with denser grains, or use a longer duration."
        )
        return
    yield (
        f"In the second half of the motion the layer has a mean shear stress of {shear:.3g} kPa "
        f"({ends[0]:.3g} to {ends[1]:.3g} kPa in single steps) under a pressure of "
        f"{pressure:.3g} kPa, a friction coefficient of {shear / pressure:.2g}."
    )
    slip, grain = float(result["plate_slip"][-1]), 2.0 * float(result["radius"].mean())
    if slip < STEADY * grain:
        yield (
            f"The plate has slid by {slip / grain:.2g} diameters of a grain, and the stress of "
            f"steady sliding is unknown below {STEADY:g}; use a longer duration."
        )


def _report_cell(result: Dataset) -> Iterator[str]:
    curve = granulate.biaxial_curve(result)
    ratio, strain = curve["stress_ratio"].to_numpy(), 100.0 * curve["axial_strain"].to_numpy()
    volume = 100.0 * float(curve["volumetric_strain"][-1])
    known = np.flatnonzero(np.isfinite(ratio))
    if known.size:
        peak, last = known[np.argmax(ratio[known])], known[-1]
        end = "at the end" if last == ratio.size - 1 else "in the last step with stress"
        yield (
            f"The stress ratio q/p is at most {ratio[peak]:.3g}, at an axial strain of "
            f"{strain[peak]:.2g} %, and {ratio[last]:.3g} {end}, at {strain[last]:.2g} %."
        )
    else:
        yield (
            "The cell has no stress in any step, so the stress ratio q/p is unknown; start "
            "with denser grains, or compress the cell more."
        )
    changed = "compacted" if volume > 0.0 else "dilated"
    yield f"By then the cell has {changed} by {abs(volume):.2g} %."


REPORTS = {
    "side_share": _report_weight,
    "run_out": _report_run_out,
    "plate_shear": _report_plate,
    "stress": _report_cell,
}
"""Sentences of the quantities that a motion may have."""


def _sections(result: Dataset) -> Iterator[Section]:
    caption = ["Forces and grains are of the last stored frame."]
    figures = {name: on_axes(plot) for name, plot in grain_pictures(result).items()}
    yield Section("Grains", caption, figures=figures)


def _compared(result: Dataset) -> Dataset:
    """Return the state of the grains, with the stress ratio of a cell that is strained."""
    return result.merge(granulate.biaxial_curve(result)) if "stress" in result else result


STATE = ("n_contacts", "kinetic_energy", "penetration")
ANSWERS = (*STATE, "stress_ratio", "side_share", "plate_shear")


def _tabulate(result: Dataset) -> Rows:
    return TABLE.rows(_compared(result))


TABLE = Table(
    ("time", *STATE, "iterations", "residual", "axial_strain", "stress_ratio"),
    {"iterations": "sweeps", "residual": "error"},
    most=11,
)

GRAINS = structure_stage(
    "grains",
    _solve,
    _needs,
    _tabulate,
    write_grain_fields,
    reads={"structure", "grains", "motion"},
    question=Granulate.question,
    schema=GRANULATE,
    solver=(),
    check=lambda result: None,
    more=_sections,
    answer=_answer,
    answers=ANSWERS,
    compared=_compared,
)
