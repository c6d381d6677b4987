"""Stage: elastic bodies of the user under named loads."""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.io import write_body_fields
from multiscale.macro.substructures import add_body_fields, follow_loads
from multiscale.macro.substructures.substructure_needs import cut_needs
from multiscale.needs import Needs
from multiscale.pipeline.assembly_settings import Bodies
from multiscale.pipeline.joint_settings import SLABS
from multiscale.pipeline.rows import tabulate_path
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, Section, list_cautions
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.structure_stage import require_converged, structure_stage, with_too_far
from multiscale.plotting import MOST_DRAWN, load_pictures
from multiscale.plotting.figure import on_axes
from multiscale.schema import with_cautions

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["LOADED_BODIES"]

PICTURES = (
    "loads",
    "bolts",
    *(f"{name}_{k}" for k in range(MOST_DRAWN) for name in ("contact_zones", "pressure")),
)
"""Names of all figures of loaded bodies."""


def _solve(bodies: Bodies, case: Case, found: Datasets, job: Job) -> "xr.Dataset":
    """Follow the path over the named loads."""
    laws = bodies.read_laws(case, found, job.read_law)
    parts = bodies.build(case, bodies.sliders(case, laws))
    method = case.cut.method(job.team)
    result = follow_loads(parts.assembly, parts.path, method=method, extrapolate=case.extrapolate)
    # cautions of cells of its own stand beside those of the structure
    told = list_cautions(found[FITTED_LAW.name]) if case.has_cells else []
    for number, law in enumerate(laws):
        further = [] if law is None else [one for one in list_cautions(law) if one not in told]
        told += further
        result = with_cautions(result, *(f"the law of interface {number}: {x}" for x in further))
    result = with_cautions(result, *bodies.assumed(case))
    facts = [*parts.facts, *_secants(result), *_energies(result), *_bolts(result)]
    result = result.assign_attrs(facts="\n".join(facts))
    damages = [body.damage for body in bodies.bodies]
    return with_too_far(add_body_fields(result, parts.assembly.bodies, damage=damages))


def _secants(result: "xr.Dataset") -> Iterator[str]:
    """Say how stiff the structure is under each load, for small changes, at the end of the path."""
    for load in result["load"].values:
        one = result.sel(load=load)
        known = np.flatnonzero(np.isfinite(one["load_stiffness"].to_numpy()))
        if known.size:
            at = one.isel(step=known[-1])
            yield (
                f"Against a small change of {load} at step {int(at['path_step'])} the structure "
                f"has {1e-6 * float(at['load_stiffness']):.4g} N/µm, of whose compliance "
                f"{100.0 * float(at['interface_compliance']):.3g} % is of the interfaces."
            )


def _energies(result: "xr.Dataset") -> Iterator[str]:
    """Say what each interface loses in the last cycle."""
    if "interface_energy" in result:
        for number, lost in enumerate(result["interface_energy"].values[-1]):
            yield f"Interface {number} loses {lost:.4g} J in the last cycle."


def _bolts(result: "xr.Dataset") -> Iterator[str]:
    """Say of each bolt what it carries where it is tightened last, and in the steps after that."""
    if "bolt_force" not in result:
        return
    force = 1e-3 * result["bolt_force"].to_numpy()
    preload = result["factor"].to_numpy()[:, 0]
    locked = int(np.flatnonzero(np.diff(preload, prepend=0.0))[-1])
    for bolt, (tightened, *rest) in enumerate(force[locked:].T):
        known = np.array(rest)[np.isfinite(rest)]
        changes = f", then carries {known.min():.4g} to {known.max():.4g} kN" if known.size else ""
        yield f"Bolt {bolt} is tightened to {tightened:.4g} kN{changes}."


def _check(result: "xr.Dataset") -> None:
    """Refuse bodies that are nowhere known."""
    require_converged(result)
    if np.isnan(result["load_displacement"].values).all():
        raise ConvergenceError(
            f"{result.attrs['title']}: the answer is unknown at every step; "
            f"{result.attrs['cautions']}"
        )


def _needs(bodies: Bodies, case: Case) -> Needs:
    meshes = [body.load() for body in bodies.bodies]
    nodes = sum(mesh.p.shape[1] for mesh in meshes)
    points = 0
    for number, joint in enumerate(bodies.interfaces):
        body, face = bodies.place(meshes, f"interface {number}", joint.sides[1])
        points += np.unique(meshes[body].facets[:, meshes[body].boundaries[face]]).size
    needs = cut_needs(
        3 * nodes,
        joint_points=points,
        substructures=len(meshes) * case.cut.count,
        coarse=case.cut.coarse,
        slabs=SLABS if points else 0,
    )
    return replace(needs, libraries=tuple(sorted({*needs.libraries, "meshio"})))


def _sections(result: "xr.Dataset") -> Iterator[Section]:
    """Show loads, bolts and interfaces."""
    told = [
        "Zones, pressure and outlines of the parts are seen along the normal of each interface, at "
        "the last step that has an answer."
    ]
    figures = {name: on_axes(plot) for name, plot in load_pictures(result).items()}
    yield Section("Loads and interfaces", told, figures=figures)


LOADED_BODIES = structure_stage(
    "loaded_bodies",
    _solve,
    _needs,
    tabulate_path,
    write_body_fields,
    reads={"strict", "structure", "interface", "statics", "cycles", "substructures"},
    takes=(FITTED_LAW,),
    question="How do the bodies move under their loads, and what do their interfaces and bolts do?",
    prepare=lambda bodies, case: bodies.try_to_build(case),
    check=_check,
    kept="--quick keeps the meshes of the bodies, which it cannot make coarser",
    more=_sections,
    pictures=PICTURES,
)
