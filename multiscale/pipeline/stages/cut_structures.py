"""Stages: bars and cables, whole or cut, and condensed substructures."""

from collections.abc import Callable, Iterator
from functools import partial
from math import ceil
from typing import Any

import numpy as np

from multiscale import macro
from multiscale.errors import ConvergenceError
from multiscale.io.fields import write_link_fields
from multiscale.macro import substructures
from multiscale.needs import Needs
from multiscale.pipeline.showing import Table, View
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.loaded_bodies import LOADED_BODIES
from multiscale.pipeline.structure_stage import structure_of, structure_stage, with_too_far
from multiscale.pipeline.tables.link_settings import Dynamics, LinkStructure, Statics
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting.figure import in_space, on_axes
from multiscale.plotting.link_figures import (
    ENERGIES,
    plot_deformed_links,
    plot_energies,
    plot_past_limit,
    plot_sorted_tensions,
)
from multiscale.schema import HOMOGENISED, MACRO_RESULT, SHOWN, Dataset

FURTHEST = 0.05
"""Displacement of the ends of a link, over its length, and work of the tensions of links that turn,
over the work of the load, up to which displacements are small."""

OF_MOTION = "How do the links move, which tensions do they carry, and how does the energy change?"
"""Question of a motion."""

OF_PATH = "At which load do the links snap through or buckle, and where do they rest?"
"""Question of a path past limit points."""

BY_MODULES = (
    "Substructures follow the law of their modules with slack links: by a specimen of fewer "
    "modules the largest displacement is accurate to {largest_displacement_error}, the largest "
    "tension within {largest_tension_error}, and the number of slack links within "
    "{slack_links_error}."
)
FIRST_FREQUENCY = "The first frequency of small vibration is {first_frequency}."

LEAST_SHARE = 1e-3  # share of the energy below which a kind of energy is not reported
MODE = 0.1  # largest displacement of a mode that is drawn, over the size of the structure
STRAINED = 0.1  # strain of a taut link above which its linear elastic law does not hold


def _solve(links: LinkStructure, case: Case, datasets: Datasets, job: Job) -> Dataset:
    """Solve a structure of links; the result follows ``MACRO_RESULT``."""
    system, statics = links.build(), case.statics
    if statics is None:
        assert case.dynamics is not None  # the case has been validated
        moved = _measured(_move(links, case, case.dynamics, datasets, job))
        return with_too_far(moved.assign_attrs(question=OF_MOTION))
    if case.substructures is not None:
        plates = links.modules(case.cut.parts) if case.cut.model != "resolved" else ()
        solve_parts = partial(_cut_at_rest, links, case, statics, system, datasets, job)
        result = _by_modules(plates, case, statics, system, solve_parts)
    elif statics.past_limit:
        path = macro.solve_past_limit(system, statics.load_factors[0])
        return with_too_far(
            _measured(path.assign_attrs(question=OF_PATH)),
            *strained(path, system, statics),
            *_indefinite(path),
        )
    else:
        result = macro.solve_static(
            system, statics.load_factors, exact=statics.exact, stability=statics.stability
        )
        if statics.mass is not None:
            result = macro.links.natural_frequencies(system, result, statics.mass)
    counted = system.prestress if case.substructures is not None and links.prestressed else None
    cautions = strained(result, system, statics, counted)
    return with_too_far(_measured(result), *cautions, *unstable(result))


def unstable(result: Dataset) -> Iterator[str]:
    """Caution on steps at rest without frequencies."""
    if "first_frequency" in result:
        solved = result["converged"].to_numpy() == 1
        factor = result["load_factor"].to_numpy()[solved & np.isnan(result["first_frequency"])]
        if factor.size:
            yield (
                f"at the load factor {factor[0]:g} the tangent is not positive definite, and the "
                f"structure has no small vibration: it buckles, or slack links leave a mechanism"
            )


