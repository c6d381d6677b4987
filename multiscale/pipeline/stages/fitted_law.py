"""Stage: the interface law fitted to the cells of two rough bodies."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from multiscale.io import open_dataset
from multiscale.needs import Needs
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
)
from multiscale.pipeline.stages.sliding import SLIDING
from multiscale.pipeline.tables.settings import CONDUCTIVITIES, Case
from multiscale.plotting.figure import Axes, on_axes
from multiscale.plotting.law_figures import (
    plot_area_law,
    plot_conductance,
    plot_gap_law,
    plot_leakage,
    plot_shear_law,
    plot_unloading,
)
from multiscale.plotting.surface_figures import plot_flow_channels
from multiscale.schema import FIELDS, INTERFACE_LAW, MICRO_RESPONSE, Dataset
from multiscale.upscaling import (
    CONDUCTANCES,
    area_from_dataset,
    conductances,
    fit_branches,
    law_from_dataset,
    loading_branch,
    require_law,
    say_sealing,
    with_budget,
    with_conductance,
    with_leakage,
    write_law_table,
    write_pressure_overclosure,
)
from multiscale.upscaling.budget import known_error
from multiscale.upscaling.fit import branch_origins
from multiscale.upscaling.sampling import half_range
from multiscale.upscaling.shear_budget import loss_term, with_loss_grid

__all__ = ["FITTED_LAW"]

CLOSED = 1.0 - 1e-6  # share of the area that touches, from which there is no gap left
FIT_TIME, SAMPLE_TIME = 1.0, 0.03  # s, of a fit and of a sample of it, about
OPEN = (
    "At {fit_pressure} the mean gap of the interface is {mean_gap:±}, its stiffness {stiffness:±} "
    "and the share of its area that touches {contact_fraction:±}."
)
FLAT = (
    "At {fit_pressure} all of the interface touches: its roughness is flat, and as stiff as the "
    "bodies beside it."
)
"""Answers at a pressure, while there is a gap and when none is left."""

EXPORTED = 0.01
"""Error of the pressure between the points of the tables that the page offers."""


def _run(case: Case, found: Datasets, job: Job) -> Dataset:
    response, sliding = found[MICRO_RESPONSE.name], found.get(SLIDING.name)
    steady = sliding is not None and bool(np.isfinite(sliding["steady_friction"]).any())
    control = found.get(CONTROL_CELLS.name)
    law = fit_branches(
        response,
        control=control,
        shear=found.get(SHEARED_CELLS.name),
        sliding=sliding if steady else None,
        apart=case.law.apart,
        n_terms=case.law.terms,
        n_samples=case.law.samples,
    )
    pressed, sheared = _on_grids(case, found)
    law = with_loss_grid(law, sheared)
    law = with_conductance(
        law, case.conductivities, response.attrs["contact_modulus"], flows=case.hardness is not None
    )
    if case.micro.leakage:
        law = with_leakage(law, response, found.get(COARSER_CELLS.name))
    budget = case_budget(case, loading_branch(response), law, pressed, sheared, control)
    return with_budget(law, budget)


def _on_grids(case: Case, found: Datasets) -> tuple[dict[float, Dataset], dict[float, Dataset]]:
    """Responses of the first cells on their grid and on half of their points, and sheared laws.

    Both are by the ratio of the spacings, and empty if no cells have the coarser grid.
    """
    if not case.micro.coarser:
        return {}, {}
    pressed = {1.0: loading_branch(found[MICRO_RESPONSE.name]), 2.0: found[COARSER_CELLS.name]}
    pressed = {
        ratio: one.isel(realisation=range(case.micro.coarser)) for ratio, one in pressed.items()
    }
    if case.micro.shear is None:
        return pressed, {}
    sheared = {1.0: found[SHEARED_CELLS.name], 2.0: found[COARSER_SHEAR.name]}
    n = sheared[2.0].sizes["realisation"]
    laws = {
        ratio: fit_branches(
            pressed[ratio], shear=one.isel(realisation=range(n)), apart=False, n_samples=0
        )
        for ratio, one in sheared.items()
    }
    return pressed, laws


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    response, law = found[MICRO_RESPONSE.name], found[FITTED_LAW.name]
    require_law(
        law,
        "n_realisations",
        "pressure_min",
        "pressure_max",
        "pressures_per_decade",
        "branches",
        "cross_validated_error",
        "cross_validated_stiffness_error",
        "admissibility",
    )
    told, branches = law.attrs, branch_origins(law).items()
    count = int(told["n_realisations"])
    said = ", ".join(f"{branch} is {how}" for branch, how in branches)
    lines = [
        f"The law stands for the {response.attrs['bodies']}; it rests on "
        f"{count} realisation{'s' * (count > 1)} between {1e-6 * told['pressure_min']:.4g} and "
        f"{1e-6 * told['pressure_max']:.4g} MPa, {told['pressures_per_decade']:.2g} pressures a "
        f"decade.",
        f"{said[0].upper()}{said[1:]}.",
    ]
    if "control" in told:
        lines.append(
            f"Means and samples are of these and of {told['n_control']} flat cells, the first on "
            f"the same surfaces, as control variates ({told['control']})."
        )
    lines += [
        f"At pressures that were left out of the fit it erred by up to "
        f"{100.0 * told['cross_validated_error']:.2g} % in pressure and "
        f"{100.0 * told['cross_validated_stiffness_error']:.2g} % in stiffness.",
        f"What every law must satisfy: {told['admissibility']}.",
    ]
    figures = {
        "gap_law": on_axes(plot_gap_law, response, law),
        "area_law": on_axes(plot_area_law, response, law),
    }
    if "unloading_stiffness_ratio" in law:
        figures["unloading"] = on_axes(plot_unloading, response, law)
        error = float(np.sqrt(np.mean(law["unloading_fit_error"].values ** 2)))
        lines.append(
            f"Unloaded, it is {float(law['unloading_stiffness_ratio']):.3g} times as stiff at "
            f"first as it was under load, and springs back with the exponent "
            f"{float(law['unloading_exponent']):.3g}; at a pressure that the fit has not seen, the "
            f"spring back errs by {100.0 * error:.2g} % of its length."
        )
    if conducts := conductances(law, law["fit_pressure"].to_numpy()):
        figures["conductance"] = on_axes(plot_conductance, law)
        lines.append(
            f"The conductance follows from the stiffness at the start of "
            f"{told['conductance_branch']}, since spots of contact hinder a current as they hinder "
            f"a small further displacement (J. R. Barber, doi:10.1098/rspa.2002.1038). What the "
            f"gap itself conducts comes on top, and films on the spots are not counted."
        )
    if "hydraulic_aperture" in law:
        figures["leakage"] = on_axes(plot_leakage, law)
        fields = out / "fields" / "fields.nc"
        figures |= {f"flow_along_{axis}": on_axes(_flow, fields, axis) for axis in "xy"}
        lines.append(
            f"The hydraulic aperture is the distance of parallel walls that let as much of a "
            f"liquid through, by Reynolds' equation on the open part of the gap, and the interface "
            f"is a patchwork of the cells. {say_sealing(law)} {told.get('leakage_intervals', '')} "
            f"The pressure of the liquid itself lifts nothing."
        )
    if sheared := SHEARED_CELLS.name in found:
        figures["shear_law"] = on_axes(plot_shear_law, law)
        lines += _shear(law, found[SHEARED_CELLS.name].attrs[POINT_FRICTION])
    files: dict[str, Callable[[Path], object]] = {"law.csv": partial(write_law_table, law)}
    for code in ("abaqus", "calculix"):
        files[f"{code}.inp"] = partial(
            write_pressure_overclosure,
            law,
            tolerance=EXPORTED,
            friction_for=code if sheared else None,
            conductance_for=code if "thermal_conductance" in conducts else None,
        )
    yield Section("Interface law", lines, figures=figures, files=files)


def _flow(fields: Path, axis: str, ax: Axes) -> Axes:
    return plot_flow_channels(open_dataset(fields, FIELDS), direction=axis, ax=ax)


def _shear(law: Dataset, of_points: float) -> list[str]:
    """Say what the sheared cells gave, and which friction was put into them."""
    x, y = _say_ratio(law, 0), _say_ratio(law, 1)
    p, friction = law["shear_pressure"].values, float(law["shear_friction"])
    apart = law["shear_traction"].values - law["shear_bed_traction"].values
    distance = np.max(np.linalg.norm(apart, axis=1) / (friction * p))
    lines = [
        f"Results of {law.attrs['n_sheared']} sheared realisations: before it slips, the interface "
        f"is {x} times as stiff along x and {y} times along y as across, at the same "
        f"pressure; all of it slips at a shear of {friction:.3g} of the pressure. Along the shear "
        f"the tangential law, a bed of sliders, is never farther from the cells than "
        f"{100.0 * distance:.2g} % of full slip.",
        f"The friction of points of contact, {of_points:.3g}, is an input of the cells: the "
        f"coefficient of the interface follows from it and is no prediction of friction.",
    ]
    if "shear_loss_ratio" in law:
        lines.append(f"{loss_term(law).how.capitalize()}.")
    return lines


def _say_ratio(law: Dataset, axis: int) -> str:
    """Tangential over normal stiffness along an axis, with its 95 % interval if there is one."""
    value, drawn = float(law["shear_stiffness_ratio"][axis]), np.empty(0)
    if law.sizes.get("shear_sample", 0):
        drawn = law["shear_stiffness_ratio_sample"].to_numpy()[:, axis]
    if not drawn.size or np.isnan(value):
        return f"{value:.3g}"
    half = float(half_range(drawn))
    return f"{value:.3g} ± {half:.1g}" if half > ROUNDING * abs(value) else f"{value:.3g}"


def _answer(law: Dataset) -> Iterator[str]:
    """Report gap, stiffness and contact of the interface at the middle one of the pressures."""
    shown = _compared(law)
    step = shown.isel(step=shown.sizes["step"] // 2)
    touches = float(step["contact_fraction"]) < CLOSED
    yield from View(shown).sentences(step, OPEN if touches else FLAT)
    yield from list_missing(law)
    yield from str(law.attrs.get("plan", "")).splitlines()
    yield from behaviour(law)
    yield from negative_gap(law["fit_mean_gap"].to_numpy(), law)
    if "hydraulic_aperture" in law:
        yield say_sealing(law)


def _compared(law: Dataset) -> Dataset:
    """Return gap, stiffness and contact at the pressures of the cells, with their known errors."""
    pressure, gap = law["fit_pressure"].to_numpy(), law["fit_mean_gap"].to_numpy()
    found = {
        "mean_gap": (gap, "m"),
        "stiffness": (law_from_dataset(law).stiffness(gap), "Pa m-1"),
        "contact_fraction": (area_from_dataset(law).contact_fraction(pressure), "1"),
    }
    values: dict[str, Any] = {}
    for name, (value, unit) in found.items():
        half = value * known_error(law.sel(quantity=[name]))[0]
        values[name] = ("step", value, {"units": unit})
        values[f"{name}_mean_law"] = (("limit", "step"), [value - half, value + half])
    for name, value in conductances(law, pressure).items():
        values[name] = ("step", value, {"units": CONDUCTANCES[name]})
    return law.assign(values)


FITTED_LAW = Stage(
    schema=INTERFACE_LAW,
    tables=("micro",),
    reads={
        "law": True,
        "structure": {"kind", "width"},  # whose scales the budget compares
        "body_1": set(CONDUCTIVITIES),
        "body_2": set(CONDUCTIVITIES),
    },
    takes=(CELLS, SHEARED_CELLS, COARSER_CELLS, COARSER_SHEAR, CONTROL_CELLS, SLIDING),
    run=_run,
    needs=lambda case: Needs(seconds=FIT_TIME + SAMPLE_TIME * case.law.samples),
    sections=_sections,
    question="How do gap, stiffness and contact of the interface depend on its pressure?",
    answer=_answer,
    answers=dict.fromkeys(
        (
            "fit_pressure",
            *("stiffness", "mean_gap", "contact_fraction", "shear_friction"),
            *CONDUCTANCES,
        ),
        "",
    ),
    compared=_compared,
)
