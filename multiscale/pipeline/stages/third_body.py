"""Stages: grains between two plates are pressed and sheared, and give the law of an interface."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from multiscale.macro import granulate
from multiscale.micro.ensemble import run_realisations
from multiscale.needs import Choice, Needs
from multiscale.pipeline.plans.case_knobs import grain_knobs, wider_grains
from multiscale.pipeline.showing import Table
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.tables.case_tables import doubt_scatter
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting.figure import on_axes
from multiscale.plotting.lines import plot_lines
from multiscale.schema import (
    CONTROL_RESPONSE,
    INTERFACE_LAW,
    MICRO_RESPONSE,
    Dataset,
    PlainDataset,
    with_cautions,
)
from multiscale.upscaling import error_budget, fit_law, with_budget, with_steady_friction
from multiscale.upscaling.budget import Term, known_terms
from multiscale.upscaling.fit import laws_of_each, stiffness_of_each
from multiscale.upscaling.law_budget import sampling_term
from multiscale.upscaling.response_observations import (
    area_observations,
    friction_observations,
    normal_observations,
)
from multiscale.upscaling.sampling import student

PRESSING, SWEPT = 400, 4e-5  # steps before the shear, and s of a step and grain, about
NOTHING = ("micro discretisation", "increments", "small slopes", "surface")
"""Terms of the error of cells on grids that cells of grains do not have."""

ONE_SIZE = "not known: cells of one size were sheared; give wider in [third_body]"
TWO_SIZES = "twice the distance, with its interval, from {} cells of twice the periods"
LAYERS, WIDER = "micro", "wider"  # folders of cells

TABLE = Table(
    (
        "sliding_pressure",
        "inertial_number",
        "sliding_friction",
        "sliding_friction:mean_law",
        "layer_height",
    ),
    along=("load",),
)


def _shear(case: Case, k: int) -> PlainDataset:
    third, grains = case.third_body, case.grains
    radii, options = third.cell(grains, k)
    p = np.array(third.pressures)
    speed = np.full(p.size, third.speed)
    return granulate.shear_cells(radii, third.size, p, speed, grains.law, **options)


def _shear_all(case: Case, count: int, job: Job, folder: str) -> Dataset:
    response = run_realisations(
        _shear,
        [(case, k) for k in range(count)],
        **job.ensemble(folder, case.identity(), count, "cells of grains"),
    )
    ended = str(response.attrs.get("ended", "")).splitlines()
    density, diameter = case.grains.density, 2.0 * float(np.mean(case.grains.radius))
    response = response.assign_attrs(
        title=case.title,
        bodies="rigid grains between two plates, in steady shear",
        grain_density=density,
        grain_diameter=diameter,
    )
    return with_cautions(
        response,
        *(f"{line} (no shear is known there)" for line in ended),
        *doubt_scatter(count),
    )


def _needs(case: Case, count: int) -> Needs:
    steps = case.third_body.steps(case.grains)
    each = (sum(steps) + PRESSING) * SWEPT * case.grains.number
    cells = Choice(
        "cells of grains",
        f"{count} of {case.grains.number} grains, each sheared at {len(steps)} pressures in up to "
        f"{max(steps)} steps",
    )
    return Needs(
        unknowns_per_contact=3,
        kinematics="rigid grains in motion, impulses in place of forces",
        choices=(cells,),
        seconds=count * each,
    )


def _fit(case: Case, datasets: Datasets, job: Job) -> Dataset:
    response = datasets[MICRO_RESPONSE.name]
    law = fit_law(response, family="dilatant", n_samples=case.law.samples)
    nothing = Term("nothing: the grains are rigid spheres", np.zeros((3, law.sizes["step"])))
    known = {**dict.fromkeys(NOTHING, nothing), "cell size": Term(ONE_SIZE)}
    known["fit"] = _lack_of_fit(response, law)
    wider, friction = datasets.get(WIDER_CELLS.name), 0.0
    if wider is not None:
        *of_law, friction = size_errors(response, wider, law)
        half = np.repeat(np.array(of_law)[:, None], law.sizes["step"], axis=1)
        known["cell size"] = Term(TWO_SIZES.format(wider.sizes["realisation"]), half)
    budget = error_budget(response, law, known=known, discrepancy=case.law.discrepancy)
    law = with_steady_friction(with_budget(law, budget), response).assign_attrs(title=case.title)
    error = law["sliding_friction_error"]
    return law.assign(sliding_friction_error=error.copy(data=np.hypot(error, friction)))


def size_errors(response: Dataset, wider: Dataset, law: Dataset) -> list[float]:
    """Return the errors of gap, area, stiffness and friction by the size of cells, relative."""
    of_both, rows = (response, wider), []
    first, second = (friction_observations(cells).pressure for cells in of_both)
    common = np.intersect1d(first, second)
    for cells in of_both:
        steady = cells.isel(step=np.isin(cells["nominal_pressure"].to_numpy(), common))
        gap, area = normal_observations(steady), area_observations(steady)
        friction = friction_observations(steady)
        rows.append([gap.values, area.values, stiffness_of_each(gap, law), friction.values])
    errors = []
    for these, others in zip(*rows, strict=True):
        ratios = [values / np.nanmean(these, axis=0) for values in (these, others)]
        each, variance, _ = _differences(*ratios)
        mean, of_mean, free = _differences(*(np.nanmean(r, axis=1)[:, None] for r in ratios))
        square = np.fmax(np.nanmean(each**2 - np.nan_to_num(variance)), mean[0] ** 2)
        # errors at least linear in the periods are at most twice the difference d from cells of
        # twice the periods, with their scatter s and the half-width w of the mean
        #     2 sqrt(max(mean(d² - s²), mean(d)²) + w²)  (2)
        errors.append(2.0 * float(np.sqrt(square + student(free[0]) ** 2 * of_mean[0])))  # (2)
    return errors


def _differences(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the differences of means over the rows, their variances and degrees of freedom."""
    both = (first, second)
    counts = np.array([np.isfinite(values).sum(axis=0) for values in both])
    means = [np.nanmean(values, axis=0) for values in both]
    away = [values - mean for values, mean in zip(both, means, strict=True)]
    free = counts.sum(axis=0) - 2
    squares = np.nansum(np.concatenate(away) ** 2, axis=0)
    pooled = np.where(free > 0, squares / np.maximum(free, 1), np.nan)
    return means[1] - means[0], pooled * np.sum(1.0 / counts, axis=0), free


