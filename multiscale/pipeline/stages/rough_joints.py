"""Stage: elastic bodies with rough joints, at their preloads and in cycles."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from multiscale.io import write_body_fields
from multiscale.laws import NormalLaw
from multiscale.macro.substructures import JointLoading, add_body_fields, load_joint
from multiscale.macro.substructures.substructure_needs import cut_needs
from multiscale.needs import Choice, Needs
from multiscale.pipeline.body_budget import (
    PARAMETERS,
    change_friction,
    few_steps,
    joint_answers,
    with_contact,
    with_joint_budget,
)
from multiscale.pipeline.body_settings import RoughBodies
from multiscale.pipeline.rows import list_bolts, list_facts, tabulate_preloads
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, Section, list_cautions
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.joint import budget_section
from multiscale.pipeline.structure_stage import require_known, structure_stage, with_too_far
from multiscale.plotting import joint_pictures
from multiscale.plotting.figure import on_axes
from multiscale.schema import with_cautions

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ROUGH_JOINTS"]


PICTURES = ("contact_zones", "pressure", "hysteresis", "loss", "joint_stiffness", "error_budget")
"""Names of all figures of rough joints."""


def _solve(bodies: RoughBodies, case: Case, found: Datasets, job: Job) -> "xr.Dataset":
    """Press the joints, then shear them; stiffnesses have the error budget of the law."""
    dataset, preloads = case.interface_law(found), case.statics.preloads
    assembly, method = bodies.assemble(case, dataset), case.cut.method(job.team)
    loading = JointLoading(preloads, **(case.cycles.model_dump() if case.cycles else {}))
    result = load_joint(assembly, loading, method=method, extrapolate=case.extrapolate)
    result = with_contact(result, dataset)
    # those of cells of its own stand beside those of the structure
    told = list_cautions(found[FITTED_LAW.name]) if case.has_cells else []
    further = [one for one in list_cautions(dataset) if one not in told]
    result = with_cautions(result, *(f"its law: {one}" for one in further))
    if assembly.bolts:
        bolts = list_bolts(result, result["preload"].to_numpy())
        result = result.assign_attrs(facts="\n".join([*list_facts(result), *bolts]))
    if "error_half_width" in dataset:
        solved = int(result["converged"][: len(preloads)].sum())  # the first failure is the end
        short = JointLoading(preloads[:solved])
        if case.cycles and result["converged"].values.all():
            short = JointLoading(preloads, case.cycles.shear, cycles=1, steps=few_steps(case))

        def solve(normal: NormalLaw, structure: Any, factors: Mapping[str, float]) -> "xr.Dataset":
            parts = (structure or bodies).assemble(case, dataset, normal=normal)
            parts = change_friction(parts, factors)
            return load_joint(parts, short, method=method, extrapolate=True)

        measured = [name for name in PARAMETERS if getattr(case.interface, name) is None]
        asked, coarser = joint_answers(result, few_steps(case)), bodies.coarser()
        meshes = {} if coarser is None else {2.0: coarser}
        result = with_joint_budget(result, dataset, solve, asked, meshes, measured)
    return with_too_far(add_body_fields(result, assembly.bodies, damage=bodies.damages))


def _needs(bodies: RoughBodies, case: Case) -> Needs:
    nodes, face = bodies.nodes
    count = bodies.joints + 1
    needs = cut_needs(
        3 * nodes * count,
        joint_points=face * bodies.joints,
        substructures=count * case.cut.count,
        coarse=case.cut.coarse,
        slabs=bodies.slabs(case),
    )
    path = f"and one cycle of {few_steps(case)} steps to its amplitude" if case.cycles else "alone"
    solves = Choice(
        "intervals",
        f"{4 if case.cycles else 3} to 6 more solves, of the preloads {path}, if the law carries a "
        f"budget: one for each of its terms, measured friction and stiffness ratio, and the mesh",
    )
    libraries = (*needs.libraries, *bodies.mesher)
    return replace(needs, libraries=libraries, choices=(*needs.choices, solves))


def _sections(result: "xr.Dataset") -> Iterator[Section]:
    """Show where the joints stick, slip and open, their loop, and what is known of their errors."""
    told = [
        "Zones, pressure and outlines of the parts are those seen along the normal of the first "
        "joint, at the step at which most of its area slips.",
    ]
    figures = {name: on_axes(plot) for name, plot in joint_pictures(result).items()}
    yield Section("Joint", told, figures=figures)
    yield budget_section(result)


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
)
