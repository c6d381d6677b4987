"""Stages: further cells of a case: sheared, coarser, flat control cells, and cells that slide."""

from collections.abc import Iterator
from dataclasses import replace
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from multiscale import schema
from multiscale.laws.bulk import J2, Elastic, NeoHookean
from multiscale.micro import FiniteCell, run_ensemble, shear_path, slide_cell
from multiscale.micro import Path as LoadPath
from multiscale.micro.averages import Keep
from multiscale.micro.ensemble import record_realisation, run_realisations
from multiscale.needs import Choice, Needs
from multiscale.pipeline.case_cells import make_cells, smooth_pair, two_bodies, two_surfaces
from multiscale.pipeline.plans.knobs import as_read
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.cells import CELLS
from multiscale.pipeline.tables.case_tables import MicroSettings
from multiscale.pipeline.tables.rough_bodies import CONDUCTIVITIES, RoughBody
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting.figure import on_axes
from multiscale.plotting.lines import plot_lines
from multiscale.schema import SLIDING_RESPONSE, Dataset
from multiscale.surfaces.surface import Surface
from multiscale.upscaling import loading_branch
from multiscale.upscaling.response_observations import normal_observations
from multiscale.upscaling.sampling import Control, best_ratio

SHEARED, COARSER, FLAT = "micro-shear", "micro-coarser", "micro-control"
"""Folders of a run; sheared and flat cells have a subfolder for each set of their keys."""

POINT_FRICTION = "friction_coefficient"  # attribute of the response: friction of points of contact
NEAR = (0.4, 0.55, 0.7, 0.85, 1.0)
"""Pressures of sheared cells without shear, over the pressures of the shear."""

AMPLITUDE = 1.0  # of the closed cycle, relative to the slip at which a joint begins to slide
BATCH = 16  # cells of a job and its file; a job with windows of a map has a single cell

TOLERANCE = 3e-3
"""Tolerance of the flat cells: an error that both cells of a pair share cancels. At 128 x 128
points correlations are as with 1e-6 (gaps .99996, stiffnesses .9993 to .9999), in half of the
time."""

COST = 50.0
"""Time of a conforming cell over the time of a flat cell; 57 was measured at 128 x 128 points, and
other cells take longer. A constant, because times measured in each run would change the number of
cells, and with it the answers."""

MOST = 256
"""Largest number of flat cells by the rule of the best ratio: the error of their mean is an eighth
of the scatter of single cells. A case file may have more."""

CHANCE = (
    "the correlation of the mean gaps of the control cells with the mean gaps of the {} cells is "
    "not significant, so that law and intervals use only the latter; control = false in [micro] "
    "saves "
    "the time"
)
BODIES = dict.fromkeys(("body_1", "body_2", "cell"), True)
SHEAR_KEYS = {**BODIES, "micro": {"pressures", "seed", "shear"}}
FLAT_KEYS = {"pressures", "unload", "seed"}  # keys of the case on which these cells depend


def run_shear(case: Case, job: Job) -> schema.Dataset:
    """Press the cells over the pressures of the law, on the same grid, and shear them."""
    sheared = _as_sheared(case)
    cells = [_pair(sheared, pair) for pair in two_surfaces(sheared)]
    shear = sheared.micro.shear
    path = shear_path(
        cells[0],
        shear.pressures,
        steps=shear.steps,
        cycle=AMPLITUDE if shear.cycle else 0.0,
        pressed=_pressed(sheared.micro),
    )
    keys = case.checksum(include=SHEAR_KEYS, exclude={"micro": {"shear": {"realisations"}}})
    identity = sha256(f"{keys} {path.pressure}".encode()).hexdigest()
    options = job.ensemble(f"{SHEARED}/{identity[:12]}", identity, len(cells), "sheared cells")
    response = run_ensemble(cells, path, **options)
    ended = str(response.attrs.get("ended", "")).splitlines()
    friction: dict[str, Any] = {POINT_FRICTION: shear.friction_coefficient}
    return response.assign_attrs(
        title=case.title,
        bodies="body_1 and body_2, both deformable, with friction",
        cautions="\n".join(f"sheared {line}" for line in ended),
        **friction,
    )


