"""Stage: elastic bodies with rough joints, at their preloads and in cycles."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.io import write_body_fields
from multiscale.laws import NormalLaw
from multiscale.macro.substructures import JointLoading, add_body_fields, load_joint
from multiscale.macro.substructures.substructure_needs import cut_needs
from multiscale.needs import Needs
from multiscale.pipeline.body_budget import with_contact, with_joint_budget
from multiscale.pipeline.body_settings import RoughBodies
from multiscale.pipeline.rows import tabulate_preloads
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, list_cautions
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.joint import STIFFNESSES
from multiscale.pipeline.structure_stage import require_converged, structure_stage, with_too_far
from multiscale.schema import with_cautions

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ROUGH_JOINTS"]


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
    if "error_half_width" in dataset:
        solved = int(result["converged"][: len(preloads)].sum())  # the first failure is the end

        def stiffness(normal: NormalLaw, structure: RoughBodies = bodies) -> np.ndarray:
            pressed = JointLoading(preloads[:solved])
            parts = structure.assemble(case, dataset, normal=normal)
            found = load_joint(parts, pressed, method=method, extrapolate=True)
            return np.stack([found[name].to_numpy() for name in STIFFNESSES])

        result = with_joint_budget(result, dataset, stiffness, bodies.coarser())
    return with_too_far(add_body_fields(result, assembly.bodies, damage=bodies.damages))


def _check(result: "xr.Dataset") -> None:
    """Refuse joints that are nowhere known."""
    require_converged(result)
    if np.isnan(result["approach"].values).all():
        raise ConvergenceError(
            f"{result.attrs['title']}: the answer is unknown at every step; "
            f"{result.attrs['cautions']}"
        )


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
    return replace(needs, libraries=(*needs.libraries, *bodies.mesher))


ROUGH_JOINTS = structure_stage(
    "rough_joints",
    _solve,
    _needs,
    tabulate_preloads,
    write_body_fields,
    reads={"strict", "structure", "interface", "statics", "cycles", "substructures"},
    takes=(FITTED_LAW,),
    question="How stiff are the joints, where do they slip, and what do they lose in a cycle?",
    check=_check,
)
