"""Stage: the bodies of a case slide over each other."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from multiscale.laws.bulk import J2, NeoHookean
from multiscale.micro import FiniteCell, slide_cell
from multiscale.needs import Choice, Needs
from multiscale.pipeline.case_cells import smooth_pair, two_bodies, two_surfaces
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.tables.rough_bodies import RoughBody
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting.figure import on_axes
from multiscale.plotting.lines import plot_lines
from multiscale.schema import SLIDING_RESPONSE, Dataset
from multiscale.surfaces.surface import Surface

TOLERANCE = 1e-6
"""Tolerance of the contact solver, relative to the norm of the contact forces."""


def make_pair(case: Case, surfaces: tuple[Surface, Surface] | None = None) -> FiniteCell:
    """Build the cell of two deformable bodies, of the first realisation if no surfaces are given.

    A body with a hardness is elastoplastic (J2), a body without is neo-Hookean.
    """
    if surfaces is None:
        micro = case.micro.model_copy(update={"realisations": 1})
        (surfaces,) = two_surfaces(case.model_copy(update={"micro": micro}))
    lower, upper = map(_law, case.bodies)
    return two_bodies(case.cell, surfaces, (lower, upper), case.slide.friction_coefficient)


def _run(case: Case, datasets: Datasets, job: Job) -> Dataset:
    slide = case.slide
    response = slide_cell(
        make_pair(case),
        slide.pressures or case.micro.pressures,
        slide.distance,
        steps=slide.steps,
        executor=job.executor,
        tolerance=TOLERANCE,
    )
    ended = str(response.attrs.get("ended", ""))
    caution = f"sliding stopped at {ended}" if ended else ""
    return response.assign_attrs(title=case.title, cautions=caution)


def _law(body: RoughBody) -> NeoHookean | J2:
    if body.yield_stress is None:
        return NeoHookean(body.youngs_modulus, body.poissons_ratio)
    return J2(
        body.youngs_modulus, body.poissons_ratio, body.yield_stress, body.hardening_modulus or 0.0
    )


def _needs(case: Case) -> Needs:
    pair = make_pair(case, smooth_pair(case.cell)).needs()
    slide = Choice(
        "slide", "both bodies, deformable and at large strain, one pressure after the other"
    )
    steps = (case.slide.steps + 1) * len(case.slide.pressures or case.micro.pressures)
    return Needs(choices=(slide,), memory=pair.memory, seconds=pair.seconds * steps)


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    response = datasets[SLIDING.name]
    figures = {
        "sliding": on_axes(plot_lines, response, "effective_friction", by="nominal_pressure"),
        "steady_friction": on_axes(plot_lines, response, "steady_friction"),
    }
    yield Section("Sliding", remarks=describe_sliding(response), figures=figures)


def describe_sliding(response: Dataset) -> list[str]:
    """Report the largest and the steady friction at each pressure."""
    distance = float(response["sliding_distance"][-1])
    lines = []
    for load in range(response.sizes["load"]):
        loaded = response.isel(load=load)
        friction = loaded["effective_friction"].values[1:]
        pressure = 1e-6 * float(loaded["nominal_pressure"])
        if not np.isfinite(friction).any():
            lines.append(f"Under {pressure:.4g} MPa nothing slid.")
            continue
        steady = float(loaded["steady_friction"])
        last = friction[np.isfinite(friction)][-1]
        end = (
            f"{steady:.3g} over the last length of the cell"
            if np.isfinite(steady)
            else f"{last:.3g} at the end"
        )
        lines.append(
            f"Under {pressure:.4g} MPa the friction of the cell over {1e6 * distance:.4g} µm is "
            f"at most "
            f"{np.nanmax(friction):.3g}, and {end}."
        )
    return lines


SLIDING = Stage(
    schema=SLIDING_RESPONSE,
    tables=("slide",),
    reads={
        **dict.fromkeys(("body_1", "body_2", "cell", "slide"), True),
        "micro": {"pressures", "seed"},
    },
    run=_run,
    needs=_needs,
    sections=_sections,
    answers={"nominal_pressure": "", "steady_friction": ""},
)