def _as_sheared(case: Case) -> Case:
    """Return the case with the number and the grid of the cells that are sheared."""
    shear = case.micro.shear
    grid = {"points": shear.points or case.cell.points, "layers": shear.layers or case.cell.layers}
    micro = case.micro.model_copy(update={"realisations": shear.realisations})
    return case.model_copy(update={"cell": case.cell.model_copy(update=grid), "micro": micro})


def _pressed(micro: MicroSettings) -> list[float]:
    """Return the pressures of sheared cells before the shear."""
    # a loss is the area between the normal curve and its chord: it scatters less with near
    # pressures
    near = {as_read(share * p) for p in micro.shear.pressures for share in NEAR}
    low, *_, high = micro.pressures
    return sorted({*micro.pressures, *(p for p in near if low < p < high)})


def _pair(case: Case, surfaces: tuple[Surface, Surface]) -> FiniteCell:
    lower, upper = (Elastic(body.youngs_modulus, body.poissons_ratio) for body in case.bodies)
    mu, coatings = case.micro.shear.friction_coefficient, (case.body_1.stack, case.body_2.stack)
    return two_bodies(case.cell, surfaces, (lower, upper), mu, coatings)


def _shear_needs(case: Case) -> Needs:
    sheared = _as_sheared(case)
    shear, (nx, ny) = sheared.micro.shear, sheared.cell.points
    pair = _pair(sheared, smooth_pair(sheared.cell)).needs()
    unknowns = 6 * nx * ny * sheared.cell.layers
    each = shear.steps + 2 + (4 if shear.cycle else 0)
    steps = len(_pressed(sheared.micro)) + 1 + 2 * len(shear.pressures) * each
    time = pair.seconds * steps * shear.realisations
    cells = Choice(
        "sheared cells",
        f"{shear.realisations} of two bodies with friction, {nx} x {ny} points and {unknowns} "
        f"unknowns, each in {steps} steps",
    )
    return Needs(unknowns_per_contact=3, choices=(cells,), memory=pair.memory, seconds=time)


def _press_coarser(case: Case, datasets: Datasets, job: Job) -> schema.Dataset:
    cells = make_cells(case.coarser())
    options = job.ensemble(COARSER, case.identity(), len(cells), "coarser cells")
    path = LoadPath(pressure=case.micro.pressures)
    response = run_ensemble(cells, path, keep_flow=case.micro.leakage, **options)
    return response.assign_attrs(title=case.title)


def _coarser_needs(case: Case) -> Needs:
    nx, ny = case.coarser().cell.points
    number = f"{case.micro.coarser} of {nx} x {ny} points, for the error of the grid"
    coarse = CELLS.needs(case.coarser())
    cells = Choice("coarser cells", number)
    return Needs(choices=(cells,), memory=coarse.memory, seconds=coarse.seconds)


def _coarser_shear_needs(case: Case) -> Needs:
    coarse = SHEARED_CELLS.needs(case.coarser())
    (cells,) = coarse.choices
    return replace(coarse, choices=(Choice("coarser sheared cells", cells.why),))


def _press_flat(case: Case, datasets: Datasets, job: Job) -> schema.Dataset:
    """Press the number of flat cells of the case, or the best number; see :func:`best_count`."""
    response, count = datasets[CELLS.name], case.micro.control_realisations
    pairs, number = response.sizes["realisation"], f"{count} as stated in the case"
    first = press_control(case, pairs, job)
    control = normal_observations(loading_branch(response), first).control
    if count is None:
        count, number = best_count(pairs, control)
    every = press_control(case, max(count, pairs), job)
    caution = "" if control else CHANCE.format(pairs)
    return schema.with_cautions(every.assign_attrs(title=case.title, number=number), caution)


