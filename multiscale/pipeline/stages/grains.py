"""Stage: rigid grains in frictional contact."""

from dataclasses import replace
from math import ceil

from multiscale.io import write_grain_fields
from multiscale.macro import granulate
from multiscale.macro.granulate.grain_needs import grain_needs
from multiscale.needs import Needs
from multiscale.pipeline.body_settings import doubt_density
from multiscale.pipeline.grain_settings import Granulate
from multiscale.pipeline.rows import tabulate_grains
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, StageAnswer
from multiscale.pipeline.structure_stage import structure_stage
from multiscale.schema import GRANULATE, Dataset, with_cautions

__all__ = ["GRAINS"]

STEP_TIME, GRAIN_TIME = 1.5e-3, 1e-5  # s of a step, and of a grain in it, about
RIGID = 5.0  # times more sweeps of rigid contacts, about


def _solve(given: Granulate, case: Case, found: Datasets, job: Job) -> Dataset:
    """Follow the grains; the attribute ``cautions`` counts steps that missed the tolerance."""
    grains, motion = case.grains, case.motion
    steps = ceil(motion.duration / motion.step)  # at least: an accuracy makes more
    job.progress(0, steps, "time steps")  # the first step tells the time of all
    result = granulate.simulate_grains(
        given.build(grains, motion),
        motion.duration,
        motion.step,
        accuracy=motion.accuracy,
        solver=motion.solver,
        n_frames=motion.frames,
        callback=lambda step, _: job.progress(step + 1, max(step + 1, steps), "time steps"),
    )
    return with_cautions(result, *doubt_density("the material of the grains", grains.density))


def _needs(given: Granulate, case: Case) -> Needs:
    grains, motion = case.grains, case.motion
    needs = grain_needs(
        grains.number,
        motion.frames,
        grains.law,
        motion.solver,
        wall_friction=given.roughest_wall,
        strained=given.strained,
    )
    each = GRAIN_TIME * (1.0 if grains.law.compliance > 0.0 else RIGID)
    steps = motion.duration / motion.step
    return replace(needs, seconds=(STEP_TIME + each * grains.number) * steps)


def _compared(result: Dataset) -> Dataset:
    """Return the state of the grains, with the stress ratio of a cell that is strained."""
    return result.merge(granulate.biaxial_curve(result)) if "stress" in result else result


GRAINS = structure_stage(
    "grains",
    _solve,
    _needs,
    tabulate_grains,
    write_grain_fields,
    reads={"structure", "grains", "motion"},
    question="How do the grains move, and what do their contacts carry?",
    schema=GRANULATE,
    solver=(),
    check=lambda result: None,
    answers=(
        StageAnswer("n_contacts", "contacts", "1"),
        StageAnswer("kinetic_energy", "kinetic energy", "J"),
        StageAnswer("penetration", "overlap over radius", "1"),
        StageAnswer("stress_ratio", "stress ratio q/p", "1"),
    ),
    compared=_compared,
)
