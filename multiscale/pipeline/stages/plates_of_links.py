"""Stage: a structure of links as a plate, compared with its links."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from multiscale import macro
from multiscale.io.fields import write_link_fields
from multiscale.needs import Choice, Needs
from multiscale.pipeline.showing import Table, View
from multiscale.pipeline.stage import Datasets, Job, Section
from multiscale.pipeline.stages.cut_structures import FIRST_FREQUENCY, strained, unstable
from multiscale.pipeline.structure_stage import structure_stage, with_too_far
from multiscale.pipeline.tables import link_settings
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting.figure import on_axes
from multiscale.plotting.lines import plot_lines
from multiscale.schema import Dataset

ROUNDING = 1e-12  # share of the stiffness of two strains below which their coupling is rounding

ELEMENT_MEMORY, ELEMENT_TIME = 310_000, 4.5e-3
"""Peak memory and time at a load factor of an element, byte and s; measured with 1024 elements."""

MOVES = (
    "At the load factor {load_factor} the plate moves by up to {largest_displacement}, and "
    "{slack_links} of {links} links are slack by its cells."
)
RESOLVED = (
    "The links move by up to {links_displacement}; the difference between plate and nodes "
    "is {plate_error} of the displacements."
)
VIBRATES = "The first frequency of the links is {links_frequency}."


def _solve(
    plate: link_settings.EquivalentPlate, case: Case, datasets: Datasets, job: Job
) -> Dataset:
    """Solve the plate and, if asked, its links at the same loads."""
    built, factors, mass = plate.build(), case.statics.load_factors, case.statics.mass
    result, cautions = macro.links.solve_plate(built, factors, mass=mass), list[str]()
    if plate.resolve:
        links = macro.solve_static(built.system, factors)
        cautions += strained(links, built.system, case.statics)
        if mass is not None:
            links = macro.links.natural_frequencies(built.system, links, mass)
        result = macro.links.compare_with_links(result, links)
    return with_too_far(result, *cautions, *unstable(result))


def _answer(result: Dataset) -> Iterator[str]:
    known = np.flatnonzero(result["converged"].to_numpy() == 1)
    sentences = (MOVES, RESOLVED, FIRST_FREQUENCY, VIBRATES)
    for last in (result.isel(step=k) for k in known[-1:]):
        yield from View(result).sentences(last, *sentences, links=result.sizes["link"])


def _sections(result: Dataset) -> Iterator[Section]:
    names = ("largest_displacement", "links_displacement")[: 1 + ("links_displacement" in result)]
    drawn = on_axes(partial(plot_lines, over="load_factor"), result, *names)
    strains = [str(strain) for strain in result["strain"].values]
    stiffness = result["plate_stiffness"].to_numpy()
    scale = np.sqrt(stiffness.diagonal())
    stiffness = np.where(np.abs(stiffness) > ROUNDING * np.outer(scale, scale), stiffness, 0.0)
    rows = [
        (strain, *(f"{value:.4g}" for value in row))
        for strain, row in zip(strains, stiffness, strict=True)
    ]
    caption = [
        "Resultants by unit strains of the taut plate, about the plane z = 0: N/m for extensions "
        "and transverse shears, N m for curvatures, and N between them."
    ]
    yield Section(
        "Stiffness of the plate",
        caption,
        ("by", *strains),
        rows,
        figures={"displacements": drawn},
        printed=False,
    )


def _needs(plate: link_settings.EquivalentPlate, case: Case) -> Needs:
    from multiscale.macro.links.link_system import link_needs

    elements, steps = int(np.prod(plate.divisions)), len(case.statics.load_factors)
    links = link_needs(plate.links.build(), steps=steps)
    resolved = Choice(
        "links", "solved at the same loads, for the error of the plate", plate.resolve
    )
    moved = Choice("moved positions", "lengths and directions of displaced links", built=False)
    return Needs(
        memory=max(ELEMENT_MEMORY * elements, links.memory),
        seconds=ELEMENT_TIME * elements * steps + plate.resolve * links.seconds,
        choices=(resolved, moved),
    )


EQUIVALENT_PLATE = structure_stage(
    "equivalent_plate",
    _solve,
    _needs,
    Table(
        (
            *("load_factor", "slack_links", "largest_displacement", "links_displacement"),
            *("plate_error", "first_frequency", "links_frequency", "iterations", "residual"),
        ),
        answer="largest_displacement",
    ),
    write_link_fields,
    reads={"structure", "statics"},
    question="How much does a plate with the mean stiffness of links differ from the links?",
    answers=("largest_displacement", "slack_links", "plate_error", "first_frequency"),
    more=_sections,
    answer=_answer,
)
