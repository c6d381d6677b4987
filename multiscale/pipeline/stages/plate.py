"""Stage: an elastic plate, whole or cut."""

from collections.abc import Iterator

import numpy as np

from multiscale import macro
from multiscale.io import write_body_fields
from multiscale.macro import substructures
from multiscale.macro.substructures.substructure_needs import cut_needs
from multiscale.pipeline.made_bodies import Plate
from multiscale.pipeline.settings import Case
from multiscale.pipeline.showing import Table, View
from multiscale.pipeline.stage import Datasets, Job, Section
from multiscale.pipeline.structure_stage import structure_stage, with_too_far
from multiscale.plotting.body_figures import plot_body_stress
from multiscale.plotting.figure import in_space
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = ["PLATE"]


def _solve(plate: Plate, case: Case, found: Datasets, job: Job) -> Dataset:
    assembly, factors = plate.build(), np.array(case.statics.load_factors)
    result = macro.solve_assembly(assembly, factors, method=case.cut.method(job.team))
    result = substructures.add_body_fields(result, assembly.bodies)
    largest = np.linalg.norm(result["displacement"].to_numpy(), axis=2).max(axis=1)
    return with_too_far(MACRO_RESULT.assign(result, {"largest_displacement": largest}))


def _answer(result: Dataset) -> Iterator[str]:
    """Report the largest displacement at the last load factor, and the largest stress."""
    known = np.flatnonzero(result["converged"].to_numpy() == 1)
    for last in (result.isel(step=k) for k in known[-1:]):
        last = last.assign(equivalent_stress=last["equivalent_stress"].max())
        yield from View(result).sentences(
            last,
            "At the load factor {load_factor} the plate moves by up to {largest_displacement}, and "
            "the largest mean stress of an element is {equivalent_stress} (von Mises).",
        )


def _sections(result: Dataset) -> Iterator[Section]:
    """Show the plate at the last step."""
    known = np.flatnonzero(result["converged"].to_numpy() == 1)
    if known.size:
        drawn = in_space(plot_body_stress, result, step=int(known[-1]))
        yield Section("Plate", figures={"body_stress": drawn})


PLATE = structure_stage(
    "plate",
    _solve,
    lambda plate, case: cut_needs(
        3 * plate.nodes, substructures=case.cut.count, coarse=case.cut.coarse
    ),
    Table(("load_factor", "largest_displacement", "iterations", "residual")),
    write_body_fields,
    reads={"structure", "statics", "substructures"},
    question="How far does the plate move under its loads?",
    answers={"largest_displacement": ""},
    more=_sections,
    pictures=("body_stress",),
    answer=_answer,
)
