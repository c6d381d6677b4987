"""Stage: elastic bodies with rough joints, at their preloads and in cycles."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io import write_body_fields
from multiscale.laws import InterfaceLaw
from multiscale.macro.bodies import Assembly
from multiscale.macro.substructures import (
    FEW_STEPS,
    FollowedJoint,
    JointLoading,
    JointSize,
    Method,
    add_body_fields,
    condense_assembly,
    follow_joint,
    measure_joint,
)
from multiscale.needs import Choice, Needs
from multiscale.pipeline.body_budget import (
    PARAMETERS,
    Change,
    JointsOfLaw,
    change_friction,
    with_joint_budget,
)
from multiscale.pipeline.body_settings import RoughBodies
from multiscale.pipeline.joint_answers import joint_answers
from multiscale.pipeline.joint_settings import Cycles
from multiscale.pipeline.real_contact import with_contact
from multiscale.pipeline.rows import (
    joint_unit,
    list_bolts,
    list_facts,
    say_value,
    tabulate_cycles,
    tabulate_preloads,
)
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, Section, StageAnswer
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.joint import budget_sections, of_stiffness
from multiscale.pipeline.structure_stage import (
    choose_solver,
    counting,
    require_known,
    solver_needs,
    structure_stage,
    with_law_cautions,
    with_too_far,
)
from multiscale.plotting import joint_pictures
from multiscale.plotting.figure import on_axes
from multiscale.units import Unit

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ROUGH_JOINTS"]


PICTURES = (
    "contact_zones",
    "pressure",
    "hysteresis",
    "loss",
    "joint_stiffness",
    "secant_stiffness",
    "cycle_loss",
    "error_budget",
)
"""Names of all figures of rough joints."""


ANSWERS = (
    StageAnswer("preload", "preload", "MPa", 1e-6, drawn=False),
    of_stiffness("joint_stiffness", "joint stiffness"),
    of_stiffness("tangential_stiffness", "tangential stiffness"),
    of_stiffness("interface_stiffness", "interface stiffness"),
    StageAnswer("real_pressure", "real pressure", "MPa", 1e-6, over="preload"),
    StageAnswer("slipping_load", "load that slips", "%", 100.0),
    StageAnswer("cycle_energy", "loss of a cycle", "mJ", 1e3),
)
"""What joints are compared by: at the preloads, at the amplitude, and by their cycles."""


def _solve(bodies: RoughBodies, case: Case, found: Datasets, job: Job) -> "xr.Dataset":
    """Press the joints, then shear them; stiffnesses have the error budget of the law."""
    dataset, preloads = case.interface_law(found), case.statics.preloads
    assembly, loading = bodies.assemble(case, dataset), _loading(case)
    chosen = choose_solver(case, _size(bodies, case), job.team)
    method = chosen.taken.method
    joint = condense_assembly(assembly, method)
    watched = counting(method, job, _count_steps(case))
    followed = follow_joint(joint.small, loading, method=watched)
    result = measure_joint(followed, assembly.areas, extrapolate=case.extrapolate)
    result = with_contact(joint.restore(result), dataset)
    result = with_law_cautions(result, case, found, {"its law": dataset})
    bolts = list_bolts(result, result["preload"].to_numpy()) if assembly.bolts else []
    solver = f"Solved by {method.name}: {chosen.why}."
    result = result.assign_attrs(facts="\n".join([*list_facts(result), *bolts, solver]))
    if "error_half_width" in dataset:
        solved = int(result["converged"][: len(preloads)].sum())  # the first failure is the end
        short = JointLoading(preloads[:solved])
        if case.cycles and result["converged"].values.all():
            short = JointLoading(preloads, amplitudes=case.cycles.all_amplitudes, amplitude_steps=1)
        measured = [name for name in PARAMETERS if getattr(case.interface, name) is None]
        law = JointsOfLaw(dataset, tuple(range(bodies.joints)), measured)
        changed = partial(_change_laws, bodies, case, dataset)
        near = follow_joint(joint.small, short, method=method)
        solve = partial(_solve_changed, near, assembly.areas, changed, method)
        asked = joint_answers(result)
        result = with_joint_budget(result, [law], solve, asked, bodies.coarser(), job)
    return with_too_far(add_body_fields(result, assembly.bodies, damage=bodies.damages))


def _change_laws(
    bodies: RoughBodies, case: Case, law: "xr.Dataset", change: Change
) -> list[InterfaceLaw]:
    """Make the laws of all joints with a change."""
    return change_friction(bodies.sliders(case, law, normal=change.normal), change)


def _solve_changed(
    near: FollowedJoint,
    areas: Sequence[float],
    laws: Callable[[Change], list[InterfaceLaw]],
    method: Method,
    change: Change,
) -> "xr.Dataset":
    """Solve the joints again with a change, near those without it."""
    changed = laws(change)
    if change.structure is None:
        problem = near.path.problem.with_laws(changed)
        found = follow_joint(problem, near.loading, method=method, near=near)
        return measure_joint(found, areas, extrapolate=True)
    other: Assembly = change.structure.build(changed)  # type: ignore[call-arg,arg-type,assignment]  # of the same kind
    found = follow_joint(condense_assembly(other, method).small, near.loading, method=method)
    return measure_joint(found, other.areas, extrapolate=True)


def _loading(case: Case) -> JointLoading:
    """Preloads, and cycles if there are any."""
    preloads = case.statics.preloads
    return case.cycles.loading(preloads) if case.cycles else JointLoading(preloads)


def _size(bodies: RoughBodies, case: Case) -> JointSize:
    """Count unknowns, points of joints and load steps."""
    (nodes, face), count = bodies.nodes, bodies.joints + 1
    return JointSize(3 * nodes * count, face * bodies.joints, count, _count_steps(case))


def _needs(bodies: RoughBodies, case: Case) -> Needs:
    size = _size(bodies, case)
    needs = solver_needs(choose_solver(case, size), size, bodies.slabs(case))
    own, path, pressed = len(case.statics.preloads), "alone", "the preloads"
    if case.cycles:
        few, cycles = len(case.cycles.all_amplitudes), case.cycles
        path = f"and {own} x {few} cycles of one step to their amplitudes"
        pressed = (
            f"{_count_steps(case)} load steps: preloads, cycles at the last one ({cycles.cycles}), "
            f"and one cycle at each of {own} preloads and {few} amplitudes"
        )
    solves = Choice(
        "intervals",
        f"{'5 to 7' if case.cycles else '3 to 6'} more solves, of the preloads {path}, if the law "
        f"carries a budget: one for each of its terms, measured friction and stiffness ratio, beds "
        f"of half the slabs, and the mesh",
    )
    loading = Choice("loading", pressed)
    libraries = (*needs.libraries, *bodies.mesher)
    return replace(needs, libraries=libraries, choices=(*needs.choices, loading, solves))


def _count_steps(case: Case) -> int:
    """Count the load steps: preloads, cycles at the last one, and a cycle at each amplitude."""
    own: int = len(case.statics.preloads)
    cycles: Cycles | None = case.cycles
    if cycles is None:
        return own
    short = own * len(cycles.all_amplitudes) * (1 + 4 * FEW_STEPS)
    return own + cycles.steps * (1 + 4 * cycles.cycles) + short


def _answer(result: "xr.Dataset") -> list[str]:
    """Say stiffness, slip and loss at the last of the preloads with an answer."""
    known = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()))
    if not known.size:
        return []
    last, unit = result.isel(step=known[-1]), joint_unit(result)
    normal, tangential = (
        say_value(last, f"{name}_stiffness", unit) for name in ("joint", "tangential")
    )
    return [
        f"At a preload of {1e-6 * float(last['preload']):.4g} MPa the joint has a normal stiffness "
        f"of {normal} and, before it slips, a tangential stiffness of {tangential}.",
        *_losses(result),
    ]


def _losses(result: "xr.Dataset") -> Iterator[str]:
    """Say what the last cycle at the last preload loses, and what slips."""
    if "cycle_energy" in result and np.isfinite(result["cycle_energy"].values[-1]):
        end = result.isel(step=-1, cycle=-1)
        loss, slip = (
            say_value(end, name, unit)
            for name, unit in (("cycle_energy", Unit("mJ", 1e3)), ("slipping_load", Unit("%", 1e2)))
        )
        shear = 1e-6 * float(np.abs(result["shear"]).max())
        yield (
            f"A cycle of shear between {shear:.3g} and -{shear:.3g} MPa loses {loss}; at its ends, "
            f"contacts under {slip} of the load slip."
        )


def _sections(result: "xr.Dataset") -> Iterator[Section]:
    """Show where the joints stick, slip and open, their loop, and what is known of their errors."""
    told = [
        "Zones and pressure are seen along the normal of the first joint, at the step at which "
        "most of its area slips; lines are the outlines of the parts.",
    ]
    figures = {name: on_axes(plot) for name, plot in joint_pictures(result).items()}
    yield Section("Joint", told, figures=figures)
    if "cycle_loss" in result:
        cycles = [
            "From each preload the shear makes a closed cycle of each amplitude, the smallest one "
            "first. The secant stiffness is the shear over the displacement of the sheared face "
            "between both ends of a cycle. Bands are the 95 % intervals of the mean law and of one "
            "part.",
        ]
        yield Section("Cycles of shear", cycles, *tabulate_cycles(result))
    yield from budget_sections(result)


def _compared(result: "xr.Dataset") -> "xr.Dataset":
    """Return the answers at the preloads and of cycles, with the slip at the end of the path."""
    slip = [name for name in result if str(name).startswith("slipping_load")]
    sheared = np.flatnonzero(result["shear"].to_numpy())
    if not sheared.size:
        return result.drop_vars(slip)
    ends = {name: result[name].isel(step=-1) for name in slip}
    return result.isel(step=slice(sheared[0])).assign(ends)


ROUGH_JOINTS = structure_stage(
    "rough_joints",
    _solve,
    _needs,
    tabulate_preloads,
    write_body_fields,
    reads={"strict", "structure", "interface", "statics", "cycles", "substructures"},
    takes=(FITTED_LAW,),
    question="How stiff are the joints, where do they slip, and what do they lose in a cycle?",
    check=partial(require_known, answer="approach"),
    more=_sections,
    pictures=PICTURES,
    answer=_answer,
    answers=ANSWERS,
    compared=_compared,
)
