"""Stage: many flat cells, control variates of dearer ones on the same surfaces."""

from itertools import pairwise

import numpy as np

from multiscale.micro import Path
from multiscale.micro.averages import Keep
from multiscale.micro.ensemble import record_realisation, run_realisations
from multiscale.needs import Choice, Needs
from multiscale.pipeline.case_cells import make_cells
from multiscale.pipeline.settings import CONDUCTIVITIES, Case
from multiscale.pipeline.stage import Datasets, Job, Stage
from multiscale.pipeline.stages.cells import CELLS
from multiscale.schema import CONTROL_RESPONSE, MICRO_RESPONSE, Dataset, PlainDataset, with_cautions
from multiscale.upscaling import loading_branch, normal_observations
from multiscale.upscaling.control_variates import Control, best_ratio

__all__ = ["CONTROL_CELLS", "press_control"]

FOLDER = "micro-control"

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
KEYS = {"pressures", "unload", "seed"}
OTHERS = {body: set(CONDUCTIVITIES) for body in ("body_1", "body_2")}
"""Keys on which these cells depend, and those of them on which they do not."""


def _run(case: Case, found: Datasets, job: Job) -> Dataset:
    """Press as many as stated, or the best number; see :func:`_best_count`."""
    response, count = found[CELLS.name], case.micro.control_realisations
    pairs, told = response.sizes["realisation"], f"{count} as stated"
    first = press_control(case, pairs, job)
    control = normal_observations(loading_branch(response), first).control
    if count is None:
        count, told = _best_count(pairs, control)
    every = press_control(case, max(count, pairs), job)
    alone = "" if control else CHANCE.format(pairs)
    return with_cautions(every.assign_attrs(title=case.title, number=told), alone)


def press_control(case: Case, count: int, job: Job) -> Dataset:
    """Press flat cells on the surfaces of the first realisations; finished ones are kept."""
    step = 1 if case.measured else BATCH
    whole = -(-count // step)
    way = case.checksum(include={**BODIES, "micro": KEYS}, exclude=OTHERS)
    arguments = [(case, *ends) for ends in pairwise(step * k for k in range(whole + 1))]
    kept = job.ensemble(f"{FOLDER}/{way[:12]}", way, whole, "control cells", each=step)
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


def _best_count(pairs: int, control: Control | None) -> tuple[int, str]:
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


def _needs(case: Case) -> Needs:
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


CONTROL_CELLS = Stage(
    schema=CONTROL_RESPONSE,
    tables=("micro.control",),
    reads={**BODIES, "micro": {*KEYS, "realisations", "control", "control_realisations"}},
    takes=(CELLS,),
    run=_run,
    needs=_needs,
    work=_count,
    folders=(FOLDER,),
)
