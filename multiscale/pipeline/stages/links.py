"""Stage: a structure of bars and cables, at rest or in motion, whole or cut."""

from collections.abc import Iterator
from math import ceil
from typing import Any

import numpy as np

from multiscale import macro
from multiscale.errors import ConvergenceError
from multiscale.io import write_link_fields
from multiscale.macro import substructures
from multiscale.macro.discrete.link_needs import link_needs
from multiscale.macro.substructures.substructure_needs import cut_needs
from multiscale.needs import Needs
from multiscale.pipeline.link_settings import Dynamics, LinkStructure, Statics
from multiscale.pipeline.rows import tabulate_links
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, StageAnswer
from multiscale.pipeline.structure_stage import structure_stage, with_too_far
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = ["LINKS"]

FURTHEST = 0.05
"""Displacement of the ends of a link against each other, over its length, that counts as small."""

STRAINED = 0.1
"""Strain of a link that carries above which its law, linear elastic, is beyond what cables do."""


def _solve(links: LinkStructure, case: Case, found: Datasets, job: Job) -> Dataset:
    """Solve a structure of links; the result follows ``MACRO_RESULT``."""
    system, statics = links.build(), case.statics
    if statics is None:
        assert case.dynamics is not None  # the case has been validated
        return with_too_far(_move(links, case, case.dynamics, found, job))
    if case.substructures is not None:
        problem, factors = links.cut(case, found, job), np.array(statics.load_factors)
        solved = macro.solve_latin(
            problem, factors, coarse=case.cut.coarse, **case.cut.stop(job.team)
        )
        result = _with_links(solved, system)
    else:
        result = macro.solve_static(
            system, statics.load_factors, exact=statics.exact, stability=statics.stability
        )
    return with_too_far(result, *_strained(result, statics))


def _strained(result: Dataset, statics: Statics) -> Iterator[str]:
    first, second = result["ends"].values.T
    apart = np.diff(result["position"].values[result["ends"].values], axis=1)[:, 0]
    u = np.nan_to_num(result["displacement"].values)[:, :, :3]
    moved_apart, length = u[:, second] - u[:, first], np.linalg.norm(apart, axis=1)
    turned = np.linalg.norm(moved_apart, axis=2) / length
    strain = np.abs(np.linalg.norm(apart + moved_apart, axis=2) / length - 1.0)
    strain = np.where(result["slack"].values > 0.0, 0.0, strain)
    if statics.exact and strain.max() > STRAINED:
        link = int(np.argmax(strain.max(axis=0)))
        yield (
            f"link {link} changes its length by up to {strain.max():.2g} of it, and more than "
            f"{STRAINED:g} is outside the linear law of its material: check loads, rigidities "
            f"and their units"
        )
    if not statics.exact and turned.max() > FURTHEST:
        yield (
            f"the ends of a link move against each other by up to {turned.max():.2g} of its "
            f"length, and small displacements err by about as much: set exact to true in "
            f"[statics]"
        )


def _move(
    links: LinkStructure, case: Case, settings: Dynamics, found: Datasets, job: Job
) -> Dataset:
    """Find the equilibrium at the start, and follow the motion from it."""
    steps = int(np.ceil(settings.duration / settings.step * (1.0 - 1e-12)))
    times, factor = np.linspace(0.0, settings.duration, steps + 1), settings.start_load_factor
    system, history = links.build(), np.array(settings.load_history)

    def load_factor(time: float) -> float:
        return float(np.interp(time, *history.T))

    if case.substructures is None:
        start = _at_rest(macro.solve_static(system, factor))
        options: dict[str, Any] = {"theta": settings.theta, "restitution": settings.restitution}
        return macro.simulate(
            system, times, settings.mass, load_factor=load_factor, start=start, **options
        )
    problem, stop = links.cut(case, found, job), case.cut.stop(job.team)
    start = _at_rest(
        macro.solve_latin(problem, factor, coarse=case.cut.coarse, **stop).isel(step=0)
    )
    result = substructures.simulate_latin(
        problem, times, settings.mass, load_factor=load_factor, start=start, **stop
    )
    return _with_links(result, system)


def _compared(result: Dataset) -> Dataset:
    """Return how many links are slack, and the largest tension."""
    tension, slack = result["tension"], (result["slack"] > 0.0).where(result["converged"] == 1)
    counted = slack.sum("link", min_count=1).assign_attrs(units="1", long_name="slack links")
    largest = tension.max("link").assign_attrs(tension.attrs, long_name="largest tension")
    return result.assign(slack_links=counted, largest_tension=largest)


def _at_rest(begin: Dataset) -> tuple[np.ndarray, np.ndarray]:
    if not int(begin["converged"]):
        raise ConvergenceError(f"no equilibrium to start from: {begin.attrs['failure']}")
    displacement = begin["displacement"].values
    return displacement, np.zeros_like(displacement)


def _with_links(result: Dataset, system: "macro.LinkSystem") -> Dataset:
    return MACRO_RESULT.assign(result, macro.discrete.describe(system)).assign_coords(end=range(2))


def _needs(links: LinkStructure, case: Case) -> Needs:
    system, statics, motion = links.build(), case.statics, case.dynamics
    if case.substructures is not None:
        return cut_needs(
            int((~system.fixed).sum()),
            links=system.n_links,
            substructures=case.cut.count,
            coarse=case.cut.coarse,
            moving=motion is not None,
        )
    if motion is not None:
        return link_needs(system, moving=True, steps=1 + ceil(motion.duration / motion.step))
    return link_needs(
        system, exact=statics.exact, stability=statics.stability, steps=len(statics.load_factors)
    )


LINKS = structure_stage(
    "links",
    _solve,
    _needs,
    tabulate_links,
    write_link_fields,
    reads={"structure", "statics", "dynamics", "substructures"},
    question="Which tensions do the links carry, and which of them are slack?",
    answers=(
        StageAnswer("slack_links", "slack links", "1"),
        StageAnswer("largest_tension", "largest tension", "kN", 1e-3),
    ),
    compared=_compared,
)
