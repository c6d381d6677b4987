"""Answers of bodies under named loads: their error budget, tables, sentences and figures."""

from collections.abc import Iterator

import numpy as np

from multiscale.macro.substructures import LoadPath
from multiscale.pipeline import showing
from multiscale.pipeline.body_budget import CycleAnswers, JointAnswers, answer_at
from multiscale.pipeline.real_contact import with_interface_contact
from multiscale.pipeline.stage import Section
from multiscale.pipeline.stages.joint import budget_sections
from multiscale.pipeline.structure_stage import PathAnswers, ReadyBodies
from multiscale.plotting import load_pictures
from multiscale.plotting.figure import in_space, on_axes
from multiscale.plotting.joint_figures import plot_body_stress
from multiscale.schema import MACRO_RESULT, Dataset
from multiscale.upscaling import over_steps, with_budget, with_intervals

LOADED = ("factor", "load_displacement", "load_secant")
SHARES = ("interface_slipping_load", "interface_slip", "interface_open")
"""Columns of the table for each load, and for each interface after its pressure."""

SLIPS = 1e-3  # change of a stiffness by slip, relative to it, from which both are reported


def _complete(result: Dataset, ready: ReadyBodies) -> Dataset:
    """Add names of bodies, and the real contact of their interfaces or else their motion."""
    result = result.assign_attrs(bodies=" ".join(body.name for body in ready.jointed.bodies.bodies))
    if ready.jointed.laws:
        return with_interface_contact(result, ready.jointed.laws)
    moved = np.linalg.norm(result["displacement"].to_numpy(), axis=2).max(axis=1)
    return MACRO_RESULT.assign(result, {"largest_displacement": moved})


def _facts(result: Dataset, ready: ReadyBodies) -> Iterator[str]:
    if ready.jointed.laws:
        yield "Displacements are relative to step 0."
    yield from ready.parts.facts
    yield from _list_interfaces(result)


def _answer(result: Dataset) -> Iterator[str]:
    moved = 1e6 * result["load_displacement"].to_numpy()
    ends = np.flatnonzero((result["path_step"].to_numpy() >= 0) & np.isfinite(moved).all(axis=1))
    if not ends.size:
        return
    last, since = result.isel(step=ends[-1]), ""
    if result.sizes.get("interface", 0):  # without load its gap is not known
        moved, since = moved - moved[ends[0]], " since step 0"
    names, factors = map(str, result["load"].values), last["factor"].to_numpy()
    loads = list(zip(names, factors, moved[ends[-1]], strict=True))
    acting = [load for load in loads if load[1]] or loads  # all loads if none acts any more
    motions = " and ".join(f"{u:.4g} µm along {name} (factor {x:.4g})" for name, x, u in acting)
    if "largest_displacement" in last:
        most = showing.View(result).phrase(last, "largest_displacement")
        motions += f", and a node by up to {most}"
    way = f"the loaded faces have moved{since} by {motions}; " if not since or ends.size > 1 else ""
    stress = last["equivalent_stress"].to_numpy()
    worst = int(np.nanargmax(stress))
    where = ""
    if len(np.unique(result["element_body"])) > 1:
        body = int(result["element_body"][worst])
        bodies = str(result.attrs.get("bodies", "")).split()
        where = f", in {bodies[body] if bodies else f'body {body}, counted from 0'}"
    yield (
        f"At step {int(last['path_step'])} {way}the largest mean stress of an element is "
        f"{1e-6 * stress[worst]:.4g} MPa (von Mises){where}."
    )


def _secants(result: Dataset) -> Iterator[str]:
    """Report the tangent stiffness of the structure under each load at the end of the path."""
    view = showing.View(result)
    for load in result["load"].values:
        loaded = result.sel(load=load)
        for step in np.flatnonzero(np.isfinite(loaded["load_stiffness"].to_numpy()))[-1:]:
            at, further = loaded.isel(step=step), ""
            if result.sizes.get("interface"):
                share = 100.0 * float(at["interface_compliance"].round(6))
                further = f"; {share:.3g} % of the compliance comes from the interfaces"
            stiffness, stuck = float(at["load_stiffness"]), float(at["stuck_stiffness"])
            if abs(stuck - stiffness) > SLIPS * stuck:
                further += "; without slip, as in small vibration, it is {stuck_stiffness}"
            yield from view.sentences(
                at,
                f"The stiffness of the structure for a small increase of {load} at step "
                f"{int(at['path_step'])} is {{load_stiffness:()}}{further}.",
            )


def _list_interfaces(result: Dataset) -> Iterator[str]:
    """Report the real pressure of interfaces at the end of the path, and the loss of a cycle."""
    view = showing.View(result)
    for number in range(result.sizes.get("interface", 0)):
        interface = result.isel(interface=number)
        pressure = interface.get("interface_real_pressure", interface["path_step"] * np.nan)
        for step in np.flatnonzero((interface["path_step"] >= 0) & pressure.notnull())[-1:]:
            at = interface.isel(step=step)
            yield from view.sentences(
                at,
                f"At step {int(at['path_step'])} the mean pressure on the real contact area of "
                f"interface {number} is {{interface_real_pressure:()}}.",
            )
    for number in range(result.sizes.get("interface", 0) if "interface_energy" in result else 0):
        lost = f"Interface {number} dissipates {{interface_energy}} in the last cycle."
        yield from view.sentences(result.isel(cycle=-1, interface=number), lost)


