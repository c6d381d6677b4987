"""Stages: cells beside the cells, which are sheared, coarser, or flat on the same surfaces."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from multiscale.laws.bulk import Elastic
from multiscale.micro import FiniteCell, Path, run_ensemble, shear_path
from multiscale.micro.averages import Keep
from multiscale.micro.ensemble import record_realisation, run_realisations
from multiscale.needs import Choice, Needs
from multiscale.pipeline.case_cells import make_cells, smooth_pair, two_bodies, two_surfaces
from multiscale.pipeline.stage import Datasets, Job, Stage
from multiscale.pipeline.stages.cells import CELLS
from multiscale.pipeline.tables.settings import CONDUCTIVITIES, Case
from multiscale.schema import (
    COARSER_RESPONSE,
    COARSER_SHEAR_RESPONSE,
    CONTROL_RESPONSE,
    MICRO_RESPONSE,
    SHEAR_RESPONSE,
    Dataset,
    PlainDataset,
    with_cautions,
)
from multiscale.surfaces.surface import Surface
from multiscale.upscaling import loading_branch, normal_observations
from multiscale.upscaling.sampling import Control, best_ratio

__all__ = [
    "COARSER_CELLS",
    "COARSER_SHEAR",
    "CONTROL_CELLS",
    "COST",
    "POINT_FRICTION",
    "SHEARED_CELLS",
    "best_count",
    "press_control",
    "run_shear",
]

SHEARED, COARSER, FLAT = "micro-shear", "micro-coarser", "micro-control"
"""Folders of a run; those of sheared and of flat cells have a folder for each way to solve them."""

POINT_FRICTION = "friction_coefficient"
"""Attribute of the response: friction of points of contact, which the case gives."""

AMPLITUDE = 1.0  # of the closed cycle, relative to the slip over which a joint gives way

BATCH = 16
"""Cells of one job and one file; a job of windows of a map has one."""

TOLERANCE = 3e-3
"""Of the flat cells: an error that follows the surface is taken out by the pairs. At 128 x 128
points correlations are as with 1e-6, of gaps .99996 and of stiffnesses .9993 to .9999, in half of
the time."""

COST = 50.0
"""Time of a conforming cell over the time of a flat one, which was 57 at 128 x 128 points. Other
cells are dearer. Measured times would give every run another number of cells, and other answers."""

MOST = 256
"""Cells by the rule of the best ratio: the error of their mean is an eighth of the scatter of
single cells. More are there if stated."""

CHANCE = (
    "mean gaps of the control cells follow the mean gaps of the {} cells by chance alone, so that "
    "law and bands rest on these alone; control = false in [micro] saves the time"
)
BODIES = dict.fromkeys(("body_1", "body_2", "cell"), True)
SHEAR_KEYS = {**BODIES, "micro": {"pressures", "seed", "shear"}}
FLAT_KEYS = {"pressures", "unload", "seed"}
"""Keys on which these cells depend."""


def run_shear(case: Case, job: Job) -> Dataset:
    """Press the cells over the pressures of the law, release them, and shear them.

    Pressed on the grid on which they are sheared, they have normal laws of their own, in which a
    coarser grid errs as it does in the shear.
    """
    own = _as_sheared(case)
    cells = [_pair(own, pair) for pair in two_surfaces(own)]
    shear = own.micro.shear
    path = shear_path(
        cells[0],
        shear.pressures,
        steps=shear.steps,
        cycle=AMPLITUDE if shear.cycle else 0.0,
        pressed=own.micro.pressures,
    )
    way = case.checksum(include=SHEAR_KEYS, exclude={"micro": {"shear": {"realisations"}}})
    kept = job.ensemble(f"{SHEARED}/{way[:12]}", way, len(cells), "sheared cells")
    response = run_ensemble(cells, path, **kept)
    ended = str(response.attrs.get("ended", "")).splitlines()
    told: dict[str, Any] = {POINT_FRICTION: shear.friction_coefficient}
    return response.assign_attrs(
        title=case.title,
        bodies="body_1 and body_2, both deformable, with friction",
        cautions="\n".join(f"sheared {one}" for one in ended),
        **told,
    )


def _as_sheared(case: Case) -> Case:
    """Return the case with the number and the grid of the cells that are sheared."""
    shear = case.micro.shear
    grid = {"points": shear.points or case.cell.points, "layers": shear.layers or case.cell.layers}
    micro = case.micro.model_copy(update={"realisations": shear.realisations})
    return case.model_copy(update={"cell": case.cell.model_copy(update=grid), "micro": micro})


def _pair(case: Case, surfaces: tuple[Surface, Surface]) -> FiniteCell:
    lower, upper = (Elastic(body.youngs_modulus, body.poissons_ratio) for body in case.bodies)
    mu, coatings = case.micro.shear.friction_coefficient, (case.body_1.stack, case.body_2.stack)
    return two_bodies(case.cell, surfaces, (lower, upper), mu, coatings)


def _shear_needs(case: Case) -> Needs:
    own = _as_sheared(case)
    shear, (nx, ny) = own.micro.shear, own.cell.points
    pair = _pair(own, smooth_pair(own.cell)).needs()
    unknowns = 6 * nx * ny * own.cell.layers
    each = shear.steps + 2 + (4 if shear.cycle else 0)
    steps = len(own.micro.pressures) + 1 + 2 * len(shear.pressures) * each
    time = pair.seconds * steps * shear.realisations
    cells = Choice(
        "sheared cells",
        f"{shear.realisations} of two bodies with friction, {nx} x {ny} points and {unknowns} "
        f"unknowns, each in {steps} steps",
    )
    return Needs(unknowns_per_contact=3, choices=(cells,), memory=pair.memory, seconds=time)


def _press_coarser(case: Case, found: Datasets, job: Job) -> Dataset:
    cells = make_cells(case.coarser())
    kept = job.ensemble(COARSER, case.identity(), len(cells), "coarser cells")
    path = Path(pressure=case.micro.pressures)
    response = run_ensemble(cells, path, keep_flow=case.micro.leakage, **kept)
    return response.assign_attrs(title=case.title)


def _coarser_needs(case: Case) -> Needs:
    nx, ny = case.coarser().cell.points
    told = f"{case.micro.coarser} of {nx} x {ny} points, for the error of the grid"
    coarse = CELLS.needs(case.coarser())
    cells = Choice("coarser cells", told)
    return Needs(choices=(cells,), memory=coarse.memory, seconds=coarse.seconds)


def _coarser_shear_needs(case: Case) -> Needs:
    coarse = SHEARED_CELLS.needs(case.coarser())
    (told,) = coarse.choices
    return replace(coarse, choices=(Choice("coarser sheared cells", told.why),))


def _press_flat(case: Case, found: Datasets, job: Job) -> Dataset:
    """Press as many as stated, or the best number; see :func:`best_count`."""
    response, count = found[CELLS.name], case.micro.control_realisations
    pairs, told = response.sizes["realisation"], f"{count} as stated"
    first = press_control(case, pairs, job)
    control = normal_observations(loading_branch(response), first).control
    if count is None:
        count, told = best_count(pairs, control)
    every = press_control(case, max(count, pairs), job)
    alone = "" if control else CHANCE.format(pairs)
    return with_cautions(every.assign_attrs(title=case.title, number=told), alone)


def press_control(case: Case, count: int, job: Job) -> Dataset:
    """Press flat cells on the surfaces of the first realisations; finished ones are kept."""
    step = 1 if case.measured else BATCH
    whole = -(-count // step)
    others = {body: set(CONDUCTIVITIES) for body in ("body_1", "body_2")}
    way = case.checksum(include={**BODIES, "micro": FLAT_KEYS}, exclude=others)
    arguments = [(case, *ends) for ends in pairwise(step * k for k in range(whole + 1))]
    kept = job.ensemble(f"{FLAT}/{way[:12]}", way, whole, "control cells", each=step)
    control = run_realisations(_press_batch, arguments, name="cells", **kept)
    return control.isel(realisation=range(count))


def _press_batch(case: Case, start: int, stop: int) -> PlainDataset:
    """Press the flat cells of some realisations under all pressures of the path, rising."""
    if case.measured:
        cells = make_cells(case.control(stop))[start:]
    else:
        micro = case.micro.model_copy(update={"seed": case.micro.seed + start})
        cells = make_cells(case.model_copy(update={"micro": micro}).control(stop - start))
    path = Path(pressure=tuple(sorted({*case.micro.path})))
    records = [record_realisation(cell, path, Keep(), tolerance=TOLERANCE) for cell in cells]
    ended = [str(one.attributes["ended"]) for one in records if "ended" in one.attributes]
    values = MICRO_RESPONSE.join(records, "realisation").values
    return PlainDataset(values, {"ended": "; ".join(ended)} if ended else {})


def best_count(pairs: int, control: Control | None) -> tuple[int, str]:
    """Return the number of flat cells that is best for the time, and how it was found.

    The least variance for a time is at the ratio of :func:`best_ratio`, by the median of the
    correlations of the gap; they take no more than the time of the cells. The nearest power of two
    is taken.
    """
    if control is None:
        return pairs, "no more than the cells, which they follow by chance alone"
    correlation = float(np.median(control.correlation))
    best = pairs * best_ratio(correlation, COST)
    count = 2 ** round(np.log2(min(best, pairs * COST, MOST)))
    return count, (
        f"{count}: {best:.3g} would be best for the time at a correlation of {correlation:.5g} and "
        f"a cost of 1/{COST:g} of a cell; they take at most about the time of the cells, and are "
        f"a power of two, at most {MOST}"
    )


def _flat_needs(case: Case) -> Needs:
    stated = case.micro.control_realisations
    number = f"{stated} flat ones" if stated else "flat ones, by times and correlation,"
    told = (
        f"{number} on the surfaces of the {case.micro.realisations} cells and on further ones, as "
        f"control variates: the law has their sampling error, and the error of the differences"
    )
    most = stated or min(MOST, int(COST) * case.micro.realisations)
    flat = CELLS.needs(case.control(most))
    cells = Choice("control cells", told)
    return Needs(choices=(cells,), memory=flat.memory, seconds=flat.seconds)


def _count(found: Datasets) -> list[tuple[str, str]]:
    control = found[CONTROL_CELLS.name]
    return [
        ("control cells", str(control.attrs["number"])),
        ("solver time of the control cells", f"{float(control['wall_time'].sum()):.1f} s"),
    ]


SHEARED_CELLS = Stage(
    schema=SHEAR_RESPONSE,
    tables=("micro.shear",),
    reads=SHEAR_KEYS,
    run=lambda case, found, job: run_shear(case, job),
    needs=_shear_needs,
    folders=(SHEARED,),
)
COARSER_CELLS = Stage(
    schema=COARSER_RESPONSE,
    tables=("micro.coarser",),
    reads={**BODIES, "micro": {"pressures", "seed", "coarser", "leakage"}},
    run=_press_coarser,
    needs=_coarser_needs,
    folders=(COARSER,),
)
COARSER_SHEAR = Stage(
    schema=COARSER_SHEAR_RESPONSE,
    tables=("micro.coarser", "micro.shear"),
    reads={**BODIES, "micro": {"pressures", "seed", "coarser", "shear"}},
    run=lambda case, found, job: run_shear(case.coarser(), job),
    needs=_coarser_shear_needs,
)
CONTROL_CELLS = Stage(
    schema=CONTROL_RESPONSE,
    tables=("micro.control",),
    reads={**BODIES, "micro": {*FLAT_KEYS, "realisations", "control", "control_realisations"}},
    takes=(CELLS,),
    run=_press_flat,
    needs=_flat_needs,
    work=_count,
    folders=(FLAT,),
)
