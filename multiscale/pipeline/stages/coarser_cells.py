"""Stages: the first cells on half of their points, which tell the error of the grid."""

from dataclasses import replace

from multiscale.micro import Path, run_ensemble
from multiscale.needs import Choice, Needs
from multiscale.pipeline.case_cells import make_cells
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, Stage
from multiscale.pipeline.stages.cells import CELLS
from multiscale.pipeline.stages.sheared_cells import SHEARED_CELLS, run_shear
from multiscale.schema import COARSER_RESPONSE, COARSER_SHEAR_RESPONSE, Dataset

__all__ = ["COARSER_CELLS", "COARSER_SHEAR"]

FOLDER = "micro-coarser"
BODIES = dict.fromkeys(("body_1", "body_2", "cell"), True)


def _press(case: Case, found: Datasets, job: Job) -> Dataset:
    cells = make_cells(case.coarser())
    kept = job.ensemble(FOLDER, case.identity(), len(cells), "coarser cells")
    path = Path(pressure=case.micro.pressures)
    response = run_ensemble(cells, path, keep_flow=case.micro.leakage, **kept)
    return response.assign_attrs(title=case.title)


def _press_needs(case: Case) -> Needs:
    nx, ny = case.coarser().cell.points
    told = f"{case.micro.coarser} of {nx} x {ny} points, for the error of the grid"
    coarse = CELLS.needs(case.coarser())
    cells = Choice("coarser cells", told)
    return Needs(choices=(cells,), memory=coarse.memory, seconds=coarse.seconds)


def _shear_needs(case: Case) -> Needs:
    coarse = SHEARED_CELLS.needs(case.coarser())
    (told,) = coarse.choices
    return replace(coarse, choices=(Choice("coarser sheared cells", told.why),))


COARSER_CELLS = Stage(
    schema=COARSER_RESPONSE,
    tables=("micro.coarser",),
    reads={**BODIES, "micro": {"pressures", "seed", "coarser", "leakage"}},
    run=_press,
    needs=_press_needs,
    folders=(FOLDER,),
)
COARSER_SHEAR = Stage(
    schema=COARSER_SHEAR_RESPONSE,
    tables=("micro.coarser", "micro.shear"),
    reads={**BODIES, "micro": {"pressures", "seed", "coarser", "shear"}},
    run=lambda case, found, job: run_shear(case.coarser(), job),
    needs=_shear_needs,
)
