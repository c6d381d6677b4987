"""Stage: a body that cracks in bands of elements, by the softening law of its volume."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from multiscale import macro
from multiscale.errors import CaseError
from multiscale.micro.damage.cracks import half_widths, softening_samples
from multiscale.needs import Choice, Needs
from multiscale.pipeline.showing import View
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.loaded_bodies import LOADED_BODIES
from multiscale.pipeline.stages.volumes import GROWING_CRACKS
from multiscale.pipeline.tables.assembly_settings import Bodies
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting.damage_figures import plot_element_field
from multiscale.plotting.figure import on_axes
from multiscale.plotting.rve_figures import plot_cracked_load
from multiscale.schema import CRACK_BAND, CRACKED_BODY, VOLUME_GROWTH, Dataset, with_cautions

EVENT_SECONDS = 2e-6
"""CPU seconds of an element in an event; there are about 20 events of an element that cracks."""

NO_MESH = "intervals do not count the error of the mesh, which is not known: give coarser"

FAILED = "the load has not fallen to zero, so that the energy of the cracks is not known"


def _loaded(bodies: Bodies, case: Case) -> "tuple[macro.Body, np.ndarray]":
    """Build the body, and the nodal forces, N, of the last step of [statics]."""
    built = bodies.build(case, [])
    body = built.assembly.bodies[0]
    factors = built.path.factors()[-1]
    return body, np.sum(
        [f * macro.continuum.load_vector(body, float(k)) for k, f in enumerate(factors)], axis=0
    )


def _run(case: Case, datasets: Datasets, job: Job) -> Dataset:
    """Crack the body by the mean law, by the law of every volume, and on a coarser mesh."""
    assert isinstance(case.structure, Bodies)  # as the case has checked
    bodies = case.structure.with_volumes(case, datasets, job.read_rve)
    body, load = _loaded(bodies, case)
    mean, *laws = softening_samples(datasets[VOLUME_GROWTH.name])
    cracked = []
    job.progress(0, 1 + len(laws), "softening laws")
    for k, law in enumerate((mean, *laws), start=1):
        cracked.append(macro.continuum.follow_crack_band(body, law, load=load))
        job.progress(k, 1 + len(laws), "softening laws")
    for coarser in bodies.coarser().values():
        coarse, coarse_load = _loaded(coarser, case)
        cracked.append(macro.continuum.follow_crack_band(coarse, mean, load=coarse_load))
    values: dict[str, Any] = {name: cracked[0][name].to_numpy() for name in CRACK_BAND.variables}
    for name, variable in (("peak_load", "factor"), ("work", "dissipation")):
        value, *each = (float(path[variable].max()) for path in cracked)
        samples, coarse_value = np.array(each[: len(laws)]), each[len(laws) :]
        values[name], values[f"{name}_sample"] = value, samples
        error = 0.0
        if coarse_value:
            values[f"{name}_mesh"] = error = abs(coarse_value[0] / value - 1.0)
        for kind, half in zip(("mean_law", "one_part"), half_widths(samples), strict=True):
            both = np.hypot(half, error)
            values[f"{name}_{kind}"] = value * np.exp([-both, both])
    values |= {"position": body.basis.doflocs.T, "corners": macro.bodies.element_corners(body)}
    result = CRACKED_BODY.build(values, title=case.title, body=body.name)
    whole = all(int(path["converged"]) for path in cracked)
    return with_cautions(result, "" if coarse_value else NO_MESH, "" if whole else FAILED)


def _prepare(case: Case) -> None:
    """Refuse elements without a band width."""
    assert isinstance(case.structure, Bodies)  # as the case has checked
    body = case.structure.bodies[0]
    mesh = body.load()
    order, kind = body.order_on(mesh), type(mesh).__name__
    if kind not in macro.continuum.SHAPES or order != 1:
        raise CaseError(
            f"[growth] cracks {body.name} in bands of hexahedra of first order, and its mesh is a "
            f"{kind} of order {order}; mesh it by hexahedra, in a geometry of gmsh by "
            f"transfinite, recombined volumes"
        )


def _answer(cracked: Dataset) -> Iterator[str]:
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
    cracked = datasets[CRACKED_BODY.name]
    figures = {
        "cracked_load": on_axes(plot_cracked_load, cracked),
        "crack_field": on_axes(plot_element_field, cracked, "stiffness_share"),
    }
    yield Section("Crack of the body", remarks=[*_answer(cracked)], figures=figures)


def _needs(case: Case) -> Needs:
    assert isinstance(case.structure, Bodies)  # as the case has checked
    n = case.structure.bodies[0].load().t.shape[1]
    laws = 2 + (case.rve.recipe.realisations if case.rve.recipe else 1)
    seconds = laws * 20.0 * n ** (2.0 / 3.0) * n * EVENT_SECONDS
    how = "crack band by events, for the mean law, the law of every volume and a coarser mesh"
    return Needs(seconds=seconds, choices=(Choice("crack of the body", how),))


CRACKED_BODY_STAGE = Stage(
    schema=CRACKED_BODY,
    tables=("structure", "growth"),
    reads={"title", "structure", "statics"},
    takes=(LOADED_BODIES, GROWING_CRACKS),
    run=_run,
    needs=_needs,
    prepare=_prepare,
    question="Under which load does the body crack?",
    answer=_answer,
    sections=_sections,
    answers={"peak_load": "", "work": ""},
    failure=lambda cracked: "" if int(cracked["converged"]) else FAILED,
)
