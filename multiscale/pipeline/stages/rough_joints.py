"""Stage: elastic bodies with rough joints, at their preloads and in cycles."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from multiscale.io import write_body_fields
from multiscale.macro import substructures
from multiscale.needs import Choice, Needs
from multiscale.pipeline.body_budget import ErrorSources, with_joint_budget
from multiscale.pipeline.joint_answers import joint_answers
from multiscale.pipeline.real_contact import with_contact
from multiscale.pipeline.showing import SLIP, Table, View, list_bolts, list_facts, list_missing
from multiscale.pipeline.stage import Datasets, Job, Section
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.joint import HEADS, STIFFNESS, budget_sections
from multiscale.pipeline.stages.volumes import REPRESENTATIVE_VOLUME
from multiscale.pipeline.structure_stage import (
    ReadyBodies,
    choose_solver,
    counting,
    require_known,
    solver_needs,
    structure_stage,
    with_cautions_of,
)
from multiscale.pipeline.tables.made_bodies import RoughBodies
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting import joint_pictures
from multiscale.plotting.figure import on_axes
from multiscale.schema import Dataset, with_cautions

__all__ = ["ROUGH_JOINTS"]


NO_LARGER = (
    "the error of the mesh is unknown, and no interval counts it: nothing was solved with elements "
    "of twice the size; give smaller elements, or an even number of them, in [structure]"
)

IN_CYCLES = ("secant_stiffness", "cycle_loss", "cycle_slip")

TABLE = Table(
    (
        "preload",
        *STIFFNESS,
        "tangential_stiffness:±",
        "slipping_load",
        "slip_fraction",
        "open_fraction",
        "real_pressure:±",
    ),
    HEADS | {"tangential_stiffness": "tangential, no slip", "slipping_load": "sliding force"},
    answer="approach",
)
"""Of the joints at their preloads."""

CYCLES = Table(
    (
        "cycle_preload",
        "cycle_shear",
        *(f"{name}{form}" for name in IN_CYCLES for form in ("", ":both")),
    ),
    {"cycle_shear": "amplitude", "secant_stiffness": "secant stiffness"},
    answer="cycle_loss",
    at=2,
    along=("level", "amplitude"),
)
"""Of the closed cycles at every preload and amplitude."""

STIFF = (
    "At a preload of {preload} the joint has a normal stiffness of {joint_stiffness:±} and, before "
    "it slips, a tangential stiffness of {tangential_stiffness:±}."
)
LOSES = (
    "A cycle of shear between {most} and -{most} MPa loses {cycle_energy:±}; at its ends, "
    f"{SLIP}."
)
"""Sentences of the answer, at a preload and of the last cycle."""


def _solve(structure: RoughBodies, case: Case, found: Datasets, job: Job) -> Dataset:
    """Press the joints, then shear them; stiffnesses have the error budget of the law."""
    ready = ReadyBodies.of(structure, case, found, job)
    assembly, small = ready.parts.assembly, ready.structure.small
    loading = cast(substructures.JointLoading, ready.parts.loading)  # joints have one
    law = cast(Dataset, ready.laws[0])  # all joints have this one
    watched = counting(ready.method, job, structure.joint_size(case).steps)
    followed = substructures.follow_joint(small, loading, method=watched)
    result = substructures.measure_joint(followed, assembly.areas, extrapolate=case.extrapolate)
    result = with_contact(ready.structure.restore(result), law)
    result = with_cautions_of(result, ready.bodies, case, found, ready.laws)
    bolts = list_bolts(result, result["preload"].to_numpy()) if assembly.bolts else []
    facts = [*list_facts(result), *bolts]
    sources = ErrorSources.of(ready.bodies, case, ready.laws)
    result = with_cautions(result, "" if sources.meshes else NO_LARGER)
    if sources:
        preloads = case.statics.preloads
        solved = int(result["converged"][: len(preloads)].sum())  # the first failure is the end
        short = substructures.JointLoading(preloads[:solved])
        if case.cycles and result["converged"].values.all():
            short = substructures.JointLoading(
                preloads, amplitudes=case.cycles.all_amplitudes, amplitude_steps=1
            )
        near = substructures.follow_joint(small, short, method=ready.method)
        solve = ready.again(partial(_follow, short), near)
        asked = joint_answers(result)
        result = with_joint_budget(result, sources, solve, asked, job)
    return ready.finish(result, facts)


def _follow(
    loading: "substructures.JointLoading",
    problem: "substructures.CutProblem",
    areas: Sequence[float],
    method: "substructures.Method",
    near: "substructures.FollowedJoint | None" = None,
) -> Dataset:
    """Load the joints, maybe near others, whatever the data of the laws."""
    found = substructures.follow_joint(problem, loading, method=method, near=near)
    return substructures.measure_joint(found, areas, extrapolate=True)


def _needs(bodies: RoughBodies, case: Case) -> Needs:
    size = bodies.joint_size(case)
    needs = solver_needs(choose_solver(case, size), size, bodies.slabs(case))
    own, path, pressed = len(case.statics.preloads), "alone", "the preloads"
    if case.cycles:
        few, cycles = len(case.cycles.all_amplitudes), case.cycles
        path = f"and {own} x {few} cycles of one step to their amplitudes"
        pressed = (
            f"{size.steps} load steps: preloads, cycles at the last one ({cycles.cycles}), "
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


def _answer(result: Dataset) -> Iterator[str]:
    """Report stiffness, slip and loss at the last of the preloads with an answer."""
    known = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()))
    if not known.size:
        return
    view = View(result)
    yield from view.sentences(result.isel(step=known[-1]), STIFF)
    if "cycle_energy" in result:
        most = f"{1e-6 * float(np.abs(result['shear']).max()):.3g}"
        yield from view.sentences(result.isel(step=-1, cycle=-1), LOSES, most=most)
    yield from list_missing(result)


def _sections(result: Dataset) -> Iterator[Section]:
    """Show where the joints stick, slip and open, their loop, and what is known of their errors."""
    told = [
        "Zones and pressure are seen along the normal of the first joint, at the last amplitude "
        "that has an answer; a point slides if contacts under more than half of its pressure do, "
        "and is open below 1 % of the mean pressure; lines are the outlines of the parts."
    ]
    figures = {name: on_axes(plot) for name, plot in joint_pictures(result).items()}
    yield Section("Joint", told, figures=figures)
    if "cycle_loss" in result:
        cycles = [
            "From each preload the shear makes a closed cycle of each amplitude, the smallest one "
            "first. The secant stiffness is the shear over the displacement of the sheared face "
            "between both ends of a cycle. Bands are the 95 % intervals of the mean law and of one "
            "part."
        ]
        yield Section("Cycles of shear", cycles, *CYCLES.rows(result))
    yield from budget_sections(result)


def _pressed(result: Dataset) -> Dataset:
    """Return the steps before any shear."""
    sheared = np.flatnonzero(result["shear"].to_numpy())
    return result.isel(step=slice(sheared[0])) if sheared.size else result


def _compared(result: Dataset) -> Dataset:
    """Return the answers at the preloads and of cycles, with the slip at the end of the path."""
    slip = [name for name in result if str(name).startswith("slipping_load")]
    if not result["shear"].any():
        return result.drop_vars(slip)
    return _pressed(result).assign({name: result[name].isel(step=-1) for name in slip})


ROUGH_JOINTS = structure_stage(
    "rough_joints",
    _solve,
    _needs,
    lambda result: TABLE.rows(_pressed(result)),
    write_body_fields,
    reads={"strict", "structure", "interface", "statics", "cycles", "substructures"},
    takes=(FITTED_LAW, REPRESENTATIVE_VOLUME),
    question="How stiff are the joints, where do they slip, and what do they lose in a cycle?",
    check=partial(require_known, answer="approach"),
    more=_sections,
    answer=_answer,
    answers=dict.fromkeys(
        (
            "preload",
            "joint_stiffness",
            "tangential_stiffness",
            "interface_stiffness",
            "real_pressure",
            "slipping_load",
            "cycle_energy",
        ),
        "",
    ),
    compared=_compared,
)
