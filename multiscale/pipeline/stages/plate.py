"""Stage: an elastic plate, whole or cut."""

from collections.abc import Iterator

import numpy as np

from multiscale import macro
from multiscale.io import write_body_fields
from multiscale.macro import substructures
from multiscale.macro.substructures.substructure_needs import cut_needs
from multiscale.pipeline.body_settings import Plate
from multiscale.pipeline.rows import Table
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, Section, StageAnswer
from multiscale.pipeline.structure_stage import structure_stage, with_too_far
from multiscale.plotting.body_figures import plot_body_stress
from multiscale.plotting.figure import in_space
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = ["PLATE"]


def _solve(plate: Plate, case: Case, found: Datasets, job: Job) -> Dataset:
    assembly, factors = plate.build(), np.array(case.statics.load_factors)
    result = macro.solve_assembly(assembly, factors, method=case.cut.method(job.team))
    result = substructures.add_body_fields(result, assembly.bodies)
    known = {"largest_displacement": _largest(result)}
    return with_too_far(MACRO_RESULT.assign(result, known))


def _largest(result: Dataset) -> np.ndarray:
    """Largest displacement of a node at each step, m."""
    moved = np.linalg.norm(result["displacement"].to_numpy(), axis=2)
    return np.asarray(moved.max(axis=1))


def _answer(result: Dataset) -> list[str]:
    """Report the largest displacement at the last load factor, and the largest stress."""
    known = np.flatnonzero(result["converged"].to_numpy() == 1)
    if not known.size or "largest_displacement" not in result:
        return []
    last = result.isel(step=known[-1])
    return [
        f"At the load factor {float(last['load_factor']):.4g} the plate moves by up to "
        f"{1e6 * float(last['largest_displacement']):.4g} µm, and the largest mean stress of an "
        f"element is {1e-6 * float(last['equivalent_stress'].max()):.4g} MPa (von Mises)."
    ]


def _sections(result: Dataset) -> Iterator[Section]:
    """Show the plate at the last step."""
    known = np.flatnonzero(result["converged"].to_numpy() == 1)
    if known.size:
        drawn = in_space(plot_body_stress, result, step=int(known[-1]))
        yield Section("Plate", figures={"body_stress": drawn})


def _tabulate(result: Dataset) -> Table:
    """Head and rows of a body under its loads."""
    largest = 1e6 * _largest(result)
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
    more=_sections,
    pictures=("body_stress",),
    answer=_answer,
)