def _lack_of_fit(response: Dataset, law: Dataset) -> Term:
    """Estimate the error of the formula of the law from misfits beyond the scatter of layers."""
    seen = normal_observations(response)
    laws, counted = laws_of_each(seen, law), seen.counted
    fitted = np.array(
        [
            np.full(seen.mean.size, np.nan) if each is None else each.gap_at(seen.pressure)
            for each in laws
        ]
    )
    error = np.where(counted, seen.values - fitted, np.nan)
    n, mean = len(error), np.nanmean(error, axis=0)
    scatter = np.nansum((error - mean) ** 2)
    # F = n (n - 1) sum_j mean(e_j)² / sum_kj (e_kj - mean(e_j))² (1) is 1 in the mean for a right
    # formula; otherwise the sampling error grows by sqrt F
    excess = n * (n - 1) * np.nansum(mean**2) / scatter - 1.0 if scatter > 0.0 else np.nan
    half = np.sqrt(max(excess, 0.0)) * sampling_term(response, law, None).half_width
    half[1] = 0.0  # the contact fraction passes through its data
    return Term("misfit of the law of dilation beyond the scatter of the layers", half)


def _shown(law: Dataset) -> Dataset:
    """Return the law with height and inertial number of the layer at the pressures of its cells."""
    diameter, density = (float(law.attrs[f"grain_{name}"]) for name in ("diameter", "density"))
    speed, p = float(law.attrs["sliding_speed"]), law["sliding_pressure"].to_numpy()
    height = np.interp(p, law["fit_pressure"].to_numpy(), law["fit_mean_gap"].to_numpy())
    mu, half = (law[f"sliding_friction{end}"].to_numpy() for end in ("", "_error"))
    band = mu * (1.0 + half * np.array([[-1.0], [1.0]]))
    inertial = speed / height * diameter * np.sqrt(density / p)
    return law.assign(
        inertial_number=("load", inertial),
        layer_height=("load", height),
        sliding_friction_mean_law=(("limit", "load"), band),
    )


def _answer(law: Dataset) -> Iterator[str]:
    shown = _shown(law)
    mu, number = (shown[name].to_numpy() for name in ("sliding_friction", "inertial_number"))
    height = 1e3 * shown["layer_height"].to_numpy()
    layers = 1e-3 * height / float(law.attrs["grain_diameter"])
    unknown = (
        ""
        if "cell size" in known_terms(law)
        else ", and its intervals do not contain the size of its cells"
    )
    yield (
        f"At {law.attrs['sliding_speed']:.3g} m/s the layer has a friction of {mu[-1]:.3g} to "
        f"{mu[0]:.3g} of the pressure, at inertial numbers of {number[-1]:.2g} to "
        f"{number[0]:.2g}, and is {height[-1]:.4g} to {height[0]:.4g} mm high, "
        f"{layers[-1]:.2g} to {layers[0]:.2g} mean diameters."
    )
    yield (
        f"At another speed v the law is valid at pressures proportional to v squared, for this "
        f"number of grains on the area{unknown}."
    )


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    law = datasets[THIRD_BODY_LAW.name]
    friction = on_axes(plot_lines, _shown(law), "sliding_friction", xscale="log")
    yield Section("Third body", (), *TABLE.rows(_shown(law)), figures={"friction": friction})


THIRD_BODY_CELLS = Stage(
    schema=MICRO_RESPONSE,
    tables=("third_body",),
    reads={"title", "grains", "third_body"},
    run=lambda case, datasets, job: _shear_all(case, case.third_body.realisations, job, LAYERS),
    needs=lambda case: _needs(case, case.third_body.realisations),
    knobs=grain_knobs,
    prepare=lambda case: case.third_body.steps(case.grains),
    again=lambda case: MICRO_RESPONSE.build(
        MICRO_RESPONSE.join([_shear(case, 0)], "realisation").values
    ),
    folders=(LAYERS,),
)

WIDER_CELLS = Stage(
    schema=CONTROL_RESPONSE,
    tables=("third_body.wider",),
    reads={"title", "grains", "third_body"},
    run=lambda case, datasets, job: _shear_all(
        wider_grains(case), case.third_body.wider, job, WIDER
    ),
    needs=lambda case: _needs(wider_grains(case), case.third_body.wider),
    folders=(WIDER,),
)

THIRD_BODY_LAW = Stage(
    schema=INTERFACE_LAW,
    tables=("third_body",),
    reads={"law"},
    takes=(THIRD_BODY_CELLS, WIDER_CELLS),
    run=_fit,
    needs=lambda case: Needs(seconds=2.0),
    question="How do friction and height of the layer of grains depend on pressure and speed?",
    answer=_answer,
    sections=_sections,
    answers=("sliding_friction", "layer_height"),
    compared=lambda law: _shown(law),
)
