"""Stage: elastic bodies of the user under named loads."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from multiscale.io import write_body_fields
from multiscale.macro import substructures
from multiscale.needs import Choice, Needs
from multiscale.pipeline.assembly_settings import Bodies
from multiscale.pipeline.body_budget import ErrorSources, few_steps, with_joint_budget
from multiscale.pipeline.joint_answers import load_answers
from multiscale.pipeline.joint_settings import SLABS
from multiscale.pipeline.ready_bodies import ReadyBodies, with_cautions_of
from multiscale.pipeline.real_contact import with_interface_contact
from multiscale.pipeline.rows import Table, list_bolts, padded, say_answer, say_share
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, Section, StageAnswer
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.joint import budget_sections
from multiscale.pipeline.stages.representative_volume import REPRESENTATIVE_VOLUME
from multiscale.pipeline.structure_stage import (
    choose_solver,
    counting,
    require_known,
    solver_needs,
    structure_stage,
)
from multiscale.plotting import MOST_DRAWN, load_pictures
from multiscale.plotting.body_figures import plot_body_stress
from multiscale.plotting.figure import in_space, on_axes
from multiscale.schema import MACRO_RESULT, Dataset, with_cautions

__all__ = ["LOADED_BODIES"]

KEPT = (
    "--quick takes larger elements in geometries, and elements of first order on meshes that are "
    "read from files, which it cannot make coarser"
)

NO_COARSER = (
    "the error of the meshes is unknown, and no interval counts it: give every body a coarser "
    "mesh, of elements twice as large"
)

SHARES = ("slipping_load", "slip", "open")
"""Of the contact force of an interface at sliding, of its area at sliding, and of its open area."""

SLIPS = 1e-3
"""Change of a stiffness by slip, relative to it, from which both are told."""

ANSWERS = (
    StageAnswer("load_stiffness", "stiffness under the last load", "N/µm", 1e-6),
    StageAnswer("interface_real_pressure", "real pressure of the last interface", "MPa", 1e-6),
    StageAnswer("slipping_load", "contact force at sliding", "%", 100.0),
    StageAnswer("cycle_energy", "loss of a cycle", "mJ", 1e3),
    StageAnswer("bolt_force", "largest bolt force", "kN", 1e-3),
)
"""What bodies are compared by: at the last step with stiffnesses, by their cycles, at the end."""

PICTURES = (
    "body_stress",
    "error_budget",
    "loads",
    "bolts",
    *(f"{name}_{k}" for k in range(MOST_DRAWN) for name in ("contact_zones", "pressure")),
)
"""Names of all figures of loaded bodies."""


def _solve(bodies: Bodies, case: Case, found: Datasets, job: Job) -> Dataset:
    """Follow the path over the named loads."""
    ready = ReadyBodies.of(bodies, case, found, job)
    laws, path, structure = ready.laws, ready.parts.path, ready.structure
    watched = counting(ready.method, job, len(path.factors()))
    result = structure.restore(
        substructures.follow_cut_loads(
            structure.small, path, method=watched, extrapolate=case.extrapolate
        )
    )
    result = with_cautions_of(result, ready.bodies, case, found, laws)
    if laws:
        result = with_interface_contact(result, laws)
    result = _with_budget(result, ready, path, job)
    result = result.assign_attrs(bodies=" ".join(one.name for one in bodies.bodies))
    tightening = result["factor"].to_numpy()[:, 0]
    bolts = list_bolts(result, tightening) if ready.parts.assembly.bolts else []
    counted = ["Displacements count from step 0."] if laws else []
    measured = [*_real_pressures(result), *_energies(result)]
    return ready.finish(result, [*counted, *ready.parts.facts, *measured, *bolts])


def _with_budget(
    result: Dataset, ready: ReadyBodies, path: "substructures.LoadPath", job: Job
) -> Dataset:
    """Carry the budgets of all laws to stiffnesses, real pressures and the last cycle."""
    bodies, case, laws = ready.bodies, ready.case, ready.laws
    sources, coarser = ErrorSources.of(bodies, case, laws), bodies.coarser()
    if not coarser:
        result = with_cautions(result, NO_COARSER)
        if not sources:
            return result
    if not laws:  # nothing but convergence limits what is known
        result = MACRO_RESULT.assign(result, {"known": result["converged"].to_numpy()})
    solved = int(np.count_nonzero(result["converged"].values[path.ends() >= 0]))
    if not solved:
        return result
    whole = bool(result["converged"].values.all())
    few = few_steps(case) if whole else 0
    short = replace(
        path, steps=path.steps[:solved], cycles=min(path.cycles, int(whole)), cycle_steps=few or 1
    )
    prepared = substructures.PreparedStructure(ready.structure.small, ready.method)
    near = substructures.follow(prepared, short.factors())
    rise = path.cycle_steps if path.cycles and whole and sources.laws else 0
    asked = load_answers(result, rise, few)
    solve = ready.again(partial(_follow, short), near)
    return with_joint_budget(result, sources, solve, asked, coarser, job)


def _follow(
    path: "substructures.LoadPath",
    problem: "substructures.CutProblem",
    areas: Sequence[float],
    method: "substructures.Method",
    near: "substructures.FollowedPath | None" = None,
) -> Dataset:
    """Follow a path, maybe near another one, whatever the data of the laws."""
    return substructures.follow_cut_loads(problem, path, method=method, extrapolate=True, near=near)


def _answer(result: Dataset) -> Iterator[str]:
    """Report displacements and the largest stress at the last step of the path with an answer."""
    moved = 1e6 * result["load_displacement"].to_numpy()
    ends = np.flatnonzero((result["path_step"].to_numpy() >= 0) & np.isfinite(moved).all(axis=1))
    if not ends.size:
        return
    last, since = result.isel(step=ends[-1]), ""
    if result.sizes.get("interface", 0):  # without load its gap is not known
        moved, since = moved - moved[ends[0]], " since step 0"
    names, factors = map(str, result["load"].values), last["factor"].to_numpy()
    loads = list(zip(names, factors, moved[ends[-1]], strict=True))
    acting = [load for load in loads if load[1]] or loads  # all of them where none acts any more
    said = " and ".join(f"{u:.4g} µm along {name} (factor {x:.4g})" for name, x, u in acting)
    way = f"the loaded faces have moved{since} by {said}; " if not since or ends.size > 1 else ""
    stress = last["equivalent_stress"].to_numpy()
    worst = int(np.nanargmax(stress))
    where = ""
    if len(np.unique(result["element_body"])) > 1:
        body = int(result["element_body"][worst])
        called = str(result.attrs.get("bodies", "")).split()
        where = f", in {called[body] if called else f'body {body}, counted from 0'}"
    yield (
        f"At step {int(last['path_step'])} {way}the largest mean stress of an element is "
        f"{1e-6 * stress[worst]:.4g} MPa (von Mises){where}."
    )


def _secants(result: Dataset) -> Iterator[str]:
    """Say how stiff the structure is under each load, for small changes, at the end of the path."""
    for load in result["load"].values:
        one = result.sel(load=load)
        known = np.flatnonzero(np.isfinite(one["load_stiffness"].to_numpy()))
        if known.size:
            at = one.isel(step=known[-1])
            share = f"{100.0 * float(at['interface_compliance'].round(6)):.3g} % of the compliance"
            beside = f"; {share} comes from the interfaces" if result.sizes.get("interface") else ""
            stiffness, stuck = float(at["load_stiffness"]), float(at["stuck_stiffness"])
            if abs(stuck - stiffness) > SLIPS * stuck:
                beside += (
                    f"; while no point slips, as in small vibration, it has {1e-6 * stuck:.4g} N/µm"
                )
            yield (
                f"Against a small rise of {load} at step {int(at['path_step'])} the structure "
                f"has a stiffness of {say_answer(at, 'load_stiffness', 1e-6, ' N/µm')}{beside}."
            )


def _real_pressures(result: Dataset) -> Iterator[str]:
    """Say the mean real pressure of each interface at the end of the path."""
    for number in range(result.sizes.get("interface", 0)):
        one = result.isel(interface=number)
        real = one.get("interface_real_pressure")
        if real is not None and np.isfinite(real).any():
            at = one.isel(step=np.flatnonzero((one["path_step"] >= 0) & np.isfinite(real))[-1])
            told = say_answer(at, "interface_real_pressure", 1e-6, " MPa")
            yield (
                f"At step {int(at['path_step'])} interface {number} has, where it touches, {told}."
            )


def _energies(result: Dataset) -> Iterator[str]:
    """Say what each interface loses in the last cycle, if it was closed."""
    if "interface_energy" in result:
        for number, lost in enumerate(result["interface_energy"].values[-1]):
            if np.isfinite(lost):
                yield f"Interface {number} loses {1e3 * lost:.4g} mJ in the last cycle."


def _needs(bodies: Bodies, case: Case) -> Needs:
    size = bodies.joint_size(case)
    chosen = choose_solver(case, size)
    points = size.joint_points
    needs = solver_needs(chosen, size, SLABS if points else 0)
    path = f"and one cycle of {few_steps(case)} steps to its amplitude" if case.cycles else "alone"
    solves = Choice(
        "intervals",
        f"{'5 to 7' if case.cycles else '3 to 6'} more solves, of the steps {path}, for each law "
        f"with a budget: one for each of its terms, and once coarser beds and meshes",
    )
    libraries = tuple(sorted({*needs.libraries, "meshio"}))
    return replace(needs, libraries=libraries, choices=(*needs.choices, *([solves] * bool(points))))


def _sections(result: Dataset) -> Iterator[Section]:
    """Show loads, bolts and interfaces."""
    told = [
        "Zones, pressure and outlines of the parts are seen along the normal of each interface, at "
        "the last step that has an answer."
    ]
    known = np.flatnonzero(np.isfinite(result["equivalent_stress"].to_numpy()).all(axis=1))
    figures = {"body_stress": in_space(plot_body_stress, result, step=int(known[-1]))}
    figures |= {name: on_axes(plot) for name, plot in load_pictures(result).items()}
    yield Section("Loads and interfaces", told, figures=figures)
    yield from budget_sections(result)


def _compared(result: Dataset) -> Dataset:
    """Return the answers at the last step that has stiffnesses, slip and bolts at the last one."""
    known = np.isfinite(result["load_stiffness"].to_numpy()).all(axis=1)
    rest = int(np.flatnonzero(known)[-1]) if known.any() else 0
    at_rest = ("load_stiffness", "interface_real_pressure")
    values = {
        name: one.isel(step=rest if str(name).startswith(at_rest) else -1)
        for name, one in result.data_vars.items()
        if "step" in one.dims
    }
    if "bolt_force" in values:
        values["bolt_force"] = values["bolt_force"].max("bolt")
    return result.drop_dims("step").assign(values)


def _tabulate(result: Dataset) -> Table:
    """Head and rows of bodies at the steps of their path: loads, interfaces, bolts.

    Of each load its factor, displacement (with interfaces, since step 0) and secant stiffness; of
    each interface its mean pressure, the share of its contact force at sliding, and the shares of
    its nominal area at sliding and open.
    """
    loads = [str(name) for name in result["load"].values]
    count = result.sizes.get("interface", 0)
    bolts = result.sizes.get("bolt", 0)
    moved = 1e6 * result["load_displacement"].values
    if count:  # an interface without load has no gap from which displacements could count
        moved = moved - moved[np.argmax(result["path_step"].values == 0)]
    head = (
        "step",
        *(f"{name}: factor, µm, N/µm" for name in loads),
        *(f"interface {k}: MPa, sliding force, area, open area" for k in range(count)),
        *(("bolts (kN)",) if bolts else ()),
    )
    rows: list[tuple[str, ...]] = []
    for k in np.flatnonzero(result["path_step"].values >= 0):
        step = result.isel(step=k)
        name = f"{int(step['path_step'])}"
        if not int(step["converged"]) or np.isnan(step["load_displacement"]).all():
            missing = "unknown" if int(step["converged"]) else "not converged"
            rows.append(padded((name, missing), head))
            continue
        row = [name]
        for at in range(len(loads)):
            one = step.isel(load=at)
            secant = 1e-6 * float(one["load_secant"])
            said = [f"{float(one['factor']):.4g}", f"{moved[k, at]:.4g}"]
            row.append(", ".join([*said, f"{secant:.4g}" if np.isfinite(secant) else "-"]))
        for at in range(count):
            one = step.isel(interface=at)
            shares = (float(one[f"interface_{what}"]) for what in SHARES)
            told = [f"{1e-6 * float(one['interface_pressure']):.4g}"]
            row.append(", ".join([*told, *(f"{say_share(share)} %" for share in shares)]))
        if bolts:
            row.append(", ".join(f"{1e-3 * force:.4g}" for force in step["bolt_force"].values))
        rows.append(tuple(row))
    return head, rows


LOADED_BODIES = structure_stage(
    "loaded_bodies",
    _solve,
    _needs,
    _tabulate,
    write_body_fields,
    reads={"strict", "structure", "interface", "statics", "cycles", "substructures"},
    takes=(FITTED_LAW, REPRESENTATIVE_VOLUME),
    question="How do the bodies move under their loads, and what do their interfaces and bolts do?",
    prepare=lambda bodies, case: bodies.try_to_build(case, substructures.require_held),
    check=partial(require_known, answer="load_displacement"),
    kept=KEPT,
    more=_sections,
    pictures=PICTURES,
    answer=lambda result: [*_answer(result), *_secants(result)],
    answers=ANSWERS,
    compared=_compared,
)