def strained(
    result: Dataset,
    system: "macro.LinkSystem",
    statics: Statics,
    counted: np.ndarray | None = None,
) -> Iterator[str]:
    """Caution on links that stretch, or turn under tension, by more than their theory allows."""
    first, second = system.ends.T
    apart = np.diff(system.position[system.ends], axis=1)[:, 0]
    moved = [result[name].values for name in ("displacement", "rotation") if name in result]
    u = np.nan_to_num(np.concatenate(moved, axis=2))
    moved_apart, length = (u[:, second] - u[:, first])[:, :, :3], np.linalg.norm(apart, axis=1)
    strain = np.abs(np.linalg.norm(apart + moved_apart, axis=2) / length - 1.0)
    strain = np.where(result["slack"].values > 0.0, 0.0, strain)
    if statics.exact and strain.max() > STRAINED:
        link = int(np.argmax(strain.max(axis=0)))
        yield (
            f"link {link} has a strain of up to {strain.max():.2g}, and the linear law of its "
            f"material is not valid above {STRAINED:g}: check loads, rigidities and their units"
        )
    if statics.exact:
        return
    # work of the tensions by the rotation of their links, over the work of the load
    turned = np.linalg.norm(moved_apart, axis=2) / length
    across = np.sum(moved_apart**2, axis=2) - np.sum(moved_apart * apart / length[:, None], 2) ** 2
    tension = np.nan_to_num(result["tension"].values) - (0.0 if counted is None else counted)
    left_out = np.abs(np.sum(tension / length * across, axis=1))
    work = np.abs(result["load_factor"].values * np.sum(system.load * u, axis=(1, 2)))
    share = np.divide(left_out, work, out=np.zeros_like(work), where=work > 0.0)
    if max(turned.max(), share.max()) > FURTHEST:
        yield (
            f"the ends of a link move relative to each other by up to {turned.max():.2g} of its "
            f"length, and the work of tensions by rotation of links is {100.0 * share.max():.2g} % "
            f"of the work of the load; the theory of small displacements neglects both, and the "
            f"larger share is about the error of the answers: set exact to true in [statics] if "
            f"the links are bars and cables without a cut, or reduce the loads"
        )


def _indefinite(path: Dataset) -> Iterator[str]:
    """Caution on the unstable part of a path."""
    if "critical_factor" in path:
        factor, kind = float(path["critical_factor"]), path.attrs["critical"]
        yield (
            f"the tangent is indefinite beyond the {kind} at the load factor {factor:.6g}: states "
            f"with a negative eigenvalue are in equilibrium but not stable, and under a dead load "
            f"the links leave them suddenly"
        )


def _move(
    links: LinkStructure, case: Case, settings: Dynamics, datasets: Datasets, job: Job
) -> Dataset:
    """Solve the equilibrium at the start, and follow the motion from it."""
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
    stop = case.cut.stop(job.team)

    def move(method: "substructures.Method", problem: "substructures.CutProblem") -> Dataset:
        start = _at_rest(method.solve(problem, factor).isel(step=0))
        return substructures.simulate_latin(
            problem, times, settings.mass, load_factor=load_factor, start=start, **stop
        )

    return _solve_cut(links.cut(case, datasets, job), case, job, move, system)


def _by_modules(
    plates: "tuple[macro.links.EquivalentPlate, ...]",
    case: Case,
    statics: Statics,
    system: "macro.LinkSystem",
    solve_parts: Callable[[], Dataset],
) -> Dataset:
    """Solve substructures, or where links slacken their modules, or links without a cut."""
    if not plates:
        return solve_parts()
    count, factors, residual = case.cut.count, statics.load_factors, macro.links.RESIDUAL
    result = macro.links.solve_plate(plates[0], factors, links=True, tolerance=residual)
    slack = (result["slack"].to_numpy() > 0.0).any(axis=0)
    if case.cut.model == "homogenised":
        # single links may slacken in a step in which the law has none
        if not slack.any() and (taut := solve_parts())["converged"].to_numpy().all():
            return taut
        return macro.links.with_specimen_error(result, *plates)
    # adaptive: most substructures would be resolved
    owner = substructures.split_grid(system, case.cut.parts)
    if np.unique(owner[slack]).size <= substructures.MOST_SLACK * count:
        return solve_parts()
    counts = {"unknowns": int((~system.fixed).sum()), "substructures": count, "resolved": count}
    return macro.solve_static(system, factors).assign_attrs(counts)


