"""Stage of elastic bodies under loads: preload and shear of joints, or named loads."""

from dataclasses import replace
from functools import partial

import numpy as np

from multiscale.errors import SchemaError
from multiscale.io.fields import write_body_fields
from multiscale.macro import substructures
from multiscale.needs import Choice, Needs
from multiscale.pipeline import showing, structure_stage
from multiscale.pipeline.body_budget import with_joint_budget
from multiscale.pipeline.body_sources import ErrorSources
from multiscale.pipeline.plans.case_knobs import body_knobs
from multiscale.pipeline.stage import Datasets, Job
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.joint_answers import JOINT_ANSWERS
from multiscale.pipeline.stages.load_answers import LOAD_ANSWERS
from multiscale.pipeline.stages.third_body import THIRD_BODY_LAW
from multiscale.pipeline.stages.volumes import REPRESENTATIVE_VOLUME
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.solved_bodies import SolvedBodies
from multiscale.schema import MACRO_RESULT, Dataset, with_cautions

ANSWERS = {"joint": JOINT_ANSWERS, "loads": LOAD_ANSWERS}
"""Answers by the kind of the path, which results have as attribute ``path``."""


def answers_of(result: Dataset) -> structure_stage.PathAnswers:
    """Return the answers of a result."""
    try:
        return ANSWERS[result.attrs["path"]]
    except KeyError:
        raise SchemaError(
            f"the attribute 'path' of the 'macro_result' dataset is {result.attrs.get('path')!r}, "
            f"not 'joint' or 'loads', as in files of earlier versions; run the case again"
        ) from None


def _load(structure: SolvedBodies, case: Case, datasets: Datasets, job: Job) -> Dataset:
    ready = structure_stage.ReadyBodies.of(structure, case, datasets, job)
    followed, result = ready.solve(datasets, job)
    answers = answers_of(result)
    result = _with_budget(answers.complete(result, ready), ready, followed, job)
    facts = [*showing.list_facts(result), *answers.facts(result, ready)]
    if ready.parts.assembly.bolts:
        facts += showing.list_bolts(result, ready.parts.path.factors()[:, 0])
    return ready.finish(result, facts)


def _with_budget(
    result: Dataset,
    ready: structure_stage.ReadyBodies,
    followed: "substructures.FollowedLoads",
    job: Job,
) -> Dataset:
    """Propagate the budgets of all laws to stiffnesses, real pressures and cycles."""
    jointed, path = ready.jointed, ready.parts.path
    sources = ErrorSources.of(jointed)
    result = with_cautions(result, "" if sources.meshes else jointed.bodies.no_coarser)
    if not (sources and job.intervals):
        return result
    if not jointed.laws:  # without laws every converged step is known
        result = MACRO_RESULT.assign(result, {"known": result["converged"].to_numpy()})
    converged = result["converged"].to_numpy() == 1
    solved = int(np.count_nonzero(converged[path.ends() >= 0]))
    if not solved:
        return result
    near = ready.near(followed, path.shortened(solved, bool(converged.all())))
    asked = answers_of(result).with_errors(result, path, partial(ready.first_order, near))
    solve = structure_stage.SolveAgain(jointed, ready.structure.small, ready.method, near)
    return with_joint_budget(result, sources, solve, asked, job)


def _needs(bodies: SolvedBodies, case: Case) -> Needs:
    needs, path = structure_stage.solver_needs(bodies, case), bodies.path(case, ())
    steps, reached = len(path.steps), len(path.amplitudes)
    loading, again = f"{path.count} load steps: the loads of [statics]", "only"
    if path.cycles:
        loading += f", cycles at the last one ({path.cycles})"
        again = f"and one cycle of {path.few} steps to its amplitude"
    if reached:
        loading += f", and one cycle at each of {steps} preloads and {reached} amplitudes"
        again = f"and {steps} x {reached} cycles of one step to their amplitudes"
    choices = [Choice("loading", loading)]
    if bodies.interfaces:
        solves = (
            f"{'5 to 7' if path.cycles else '3 to 6'} more solves, of the steps {again}, for each "
            f"law with a budget: a solve for each of its terms, measured friction and stiffness "
            f"ratio, and a solve with coarser beds and meshes"
        )
        choices.append(Choice("intervals", solves))
    libraries = (*needs.libraries, *bodies.mesher)
    return replace(needs, libraries=libraries, choices=(*needs.choices, *choices))


LOADED_BODIES = structure_stage.structure_stage(
    "loaded_bodies",
    _load,
    _needs,
    lambda result: answers_of(result).tabulate(result),
    write_body_fields,
    reads={"strict", "structure", "interface", "statics", "cycles", "substructures"},
    takes=(FITTED_LAW, THIRD_BODY_LAW, REPRESENTATIVE_VOLUME),
    knobs=body_knobs,
    question=lambda result: answers_of(result).question,
    prepare=lambda bodies, case: bodies.try_to_build(case, substructures.require_held),
    check=partial(structure_stage.require_known, answer="equivalent_stress"),
    more=lambda result: answers_of(result).sections(result),
    answer=lambda result: answers_of(result).sentences(result),
    answers=(
        *("preload", "joint_stiffness", "tangential_stiffness", "interface_stiffness"),
        *("real_pressure", "load_stiffness", "interface_real_pressure", "slipping_load"),
        *("cycle_energy", "bolt_force", "largest_displacement"),
    ),
    compared=lambda result: answers_of(result).compared(result),
)
