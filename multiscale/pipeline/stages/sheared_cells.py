"""Stage: cells of both bodies with friction, pressed, sheared until they slip, and released."""

from typing import Any

from multiscale.laws.bulk import Elastic
from multiscale.micro import FiniteCell, run_ensemble, shear_path
from multiscale.needs import Choice, Needs
from multiscale.pipeline.case_cells import smooth_pair, two_bodies, two_surfaces
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Job, Stage
from multiscale.schema import SHEAR_RESPONSE, Dataset
from multiscale.surfaces.surface import Surface

__all__ = ["FOLDER", "POINT_FRICTION", "SHEARED_CELLS", "run_shear"]

POINT_FRICTION = "friction_coefficient"
"""Attribute of the response: friction of points of contact, which the case gives."""

FOLDER = "micro-shear"  # has a folder of cells for each way to shear them

AMPLITUDE = 1.0  # of the closed cycle, relative to the slip over which a joint gives way

READS = {
    **dict.fromkeys(("body_1", "body_2", "cell"), True),
    "micro": {"pressures", "seed", "shear"},
}


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
    way = case.checksum(include=READS, exclude={"micro": {"shear": {"realisations"}}})
    kept = job.ensemble(f"{FOLDER}/{way[:12]}", way, len(cells), "sheared cells")
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


def _needs(case: Case) -> Needs:
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


SHEARED_CELLS = Stage(
    schema=SHEAR_RESPONSE,
    tables=("micro.shear",),
    reads=READS,
    run=lambda case, found, job: run_shear(case, job),
    needs=_needs,
    folders=(FOLDER,),
)
