"""Stage: a body that cracks under a load by the softening law of its volumes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from multiscale import macro, schema
from multiscale.errors import CaseError
from multiscale.micro.damage.cracks import half_widths, softening_samples
from multiscale.needs import Choice, Needs
from multiscale.pipeline.showing import View
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.loaded_bodies import LOADED_BODIES
from multiscale.pipeline.stages.volumes import GROWING_CRACKS
from multiscale.pipeline.structure_stage import structure_of
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.solved_bodies import SolvedBodies
from multiscale.plotting import plot_element_field
from multiscale.plotting.figure import on_axes
from multiscale.plotting.rve_figures import plot_cracked_load
from multiscale.upscaling.propagation import STRETCH

EVENT_SECONDS = 2e-6  # CPU seconds of an element in an event; about 20 events crack it

NO_MESH = (
    "intervals do not contain the error of the mesh, which is unknown: give the "
    "body a coarser mesh by coarser"
)

FAILED = "the load has not fallen to zero, so the energy of the cracks is unknown"


def _loaded(bodies: SolvedBodies, case: Case) -> "tuple[macro.Body, np.ndarray]":
    """Build the body, and the nodal forces, N, of the last step of [statics]."""
    built = bodies.build(case, [])
    body = built.assembly.bodies[0]
    factors = built.path.factors()[-1]
    return body, np.sum(
        [f * macro.continuum.load_vector(body, float(k)) for k, f in enumerate(factors)], axis=0
    )


def _crack(case: Case, datasets: Datasets, job: Job) -> schema.Dataset:
    """Crack the body by the mean law, by the law of every volume, and on a coarser mesh."""
    bodies: SolvedBodies = structure_of(case).with_volumes(case, datasets, job.read_rve)
    body, load = _loaded(bodies, case)
    mean, *laws = softening_samples(datasets[schema.VOLUME_GROWTH.name])
    cracked = []
    job.progress(0, 1 + len(laws), "softening laws")
    for k, law in enumerate((mean, *laws), start=1):
        cracked.append(macro.continuum.follow_crack_band(body, law, load=load))
        job.progress(k, 1 + len(laws), "softening laws")
    halves = list[float]()
    for _, half, stretched in bodies.uncertain(1.0 + STRETCH):
        halves.append(half)
        other, other_load = _loaded(stretched, case)
        cracked.append(macro.continuum.follow_crack_band(other, mean, load=other_load))
    for coarser in bodies.coarser().values():
        coarse, coarse_load = _loaded(coarser, case)
        cracked.append(macro.continuum.follow_crack_band(coarse, mean, load=coarse_load))
    values: dict[str, Any] = {
        name: cracked[0][name].to_numpy() for name in schema.CRACK_BAND.variables
    }
    for name, variable in (("peak_load", "factor"), ("work", "dissipation")):
        value, *each = (float(path[variable].max()) for path in cracked)
        samples, rest = np.array(each[: len(laws)]), each[len(laws) :]
        stated, coarse_value = np.array(rest[: len(halves)]), rest[len(halves) :]
        values[name], values[f"{name}_sample"] = value, samples
        # errors by stated values and by the mesh
        error = float(np.linalg.norm(np.array(halves) * (stated / value - 1.0) / STRETCH))
        if coarse_value:
            values[f"{name}_mesh"] = mesh = abs(coarse_value[0] / value - 1.0)
            error = float(np.hypot(error, mesh))
        for kind, half in zip(("mean_law", "one_part"), half_widths(samples), strict=True):
            both = np.hypot(half, error)
            values[f"{name}_{kind}"] = value * np.exp([-both, both])
    values |= {"position": body.basis.doflocs.T, "corners": macro.bodies.element_corners(body)}
    result = schema.CRACKED_BODY.build(values, title=case.title, body=body.name)
    whole = all(int(path["converged"]) for path in cracked)
    return schema.with_cautions(result, "" if coarse_value else NO_MESH, "" if whole else FAILED)


def _prepare(case: Case) -> None:
    body = structure_of(case).bodies[0]
    mesh = body.load()
    order, kind = body.order_on(mesh), type(mesh).__name__
    if kind not in macro.continuum.SHAPES or order != 1:
        raise CaseError(
            f"[growth] cracks {body.name} in bands of hexahedra of first order, and its mesh is a "
            f"{kind} of order {order}; mesh it by hexahedra, in a geometry of gmsh by "
            f"transfinite, recombined volumes"
        )


def _report(cracked: schema.Dataset) -> Iterator[str]:
    count = int(np.count_nonzero(cracked["stiffness_share"].to_numpy() < 1.0))
    yield from View(cracked).sentences(
        cracked,
        "{body} fails at {peak_load:()} times the loads of [statics]; {count} elements "
        "crack, with a fracture work of {work:()}.",
        count=count,
    )
    if "work_mesh" in cracked:
        load, work = (100.0 * float(cracked[f"{name}_mesh"]) for name in ("peak_load", "work"))
        yield f"On the coarser mesh the load changes by {load:.2g} %, the energy by {work:.2g} %."


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    cracked = datasets[schema.CRACKED_BODY.name]
    figures = {
        "cracked_load": on_axes(plot_cracked_load, cracked),
        "crack_field": on_axes(plot_element_field, cracked, "stiffness_share"),
    }
    yield Section("Crack of the body", remarks=[*_report(cracked)], figures=figures)


def _needs(case: Case) -> Needs:
    n = structure_of(case).bodies[0].load().t.shape[1]
    laws = 2 + (case.rve.recipe.realisations if case.rve.recipe else 1)
    seconds = laws * 20.0 * n ** (2.0 / 3.0) * n * EVENT_SECONDS
    how = "crack band by events, for the mean law, the law of every volume and a coarser mesh"
    return Needs(seconds=seconds, choices=(Choice("crack of the body", how),))


CRACKING_BODY = Stage(
    schema=schema.CRACKED_BODY,
    tables=("structure", "growth"),
    reads={"title", "structure", "statics"},
    takes=(LOADED_BODIES, GROWING_CRACKS),
    run=_crack,
    needs=_needs,
    prepare=_prepare,
    question="Under which load does the body crack?",
    answer=_report,
    sections=_sections,
    answers=("peak_load", "work"),
    failure=lambda cracked: "" if int(cracked["converged"]) else FAILED,
)