def _cut_at_rest(
    links: LinkStructure,
    case: Case,
    statics: Statics,
    system: "macro.LinkSystem",
    datasets: Datasets,
    job: Job,
) -> Dataset:
    problem, factors = links.cut(case, datasets, job), np.array(statics.load_factors)
    # links that are all resolved need no cut, unless prestress is a part of their stiffness
    uncut = case.cut.model == "adaptive" and not links.prestressed

    def rest(method: "substructures.Method", part: "substructures.CutProblem") -> Dataset:
        if uncut and part is problem:
            return macro.solve_static(system, statics.load_factors)
        return method.solve(part, factors)

    return _solve_cut(problem, case, job, rest, system)


def _solve_cut(
    problem: "substructures.CutProblem",
    case: Case,
    job: Job,
    solve: Callable[["substructures.Method", "substructures.CutProblem"], Dataset],
    system: "macro.LinkSystem",
) -> Dataset:
    """Solve substructures by a path or a motion: resolved, or by their homogenised stiffness."""
    cut = case.cut
    if cut.model == "resolved":
        return _with_links(solve(cut.method(job.team), problem), system)
    newton = macro.NewtonSchur(tolerance=cut.tolerance, max_iterations=cut.max_iterations)
    result = substructures.solve_homogenised(
        problem, lambda coarse: solve(newton, coarse), adaptive=cut.model == "adaptive"
    )
    return _with_links(result, system)


def _measured(result: Dataset) -> Dataset:
    """Return the result with the number of slack links and the largest tension and displacement."""
    solved = result["converged"].to_numpy() == 1
    slack = (result["slack"].to_numpy() > 0.0).sum(axis=1)
    moved = np.linalg.norm(result["displacement"].to_numpy()[..., :3], axis=2).max(axis=1)
    values = {
        "slack_links": slack,
        "largest_tension": result["tension"].to_numpy().max(axis=1),
        "largest_displacement": moved,
    }
    known = {name: np.where(solved, value, np.nan) for name, value in values.items()}
    return MACRO_RESULT.assign(result, known)


def _answer(result: Dataset) -> Iterator[str]:
    known = np.flatnonzero(result["converged"].to_numpy() == 1)
    if not known.size or "largest_tension" not in result:
        return
    yield from (_of_motion if "time" in result.coords else _of_loads)(result.isel(step=known))
    if "resolved" in result.attrs:
        yield (
            f"{result.attrs['resolved']} of {result.attrs['substructures']} substructures are "
            f"resolved, as links slacken in them; the others are homogenised, with "
            f"{result.attrs['unknowns']} unknowns in all."
        )


def _of_loads(result: Dataset) -> Iterator[str]:
    """Report the answers at the last load factor, and where links begin to go slack."""
    if "critical_factor" in result:
        node = int(np.argmax(np.linalg.norm(result["critical_mode"].to_numpy(), axis=1)))
        snaps = "snap through" if result.attrs["critical"] == "limit point" else "buckle"
        yield (
            f"The links {snaps} at the load factor {float(result['critical_factor']):.4g}, where "
            f"node {node} moves most."
        )
    slack, factor = result["slack_links"].to_numpy(), result["load_factor"].to_numpy()
    yield from _fill_in(
        result,
        -1,
        "At the load factor {load_factor} the largest tension is {largest_tension}, in link "
        "{link}; {slack_links} of {links} links are slack, and the nodes move by up to "
        "{largest_displacement}.",
    )
    yield from View(result).sentences(result.isel(step=-1), BY_MODULES, FIRST_FREQUENCY)
    first = int(np.argmax(slack > 0.0))
    if slack[first] > 0.0 and first > 0:
        yield (
            f"The first links go slack between the load factors {factor[first - 1]:.4g} and "
            f"{factor[first]:.4g}."
        )


