"""Stage: elastic bodies of the user under named loads."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from multiscale.io import write_body_fields
from multiscale.macro import substructures
from multiscale.needs import Choice, Needs
from multiscale.pipeline.body_budget import ErrorSources, few_steps, with_joint_budget
from multiscale.pipeline.joint_answers import load_answers
from multiscale.pipeline.real_contact import with_interface_contact
from multiscale.pipeline.showing import Rows, View, list_bolts, padded
from multiscale.pipeline.stage import Datasets, Job, Section
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.joint import budget_sections
from multiscale.pipeline.stages.volumes import REPRESENTATIVE_VOLUME
from multiscale.pipeline.structure_stage import (
    ReadyBodies,
    choose_solver,
    counting,
    require_known,
    solver_needs,
    structure_stage,
    with_cautions_of,
)
from multiscale.pipeline.tables.assembly_settings import Bodies
from multiscale.pipeline.tables.joint_settings import SLABS
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting import load_pictures
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

OF_LOADS = ("factor", "load_displacement", "load_secant")
SHARES = ("interface_slipping_load", "interface_slip", "interface_open")
"""What the table has of each load, and of each interface beside its pressure."""

SLIPS = 1e-3
"""Change of a stiffness by slip, relative to it, from which both are reported."""


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
    facts = [*counted, *ready.parts.facts, *_interfaces(result), *bolts]
    return ready.finish(result, facts)


def _with_budget(
    result: Dataset, ready: ReadyBodies, path: "substructures.LoadPath", job: Job
) -> Dataset:
    """Carry the budgets of all laws to stiffnesses, real pressures and the last cycle."""
    bodies, case, laws = ready.bodies, ready.case, ready.laws
    sources = ErrorSources.of(bodies, case, laws)
    result = with_cautions(result, "" if sources.meshes else NO_COARSER)
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
    return with_joint_budget(result, sources, solve, asked, job)


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
    """Report how stiff the structure is under each load, for small changes, at the path's end."""
    view = View(result)
    for load in result["load"].values:
        one = result.sel(load=load)
        for step in np.flatnonzero(np.isfinite(one["load_stiffness"].to_numpy()))[-1:]:
            at, beside = one.isel(step=step), ""
            if result.sizes.get("interface"):
                share = 100.0 * float(at["interface_compliance"].round(6))
                beside = f"; {share:.3g} % of the compliance comes from the interfaces"
            stiffness, stuck = float(at["load_stiffness"]), float(at["stuck_stiffness"])
            if abs(stuck - stiffness) > SLIPS * stuck:
                beside += "; while no point slips, as in small vibration, it has {stuck_stiffness}"
            yield from view.sentences(
                at,
                f"Against a small rise of {load} at step {int(at['path_step'])} the structure has "
                f"a stiffness of {{load_stiffness:()}}{beside}.",
            )


def _interfaces(result: Dataset) -> Iterator[str]:
    """Report the real pressure of interfaces at the end of the path, and what a cycle loses."""
    view = View(result)
    for number in range(result.sizes.get("interface", 0)):
        one = result.isel(interface=number)
        known = one.get("interface_real_pressure", one["path_step"] * np.nan).notnull()
        for step in np.flatnonzero((one["path_step"] >= 0) & known)[-1:]:
            at = one.isel(step=step)
            yield from view.sentences(
                at,
                f"At step {int(at['path_step'])} interface {number} has, where it touches, "
                "{interface_real_pressure:()}.",
            )
    for number in range(result.sizes.get("interface", 0) if "interface_energy" in result else 0):
        lost = f"Interface {number} loses {{interface_energy}} in the last cycle."
        yield from view.sentences(result.isel(cycle=-1, interface=number), lost)


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
        name: one.isel(step=rest if str(name).startswith(at_rest) else -1).reset_coords(drop=True)
        for name, one in result.data_vars.items()
        if "step" in one.dims
    }
    if "bolt_force" in values:
        values["bolt_force"] = values["bolt_force"].max("bolt")
    return result.drop_dims("step").assign(values)


def _tabulate(result: Dataset) -> Rows:
    """Head and rows of bodies at the steps of their path: loads, interfaces, bolts.

    Of each load its factor, displacement (with interfaces, since step 0) and secant stiffness; of
    each interface its mean pressure, the share of its contact force at sliding, and the shares of
    its nominal area at sliding and open.
    """
    loads, count = list(map(str, result["load"].values)), result.sizes.get("interface", 0)
    if count:  # an interface without load has no gap from which displacements could count
        moved = result["load_displacement"]
        start = moved.isel(step=int(np.argmax(result["path_step"].to_numpy() == 0)))
        result = result.assign(load_displacement=moved - start)
    head = (
        "step",
        *(f"{name}: factor, µm, N/µm" for name in loads),
        *(f"interface {k}: MPa, sliding force, area, open area" for k in range(count)),
        *(("bolts (kN)",) if result.sizes.get("bolt") else ()),
    )
    view, rows = View(result), []
    for k in np.flatnonzero(result["path_step"].values >= 0):
        step = result.isel(step=k)
        row = [f"{int(step['path_step'])}"]
        if not int(step["converged"]) or np.isnan(step["load_displacement"]).all():
            row.append("unknown" if int(step["converged"]) else "not converged")
            rows.append(padded(tuple(row), head))
            continue
        for one in (step.isel(load=at) for at in range(len(loads))):
            row.append(", ".join(view.text(one, name) for name in OF_LOADS).replace("unknown", "-"))
        for one in (step.isel(interface=at) for at in range(count)):
            pressure = view.text(one, "interface_pressure")
            row.append(", ".join([pressure, *(view.say(one, name) for name in SHARES)]))
        bolts = (step.isel(bolt=k) for k in range(result.sizes.get("bolt", 0)))
        forces = ", ".join(view.text(bolt, "bolt_force") for bolt in bolts)
        rows.append((*row, forces) if forces else tuple(row))
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
    answer=lambda result: [*_answer(result), *_secants(result)],
    answers={
        "load_stiffness": "stiffness under the last load",
        "interface_real_pressure": "real pressure of the last interface",
        "slipping_load": "",
        "cycle_energy": "",
        "bolt_force": "largest bolt force",
    },
    compared=_compared,
)
