"""Stage of elastic bodies under loads: preload and shear of joints, or named loads."""

from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from multiscale.io.fields import write_body_fields
from multiscale.macro import substructures
from multiscale.needs import Choice, Needs
from multiscale.pipeline import body_budget, showing, structure_stage
from multiscale.pipeline.case_knobs import body_knobs
from multiscale.pipeline.real_contact import with_contact, with_interface_contact
from multiscale.pipeline.stage import Datasets, Job
from multiscale.pipeline.stages.body_answers import answers_of, list_forces, list_interfaces
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.third_body import THIRD_BODY_LAW
from multiscale.pipeline.stages.volumes import REPRESENTATIVE_VOLUME
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.solved_bodies import SolvedBodies
from multiscale.schema import MACRO_RESULT, Dataset, with_cautions


def _load(structure: SolvedBodies, case: Case, datasets: Datasets, job: Job) -> Dataset:
    """Follow the path of the loads; answers have the error budgets of the laws."""
    ready = structure_stage.ReadyBodies.of(structure, case, datasets, job)
    path, parts, laws = ready.parts.path, ready.parts, ready.jointed.laws
    followed, result = ready.solve(datasets, job)
    if path.of_joint:
        result = with_contact(result, cast(Dataset, laws[0]))  # all joints share this law
    elif laws:
        result = with_interface_contact(result, laws)
    result = _with_budget(result, ready, followed, job)
    facts = showing.list_facts(result)
    if path.of_joint:
        facts += list_forces(case.statics.preloads, path.forces)
    else:
        result = result.assign_attrs(bodies=" ".join(body.name for body in structure.bodies))
        if not laws:
            moved = np.linalg.norm(result["displacement"].to_numpy(), axis=2).max(axis=1)
            result = MACRO_RESULT.assign(result, {"largest_displacement": moved})
        facts += ["Displacements are relative to step 0."] if laws else []
        facts += [*parts.facts, *list_interfaces(result)]
    if parts.assembly.bolts:
        facts += showing.list_bolts(result, path.factors()[:, 0])
    return ready.finish(result, facts)


def _with_budget(
    result: Dataset,
    ready: structure_stage.ReadyBodies,
    followed: "substructures.FollowedLoads",
    job: Job,
) -> Dataset:
    """Propagate the budgets of all laws to stiffnesses, real pressures and cycles."""
    jointed, path = ready.jointed, ready.parts.path
    sources = body_budget.ErrorSources.of(jointed)
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
    if path.of_joint:
        asked = body_budget.joint_answers(result, path, partial(ready.first_order, near))
    else:
        asked = body_budget.load_answers(result, path)
    solve = structure_stage.SolveAgain(jointed, ready.structure.small, ready.method, near)
    return body_budget.with_joint_budget(result, sources, solve, asked, job)


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
            f"law with a budget: one for each of its terms, measured friction and stiffness ratio, "
            f"and one with coarser beds and meshes"
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