def _of_motion(result: Dataset) -> Iterator[str]:
    """Report the largest answers of a motion, and where its energy is at the end."""
    swing, view = result["largest_displacement"].to_numpy(), View(result)
    low, high = (
        view.phrase(result.isel(step=int(k)), "largest_displacement")
        for k in (np.argmin(swing), np.argmax(swing))
    )
    yield from _fill_in(
        result,
        int(np.argmax(result["largest_tension"].to_numpy())),
        "The largest tension is {largest_tension}, in link {link}, at {time}; at most {most} of "
        "{links} links are slack. The largest displacement of a node is between {low} and {high}.",
        most=int(result["slack_links"].max()),
        low=low,
        high=high,
    )
    end = result.isel(step=-1)
    energies = {SHOWN[name].label: float(end[name]) for name in ENERGIES if name in end}
    total = sum(energies.values())
    shares = [
        f"{100.0 * energy / total:.3g} % is {label}"
        for label, energy in energies.items()
        if energy > LEAST_SHARE * total
    ]
    if shares:
        yield f"The energy at the end is {total:.4g} J: {' and '.join(shares)}."


def _fill_in(result: Dataset, step: int, sentence: str, **others: object) -> Iterator[str]:
    at = result.isel(step=step)
    link, count = int(np.argmax(at["tension"].to_numpy())), result.sizes["link"]
    yield from View(result).sentences(at, sentence, link=link, links=count, **others)


def _sections(result: Dataset) -> Iterator[Section]:
    figures = {}
    if "time" in result.coords:
        figures["energies"] = on_axes(plot_energies, result)
    elif (result["law"] == "cable").any():
        figures["sorted_tensions"] = on_axes(plot_sorted_tensions, result)
    if "critical_factor" in result:
        figures["load_factor"] = on_axes(plot_past_limit, result)
        # the mode, with its largest component as long as a tenth of the structure
        size = MODE * float(np.ptp(result["position"].to_numpy(), axis=0).max())
        factor = result["load_factor"].to_numpy()
        at = int(np.argmin(np.abs(factor - float(result["critical_factor"]))))
        moved = result["critical_mode"].expand_dims(step=1)
        mode = result.isel(step=[at]).assign(displacement=moved)
        figures["critical_mode"] = in_space(plot_deformed_links, mode, scale=size, size=(7.5, 5.5))
    known = np.flatnonzero(result["converged"].to_numpy() == 1)
    if known.size:
        figures["deformed_links"] = in_space(
            plot_deformed_links, result, step=int(known[-1]), size=(7.5, 5.5)
        )
    yield Section("Links", figures=figures)


def _at_rest(begin: Dataset) -> tuple[np.ndarray, np.ndarray]:
    if not int(begin["converged"]):
        raise ConvergenceError(f"no equilibrium to start from: {begin.attrs['failure']}")
    displacement = begin["displacement"].values
    return displacement, np.zeros_like(displacement)


def _with_links(result: Dataset, system: "macro.LinkSystem") -> Dataset:
    return MACRO_RESULT.assign(result, macro.links.describe(system)).assign_coords(end=range(2))


def _needs(links: LinkStructure, case: Case) -> Needs:
    from multiscale.macro.links.link_system import link_needs

    system, statics, motion = links.build(), case.statics, case.dynamics
    if case.substructures is not None:
        return substructures.cut_needs(
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


TABLE = Table(
    (
        *("time", "load_factor", "stability_eigenvalue", "first_frequency", "slack_links"),
        *("slack_links_error", "largest_tension", "largest_tension_error", "residual"),
    ),
    {"slack_links_error": "±", "largest_tension_error": "±"},
    answer="largest_tension",
    most=11,
)

LINKS = structure_stage(
    "links",
    _solve,
    _needs,
    TABLE,
    write_link_fields,
    reads={"structure", "statics", "dynamics", "substructures"},
    question="Which tensions do the links carry, and which links are slack?",
    answers=("slack_links", "largest_displacement", "largest_tension"),
    more=_sections,
    answer=_answer,
)


def _condense(case: Case, datasets: Datasets, job: Job) -> Dataset:
    result = datasets[MACRO_RESULT.name]
    solved = np.isfinite(result["displacement"].values).all(axis=(1, 2))
    step = int(np.flatnonzero(solved)[-1])
    cut = structure_of(case).cut(case, datasets, job)
    return macro.homogenise(cut, result, step=step).assign_attrs(title=case.title)


CONDENSED_PARTS = Stage(
    schema=HOMOGENISED,
    tables=("structure", "homogenise"),
    reads={"substructures"},
    takes=(LINKS, LOADED_BODIES),
    run=_condense,
)