def _sections(result: Dataset) -> Iterator[Section]:
    caption = [
        "Zones, pressure and outlines of the bodies are seen along the normal of each interface, "
        "at the last step that has an answer."
    ]
    known = np.flatnonzero(np.isfinite(result["equivalent_stress"].to_numpy()).all(axis=1))
    figures = {"body_stress": in_space(plot_body_stress, result, step=int(known[-1]))}
    figures |= {name: on_axes(plot) for name, plot in load_pictures(result).items()}
    yield Section("Loads and interfaces", caption, figures=figures)
    yield from budget_sections(result)


def _compared(result: Dataset) -> Dataset:
    """Return stiffnesses at the last step that has any, slip and bolt forces at the last step."""
    known = np.isfinite(result["load_stiffness"].to_numpy()).all(axis=1)
    rest = int(np.flatnonzero(known)[-1]) if known.any() else 0
    at_rest = ("load_stiffness", "interface_real_pressure")
    values = {
        name: value.isel(step=rest if str(name).startswith(at_rest) else -1).reset_coords(drop=True)
        for name, value in result.data_vars.items()
        if "step" in value.dims
    }
    if "bolt_force" in values:
        values["bolt_force"] = values["bolt_force"].max("bolt")
    return result.drop_dims("step").assign(values)


def _tabulate(result: Dataset) -> showing.Rows:
    """Head and rows of bodies at the steps of their path: loads, interfaces, bolts."""
    loads, count = list(map(str, result["load"].values)), result.sizes.get("interface", 0)
    if count:  # displacements are relative to step 0, as the gap without load is not known
        moved = result["load_displacement"]
        start = moved.isel(step=int(np.argmax(result["path_step"].to_numpy() == 0)))
        result = result.assign(load_displacement=moved - start)
    head = (
        "step",
        *(f"{name}: factor, µm, N/µm" for name in loads),
        *(f"interface {k}: MPa, sliding force, area, open area" for k in range(count)),
        *(("bolts (kN)",) if result.sizes.get("bolt") else ()),
    )
    view, rows = showing.View(result), []
    for k in np.flatnonzero(result["path_step"].values >= 0):
        step = result.isel(step=k)
        row = [f"{int(step['path_step'])}"]
        if not int(step["converged"]) or np.isnan(step["load_displacement"]).all():
            row.append("unknown" if int(step["converged"]) else "not converged")
            rows.append(showing.padded(tuple(row), head))
            continue
        for load in (step.isel(load=at) for at in range(len(loads))):
            texts = (view.text(load, name) for name in LOADED)
            row.append(", ".join(texts).replace("unknown", "-"))
        for interface in (step.isel(interface=at) for at in range(count)):
            pressure = view.text(interface, "interface_pressure")
            row.append(", ".join([pressure, *(view.phrase(interface, name) for name in SHARES)]))
        bolts = (step.isel(bolt=k) for k in range(result.sizes.get("bolt", 0)))
        forces = ", ".join(view.text(bolt, "bolt_force") for bolt in bolts)
        rows.append((*row, forces) if forces else tuple(row))
    return head, rows


def _with_errors(result: Dataset, path: LoadPath) -> JointAnswers:
    """Return the answers of bodies under named loads, then of the last cycle of their path."""
    rise = path.cycle_steps if path.cycles and result["converged"].to_numpy().all() else 0
    name, stiffness = "load_stiffness", result["load_stiffness"].to_numpy()
    loads = {f"{name} {load}": (name, k) for k, load in enumerate(map(str, result["load"].values))}
    real = {}
    if "interface_real_pressure" in result:
        known_area = np.isfinite(result["interface_real_pressure"].to_numpy()).any(axis=0)
        real = {
            f"real pressure of interface {k}": ("interface_real_pressure", int(k))
            for k in np.flatnonzero(known_area)
        }
    rests = np.flatnonzero(np.isfinite(stiffness).all(axis=1))
    known, last = result["known"].to_numpy() == 1, np.array([result.sizes["step"] - 1])
    lost = result["cycle_energy"].to_numpy() if "cycle_energy" in result else np.full(1, np.nan)
    cycles = None
    if rise and known[-1] and lost[-1] > 0.0:
        share = result["slipping_load"].to_numpy()[-2:]
        slope = np.full(1, np.nan)
        if rise > 1 and share.min() > 0.0:
            slope[:] = np.log(share[1] / share[0]) / np.log(rise / (rise - 1))
        density = result["dissipation"].to_numpy()[-4 * rise :].sum(axis=0, keepdims=True)
        read = {
            name: answer_at(name, slice(-1, None)) for name in ("slipping_load", "cycle_energy")
        }
        cycles = CycleAnswers(
            read, "slipping_load", "cycle_energy", last, slope, density, rise / path.few
        )

    def place(result: Dataset, budget: Dataset) -> Dataset:
        """Add the budget at its steps."""
        steps = np.append(rests[known[rests]], () if cycles is None else last).astype(int)
        budget = over_steps(budget, steps, known.size)
        return with_intervals(with_budget(result, budget), {**loads, **real})

    read = {
        **{key: answer_at(name, slice(None), k) for key, (name, k) in loads.items()},
        **{key: answer_at("real_pressure") for key in real},
    }
    return JointAnswers(read, {key: (k,) for key, (_, k) in real.items()}, rests, place, cycles)


LOAD_ANSWERS = PathAnswers(
    question="How do the bodies move under their loads, and how are interfaces and bolts loaded?",
    complete=_complete,
    facts=_facts,
    with_errors=lambda result, path, first_order: _with_errors(result, path),
    tabulate=_tabulate,
    sentences=lambda result: [*_answer(result), *_secants(result)],
    sections=_sections,
    compared=_compared,
)
