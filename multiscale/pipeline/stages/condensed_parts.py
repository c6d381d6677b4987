"""Stage: the substructures of a structure, condensed onto the resultants of their interfaces."""

import numpy as np

from multiscale import macro
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, Stage
from multiscale.pipeline.stages.links import LINKS
from multiscale.pipeline.stages.plate import PLATE
from multiscale.pipeline.stages.rough_joints import ROUGH_JOINTS
from multiscale.schema import HOMOGENISED, MACRO_RESULT, Dataset

__all__ = ["CONDENSED_PARTS"]


def _run(case: Case, found: Datasets, job: Job) -> Dataset:
    """Condense at the last step that converged."""
    result = found[MACRO_RESULT.name]
    solved = np.isfinite(result["displacement"].values).all(axis=(1, 2))
    step = int(np.flatnonzero(solved)[-1])
    assert case.structure is not None  # it asks for the stage
    return macro.homogenise(case.structure.cut(case, found, job), result, step=step).assign_attrs(
        title=case.title
    )


CONDENSED_PARTS = Stage(
    schema=HOMOGENISED,
    tables=("structure", "homogenise"),
    reads={"substructures"},
    takes=(LINKS, PLATE, ROUGH_JOINTS),
    run=_run,
)