def press_control(case: Case, count: int, job: Job) -> schema.Dataset:
    """Press flat cells, on the surfaces of the first realisations; finished cells are reused."""
    step = 1 if case.from_maps else BATCH
    jobs = -(-count // step)
    others = {body: set(CONDUCTIVITIES) for body in ("body_1", "body_2")}
    identity = case.checksum(include={**BODIES, "micro": FLAT_KEYS}, exclude=others)
    arguments = [(case, *ends) for ends in pairwise(step * k for k in range(jobs + 1))]
    options = job.ensemble(f"{FLAT}/{identity[:12]}", identity, jobs, "control cells", each=step)
    control = run_realisations(_press_batch, arguments, name="cells", **options)
    return control.isel(realisation=range(count))


def _press_batch(case: Case, start: int, stop: int) -> schema.PlainDataset:
    """Press the flat cells of some realisations under all pressures of the path, rising."""
    if case.from_maps:
        cells = make_cells(case.control(stop))[start:]
    else:
        micro = case.micro.model_copy(update={"seed": case.micro.seed + start})
        cells = make_cells(case.model_copy(update={"micro": micro}).control(stop - start))
    path = LoadPath(pressure=tuple(sorted({*case.micro.path})))
    records = [record_realisation(cell, path, Keep(), tolerance=TOLERANCE) for cell in cells]
    ended = [str(cell.attributes["ended"]) for cell in records if "ended" in cell.attributes]
    values = schema.MICRO_RESPONSE.join(records, "realisation").values
    return schema.PlainDataset(values, {"ended": "; ".join(ended)} if ended else {})


def best_count(pairs: int, control: Control | None) -> tuple[int, str]:
    """Return the number of flat cells with the least variance for the time, and its reason."""
    if control is None:
        return pairs, "as many as the cells, since the correlation is not significant"
    correlation = float(np.median(control.correlation))
    best = pairs * best_ratio(correlation, COST)
    count = 2 ** round(np.log2(min(best, pairs * COST, MOST)))
    return count, (
        f"{count}: the optimum is {best:.3g} at a correlation of {correlation:.5g} and a cost of "
        f"1/{COST:g} of a cell, bounded by the time of the cells and {MOST}, and rounded to a "
        f"power of two"
    )


def _flat_needs(case: Case) -> Needs:
    stated = case.micro.control_realisations
    number = f"{stated} flat cells" if stated else "flat cells, by times and correlation,"
    purpose = (
        f"{number} on the surfaces of the {case.micro.realisations} cells and on further surfaces, "
        f"as control variates: the law has their sampling error, and the error of the differences"
    )
    most = stated or min(MOST, int(COST) * case.micro.realisations)
    flat = CELLS.needs(case.control(most))
    cells = Choice("control cells", purpose)
    return Needs(choices=(cells,), memory=flat.memory, seconds=flat.seconds)


def _count(datasets: Datasets) -> list[tuple[str, str]]:
    control = datasets[CONTROL_CELLS.name]
    return [
        ("control cells", str(control.attrs["number"])),
        ("solver time of the control cells", f"{float(control['wall_time'].sum()):.1f} s"),
    ]


SHEARED_CELLS = Stage(
    schema=schema.SHEAR_RESPONSE,
    tables=("micro.shear",),
    reads=SHEAR_KEYS,
    run=lambda case, datasets, job: run_shear(case, job),
    needs=_shear_needs,
    folders=(SHEARED,),
)
COARSER_CELLS = Stage(
    schema=schema.COARSER_RESPONSE,
    tables=("micro.coarser",),
    reads={**BODIES, "micro": {"pressures", "seed", "coarser", "leakage"}},
    run=_press_coarser,
    needs=_coarser_needs,
    folders=(COARSER,),
)
COARSER_SHEAR = Stage(
    schema=schema.COARSER_SHEAR_RESPONSE,
    tables=("micro.coarser", "micro.shear"),
    reads={**BODIES, "micro": {"pressures", "seed", "coarser", "shear"}},
    run=lambda case, datasets, job: run_shear(case.coarser(), job),
    needs=_coarser_shear_needs,
)
CONTROL_CELLS = Stage(
    schema=schema.CONTROL_RESPONSE,
    tables=("micro.control",),
    reads={**BODIES, "micro": {*FLAT_KEYS, "realisations", "control", "control_realisations"}},
    takes=(CELLS,),
    run=_press_flat,
    needs=_flat_needs,
    work=_count,
    folders=(FLAT,),
)


SLIDE_TOLERANCE = (
    1e-6  # tolerance of the contact solver, relative to the norm of the contact forces
)


def make_pair(case: Case, surfaces: tuple[Surface, Surface] | None = None) -> FiniteCell:
    """Build the cell of two bodies, elastoplastic (J2) with a hardness, neo-Hookean without."""
    if surfaces is None:
        micro = case.micro.model_copy(update={"realisations": 1})
        (surfaces,) = two_surfaces(case.model_copy(update={"micro": micro}))
    lower, upper = map(_flowing_law, case.bodies)
    return two_bodies(case.cell, surfaces, (lower, upper), case.slide.friction_coefficient)


def _slide(case: Case, datasets: Datasets, job: Job) -> Dataset:
    slide = case.slide
    response = slide_cell(
        make_pair(case),
        slide.pressures or case.micro.pressures,
        slide.distance,
        steps=slide.steps,
        executor=job.executor,
        tolerance=SLIDE_TOLERANCE,
    )
    ended = str(response.attrs.get("ended", ""))
    caution = f"sliding stopped at {ended}" if ended else ""
    return response.assign_attrs(title=case.title, cautions=caution)


def _flowing_law(body: RoughBody) -> NeoHookean | J2:
    if body.yield_stress is None:
        return NeoHookean(body.youngs_modulus, body.poissons_ratio)
    return J2(
        body.youngs_modulus, body.poissons_ratio, body.yield_stress, body.hardening_modulus or 0.0
    )


def _slide_needs(case: Case) -> Needs:
    pair = make_pair(case, smooth_pair(case.cell)).needs()
    slide = Choice(
        "slide", "both bodies, deformable and at large strain, one pressure after the other"
    )
    steps = (case.slide.steps + 1) * len(case.slide.pressures or case.micro.pressures)
    return Needs(choices=(slide,), memory=pair.memory, seconds=pair.seconds * steps)


def _slide_sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    response = datasets[SLIDING.name]
    figures = {
        "sliding": on_axes(plot_lines, response, "effective_friction", by="nominal_pressure"),
        "steady_friction": on_axes(plot_lines, response, "steady_friction"),
    }
    yield Section("Sliding", remarks=describe_sliding(response), figures=figures)


def describe_sliding(response: Dataset) -> list[str]:
    """Report the largest and the steady friction at each pressure."""
    distance = float(response["sliding_distance"][-1])
    lines = []
    for load in range(response.sizes["load"]):
        loaded = response.isel(load=load)
        friction = loaded["effective_friction"].values[1:]
        pressure = 1e-6 * float(loaded["nominal_pressure"])
        if not np.isfinite(friction).any():
            lines.append(f"Under {pressure:.4g} MPa the bodies did not slide.")
            continue
        steady = float(loaded["steady_friction"])
        last = friction[np.isfinite(friction)][-1]
        end = (
            f"{steady:.3g} over the last length of the cell"
            if np.isfinite(steady)
            else f"{last:.3g} at the end"
        )
        lines.append(
            f"Under {pressure:.4g} MPa the friction of the cell over {1e6 * distance:.4g} µm is at "
            f"most {np.nanmax(friction):.3g}, and {end}."
        )
    return lines


SLIDING = Stage(
    schema=SLIDING_RESPONSE,
    tables=("slide",),
    reads={
        **dict.fromkeys(("body_1", "body_2", "cell", "slide"), True),
        "micro": {"pressures", "seed"},
    },
    run=_slide,
    needs=_slide_needs,
    sections=_slide_sections,
    answers=("nominal_pressure", "steady_friction"),
)
