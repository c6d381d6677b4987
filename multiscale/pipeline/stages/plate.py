"""Stage: an elastic plate, whole or cut."""

import numpy as np

from multiscale import macro
from multiscale.io import write_body_fields
from multiscale.macro import substructures
from multiscale.macro.substructures.substructure_needs import cut_needs
from multiscale.pipeline.body_settings import Plate
from multiscale.pipeline.rows import Table
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, StageAnswer
from multiscale.pipeline.structure_stage import structure_stage, with_too_far
from multiscale.schema import Dataset

__all__ = ["PLATE"]


def _solve(plate: Plate, case: Case, found: Datasets, job: Job) -> Dataset:
    assembly, factors = plate.build(), np.array(case.statics.load_factors)
    result = macro.solve_assembly(assembly, factors, method=case.cut.method(job.team))
    return with_too_far(substructures.add_body_fields(result, assembly.bodies))


def _compared(result: Dataset) -> Dataset:
    """Return the largest component of the displacements."""
    moved = abs(result["displacement"]).max(("node", "component"))
    named = moved.assign_attrs(units="m", long_name="largest displacement")
    return result.assign(largest_displacement=named)


def _tabulate(result: Dataset) -> Table:
    """Head and rows of a body under its loads."""
    largest = 1e6 * np.abs(result["displacement"].values).max(axis=(1, 2))
    return ("load", "largest displacement (µm)", "iterations", "residual"), [
        (f"{load:.4g}", f"{u:.4g}", f"{n}", f"{residual:.1e}")
        for load, u, n, residual in zip(
            result["load_factor"].values,
            largest,
            result["iterations"].values,
            result["residual"].values,
            strict=True,
        )
    ]


PLATE = structure_stage(
    "plate",
    _solve,
    lambda plate, case: cut_needs(
        3 * plate.nodes, substructures=case.cut.count, coarse=case.cut.coarse
    ),
    _tabulate,
    write_body_fields,
    reads={"structure", "statics", "substructures"},
    question="How far does the plate move under its loads?",
    answers=(StageAnswer("largest_displacement", "largest displacement", "µm", 1e6),),
    compared=_compared,
)
