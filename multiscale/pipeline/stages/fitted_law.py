"""Stage: the interface law fitted to the cells of two rough bodies."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from multiscale import upscaling
from multiscale.io import open_dataset
from multiscale.needs import Needs, join_needs
from multiscale.pipeline.calibrated_law import (
    calibrate_case,
    calibration_needs,
    calibration_tables,
    prepare_calibration,
)
from multiscale.pipeline.case_cells import case_budget
from multiscale.pipeline.real_contact import behaviour, negative_gap
from multiscale.pipeline.showing import ROUNDING, View, list_missing
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.cells import CELLS
from multiscale.pipeline.stages.ensembles import (
    COARSER_CELLS,
    COARSER_SHEAR,
    CONTROL_CELLS,
    POINT_FRICTION,
    SHEARED_CELLS,
    SLIDING,
)
from multiscale.pipeline.tables.rough_bodies import CONDUCTIVITIES
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting import law_figures
from multiscale.plotting.figure import Axes, on_axes
from multiscale.plotting.surface_figures import plot_flow_channels
from multiscale.schema import FIELDS, INTERFACE_LAW, MICRO_RESPONSE, Dataset
from multiscale.upscaling.budget import MODEL, known_error
from multiscale.upscaling.fit import branch_origins
from multiscale.upscaling.sampling import half_range
from multiscale.upscaling.shear_budget import BED, loss_terms, with_loss_grid
from multiscale.upscaling.transport import with_conductance, with_leakage

CLOSED = 1.0 - 1e-6  # contact fraction above which the gap is closed
FIT_TIME, SAMPLE_TIME = 1.0, 0.03  # s of a fit, and of each of its samples, about
OPEN = (
    "At {fit_pressure} the mean gap of the interface is {mean_gap:±}, its stiffness {stiffness:±} "
    "and its contact fraction {contact_fraction:±}."
)
FLAT = (
    "At {fit_pressure} the interface is in full contact: its roughness is flattened, and it "
    "adds no compliance to the bodies."
)
"""Answers at a pressure, with an open and with a closed gap."""

FITTED = (
    *("n_realisations", "pressure_min", "pressure_max", "pressures_per_decade", "branches"),
    *("cross_validated_error", "cross_validated_stiffness_error", "admissibility"),
)
"""Attributes of a law of cells that its description needs."""

EXPORTED = 0.01  # relative error of the pressure between the points of the exported tables


def _run(case: Case, datasets: Datasets, job: Job) -> Dataset:
    response, sliding = datasets[MICRO_RESPONSE.name], datasets.get(SLIDING.name)
    steady = sliding is not None and bool(np.isfinite(sliding["steady_friction"]).any())
    control = datasets.get(CONTROL_CELLS.name)
    law = upscaling.fit_branches(
        response,
        control=control,
        shear=datasets.get(SHEARED_CELLS.name),
        sliding=sliding if steady else None,
        apart=case.law.apart,
        n_terms=case.law.terms,
        n_samples=case.law.samples,
    )
    pressed, sheared = _on_grids(case, datasets)
    law = with_loss_grid(law, sheared)
    law = with_conductance(
        law, case.conductivities, response.attrs["contact_modulus"], flows=case.hardness is not None
    )
    if case.micro.leakage:
        law = with_leakage(law, response, datasets.get(COARSER_CELLS.name))
    budget = case_budget(case, upscaling.loading_branch(response), law, pressed, sheared, control)
    law = upscaling.with_budget(law, budget)
    return law if case.measured is None else calibrate_case(case, law, job).law


def _on_grids(case: Case, datasets: Datasets) -> tuple[dict[float, Dataset], dict[float, Dataset]]:
    """Responses and sheared laws of the first cells by the ratio of the spacings; empty without."""
    if not case.micro.coarser:
        return {}, {}
    pressed = {
        1.0: upscaling.loading_branch(datasets[MICRO_RESPONSE.name]),
        2.0: datasets[COARSER_CELLS.name],
    }
    pressed = {
        ratio: cells.isel(realisation=range(case.micro.coarser)) for ratio, cells in pressed.items()
    }
    if case.micro.shear is None:
        return pressed, {}
    sheared = {1.0: datasets[SHEARED_CELLS.name], 2.0: datasets[COARSER_SHEAR.name]}
    n = sheared[2.0].sizes["realisation"]
    laws = {
        ratio: upscaling.fit_branches(
            pressed[ratio], shear=cells.isel(realisation=range(n)), apart=False, n_samples=0
        )
        for ratio, cells in sheared.items()
    }
    return pressed, laws


class _Part(NamedTuple):
    """Paragraphs and figures on a part of a law."""

    lines: Sequence[str]
    figures: Mapping[str, Callable[[Path], Path]]


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    response, law = datasets[MICRO_RESPONSE.name], datasets[FITTED_LAW.name]
    parts = [_describe_fit(law, response)]
    if "unloading_stiffness_ratio" in law:
        parts.append(_describe_unloading(law, response))
    conducts = upscaling.conductances(law, law["fit_pressure"].to_numpy())
    if conducts:
        parts.append(_describe_conductance(law))
    if "hydraulic_aperture" in law:
        parts.append(_describe_leakage(law, out / "fields" / "fields.nc"))
    if sheared := SHEARED_CELLS.name in datasets:
        parts.append(_describe_shear(law, datasets[SHEARED_CELLS.name].attrs[POINT_FRICTION]))
    files: dict[str, Callable[[Path], object]] = {
        "law.csv": partial(upscaling.write_law_table, law)
    }
    for code in ("abaqus", "calculix"):
        files[f"{code}.inp"] = partial(
            upscaling.write_pressure_overclosure,
            law,
            tolerance=EXPORTED,
            friction_for=code if sheared else None,
            conductance_for=code if "thermal_conductance" in conducts else None,
        )
    lines = [line for part in parts for line in part.lines]
    figures = dict(chain.from_iterable(part.figures.items() for part in parts))
    yield Section("Interface law", lines, figures=figures, files=files)
    for title, head, rows in calibration_tables(law):
        drawn = f"The samples amount to {law.attrs['effective_draws']:.3g} independent draws."
        yield Section(title, [*str(law.attrs["calibration"]).splitlines(), drawn], head, rows)


def _describe_fit(law: Dataset, response: Dataset) -> _Part:
    upscaling.require_law(law, *FITTED)
    attributes, branches = law.attrs, branch_origins(law).items()
    count = int(attributes["n_realisations"])
    sources = ", ".join(f"{branch} is {how}" for branch, how in branches)
    lines = [
        f"The law describes: {response.attrs['bodies']}. It is fitted to {count} "
        f"realisation{'s' * (count > 1)} between {1e-6 * attributes['pressure_min']:.4g} and "
        f"{1e-6 * attributes['pressure_max']:.4g} MPa, with "
        f"{attributes['pressures_per_decade']:.2g} pressures per decade.",
        f"{sources[0].upper()}{sources[1:]}.",
    ]
    if "control" in attributes:
        lines.append(
            f"Means and samples combine these with {attributes['n_control']} flat cells as control "
            f"variates, the first of them on the same surfaces ({attributes['control']})."
        )
    lines += [
        f"Cross-validation: at pressures left out of the fit its errors are up to "
        f"{100.0 * attributes['cross_validated_error']:.2g} % in pressure and "
        f"{100.0 * attributes['cross_validated_stiffness_error']:.2g} % in stiffness.",
        f"Admissibility: {attributes['admissibility']}.",
    ]
    figures = {
        "gap_law": on_axes(law_figures.plot_gap_law, response, law),
        "area_law": on_axes(law_figures.plot_area_law, response, law),
    }
    return _Part(lines, figures)


def _describe_unloading(law: Dataset, response: Dataset) -> _Part:
    error = float(np.sqrt(np.mean(law["unloading_fit_error"].values ** 2)))
    line = (
        "At the start of unloading the interface is "
        f"{float(law['unloading_stiffness_ratio']):.3g} times as stiff as under loading, and "
        f"its gap recovers with the exponent {float(law['unloading_exponent']):.3g}; at "
        f"pressures left out of the fit the error of the recovery is {100.0 * error:.2g} %."
    )
    return _Part([line], {"unloading": on_axes(law_figures.plot_unloading, response, law)})


def _describe_conductance(law: Dataset) -> _Part:
    line = (
        f"The conductance follows from the stiffness at the start of "
        f"{law.attrs['conductance_branch']}, by the analogy of conduction and incremental "
        f"compliance of contact spots (J. R. Barber, doi:10.1098/rspa.2002.1038). It includes "
        f"neither conduction through the gap nor films on the contact spots."
    )
    return _Part([line], {"conductance": on_axes(law_figures.plot_conductance, law)})


def _describe_leakage(law: Dataset, fields: Path) -> _Part:
    line = (
        f"The hydraulic aperture is the distance of parallel walls with the same flow rate, by "
        f"Reynolds' equation on the open area of the gap; the interface is a patchwork of the "
        f"cells. {upscaling.say_sealing(law)} {law.attrs.get('leakage_intervals', '')} The "
        f"pressure of the liquid does not deform the bodies."
    )
    figures = {"leakage": on_axes(law_figures.plot_leakage, law)}
    figures |= {f"flow_along_{axis}": on_axes(_flow, fields, axis) for axis in "xy"}
    return _Part([line], figures)


def _flow(fields: Path, axis: str, ax: Axes) -> Axes:
    return plot_flow_channels(open_dataset(fields, FIELDS), direction=axis, ax=ax)


def _describe_shear(law: Dataset, of_points: float) -> _Part:
    x, y = _format_ratio(law, 0), _format_ratio(law, 1)
    p, friction = law["shear_pressure"].values, float(law["shear_friction"])
    apart = law["shear_traction"].values - law["shear_bed_traction"].values
    distance = np.max(np.linalg.norm(apart, axis=1) / (friction * p))
    count = int(law.attrs["n_sheared"])
    lines = [
        f"Results of {count} sheared realisation{'s' * (count > 1)}: before slip the tangential "
        f"stiffness of the interface is {x} (along x) and {y} (along y) times its normal stiffness "
        f"at the same pressure; full slip is at a shear of {friction:.3g} times the pressure. The "
        f"tangential law, a slider bed, differs from the cells by at most "
        f"{100.0 * distance:.2g} % of the shear at full slip.",
        f"The friction of points of contact, {of_points:.3g}, is an input of the cells: the "
        f"coefficient of the interface follows from it and does not predict friction.",
    ]
    if "shear_loss_ratio" in law:
        lines.append(f"{loss_terms(law)[BED].how.capitalize()}.")
    return _Part(lines, {"shear_law": on_axes(law_figures.plot_shear_law, law)})


def _format_ratio(law: Dataset, axis: int) -> str:
    """Tangential over normal stiffness along an axis, with its 95 % interval if known."""
    value, drawn = float(law["shear_stiffness_ratio"][axis]), np.empty(0)
    if law.sizes.get("shear_sample", 0):
        drawn = law["shear_stiffness_ratio_sample"].to_numpy()[:, axis]
    if not drawn.size or np.isnan(value):
        return f"{value:.3g}"
    half = float(half_range(drawn))
    return f"{value:.3g} ± {half:.1g}" if half > ROUNDING * abs(value) else f"{value:.3g}"


def _answer(law: Dataset) -> Iterator[str]:
    shown = _compared(law)
    step = shown.isel(step=shown.sizes["step"] // 2)
    touches = float(step["contact_fraction"]) < CLOSED
    yield from View(shown).sentences(step, OPEN if touches else FLAT)
    yield from list_missing(law)
    yield from behaviour(law)
    yield from negative_gap(law["fit_mean_gap"].to_numpy(), law)
    if "hydraulic_aperture" in law:
        yield upscaling.say_sealing(law)


def _compared(law: Dataset) -> Dataset:
    """Return gap, stiffness and contact at the pressures of the cells, with their known errors."""
    pressure, gap = law["fit_pressure"].to_numpy(), law["fit_mean_gap"].to_numpy()
    answers = {
        "mean_gap": (gap, "m"),
        "stiffness": (upscaling.law_from_dataset(law).stiffness(gap), "Pa m-1"),
        "contact_fraction": (upscaling.area_from_dataset(law).contact_fraction(pressure), "1"),
    }
    values: dict[str, Any] = {}
    for name, (value, unit) in answers.items():
        half = value * known_error(law.sel(quantity=[name]), MODEL)[0]
        values[name] = ("step", value, {"units": unit})
        values[f"{name}_mean_law"] = (("limit", "step"), [value - half, value + half])
    for name, value in upscaling.conductances(law, pressure).items():
        values[name] = ("step", value, {"units": upscaling.CONDUCTANCES[name]})
    return law.assign(values)


def _needs(case: Case) -> Needs:
    fit = Needs(seconds=FIT_TIME + SAMPLE_TIME * case.law.samples)
    parts = [fit, *calibration_needs(case)]
    return replace(join_needs(parts), seconds=sum(part.seconds for part in parts))


FITTED_LAW = Stage(
    schema=INTERFACE_LAW,
    tables=("micro",),
    reads={
        "law": True,
        "measured": True,
        "structure": {"kind", "width"},  # the budget compares the scales with its width
        "body_1": set(CONDUCTIVITIES),
        "body_2": set(CONDUCTIVITIES),
    },
    takes=(CELLS, SHEARED_CELLS, COARSER_CELLS, COARSER_SHEAR, CONTROL_CELLS, SLIDING),
    run=_run,
    needs=_needs,
    prepare=prepare_calibration,
    sections=_sections,
    question="How do gap, stiffness and contact of the interface depend on its pressure?",
    answer=_answer,
    answers=(
        "fit_pressure",
        *("stiffness", "mean_gap", "contact_fraction", "shear_friction"),
        *upscaling.CONDUCTANCES,
    ),
    compared=_compared,
)
