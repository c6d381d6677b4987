"""Answers of elastic bodies in tables, sentences and figures: of joints, and of named loads."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from multiscale.pipeline import showing
from multiscale.pipeline.stage import Section
from multiscale.pipeline.stages.joint import HEADS, STIFFNESS, budget_sections
from multiscale.plotting import joint_pictures, load_pictures
from multiscale.plotting.figure import in_space, on_axes
from multiscale.plotting.joint_figures import plot_body_stress
from multiscale.schema import Dataset

IN_CYCLES = ("secant_stiffness", "cycle_loss", "cycle_slip")

TABLE = showing.Table(
    (
        "preload",
        *STIFFNESS[:3],
        "slipping_load",
        "tangential_stiffness:±",
        *STIFFNESS[3:],
        "slip_fraction",
        "open_fraction",
        "real_pressure:±",
    ),
    HEADS | {"tangential_stiffness": "tangential, no slip", "slipping_load": "sliding force"},
    answer="approach",
)
"""Answers of the joints at their preloads."""

CYCLES = showing.Table(
    (
        "cycle_preload",
        "cycle_shear",
        *(f"{name}{form}" for name in IN_CYCLES for form in ("", ":both")),
    ),
    {"cycle_shear": "amplitude", "secant_stiffness": "secant stiffness"},
    answer="cycle_loss",
    at=2,
    along=("level", "amplitude"),
)
"""Answers of the closed cycles at every preload and amplitude."""

STIFF = (
    "At a preload of {preload} the joint has a normal stiffness of {joint_stiffness:±} and, before "
    "it slips, a tangential stiffness of {tangential_stiffness:±}."
)
LOSES = (
    "A cycle of shear between {most} and -{most} MPa dissipates {cycle_energy:±}; at its ends, "
    f"{showing.SLIP}."
)
"""Sentences of the answer: at a preload, and in the last cycle."""


def list_forces(preloads: Sequence[float], areas: Sequence[float]) -> Iterator[str]:
    """Yield the forces of the preloads, and the forces over displacements of stiffnesses."""
    pressed, sheared = (1e6 * area for area in areas)  # mm²
    forces = ", ".join(f"{1e-9 * pressed * preload:.4g}" for preload in preloads)
    yield f"The preloads are pressures on {pressed:.4g} mm², forces of {forces} kN."
    yield (
        f"Stiffness is pressure or shear over the displacement of its face: 1 MPa/µm is "
        f"{pressed:.4g} N/µm of preload, and {sheared:.4g} N/µm of shear."
    )


def _tabulate_joints(result: Dataset) -> showing.Rows:
    """Head and rows of joints at their preloads."""
    return TABLE.rows(_pressed(result))


def _answer_of_joints(result: Dataset) -> Iterator[str]:
    """Report stiffness, slip and loss at the last of the preloads with an answer."""
    known = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()))
    if not known.size:
        return
    view = showing.View(result)
    yield from view.sentences(result.isel(step=known[-1]), STIFF)
    if "cycle_energy" in result:
        most = f"{1e-6 * float(np.abs(result['shear']).max()):.3g}"
        yield from view.sentences(result.isel(step=-1, cycle=-1), LOSES, most=most)
    yield from showing.list_missing(result)


def _sections_of_joints(result: Dataset) -> Iterator[Section]:
    """Show where the joints stick, slip and open, their loop, and their error budgets."""
    caption = [
        "Zones and pressure are seen along the normal of the first joint, at the last amplitude "
        "that has an answer; a point slides if contacts with more than half of its pressure "
        "slide, and is open below 1 % of the mean pressure; lines are the outlines of the bodies."
    ]
    figures = {name: on_axes(plot) for name, plot in joint_pictures(result).items()}
    yield Section("Joint", caption, figures=figures)
    if "cycle_loss" in result:
        cycles = [
            "At each preload the shear makes a closed cycle of each amplitude, in rising order. "
            "The secant stiffness is the shear over the displacement of the sheared face between "
            "both ends of a cycle. Bands are the 95 % intervals of the mean law and of one part."
        ]
        yield Section("Cycles of shear", cycles, *CYCLES.rows(result))
    yield from budget_sections(result)


def _pressed(result: Dataset) -> Dataset:
    """Return the steps before any shear."""
    sheared = np.flatnonzero(result["shear"].to_numpy())
    return result.isel(step=slice(sheared[0])) if sheared.size else result


def _compare_joints(result: Dataset) -> Dataset:
    """Return the answers at the preloads and of cycles, with the slip at the end of the path."""
    slip = [name for name in result if str(name).startswith("slipping_load")]
    result = result.drop_vars("bolt_force", errors="ignore")  # the preloads
    if not result["shear"].any():
        return result.drop_vars(slip)
    return _pressed(result).assign({name: result[name].isel(step=-1) for name in slip})


LOADED = ("factor", "load_displacement", "load_secant")
SHARES = ("interface_slipping_load", "interface_slip", "interface_open")
"""Columns of the table for each load, and for each interface after its pressure."""

SLIPS = 1e-3  # change of a stiffness by slip, relative to it, from which both are reported


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


def list_interfaces(result: Dataset) -> Iterator[str]:
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
    """Show loads, bolts and interfaces."""
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


class Answers(NamedTuple):
    """How the answers of a kind of path are shown and compared."""

    question: str
    tabulate: Callable[[Dataset], showing.Rows]
    sentences: Callable[[Dataset], Iterable[str]]
    sections: Callable[[Dataset], Iterable[Section]]
    compared: Callable[[Dataset], Dataset]


OF_JOINTS = Answers(
    "How stiff are the joints, where do they slip, and what does a cycle dissipate?",
    _tabulate_joints,
    _answer_of_joints,
    _sections_of_joints,
    _compare_joints,
)
OF_LOADS = Answers(
    "How do the bodies move under their loads, and what do their interfaces and bolts do?",
    _tabulate,
    lambda result: [*_answer(result), *_secants(result)],
    _sections,
    _compared,
)


def answers_of(result: Dataset) -> Answers:
    """Return how the answers of a result are shown: with the names of a joint, or by load."""
    return OF_LOADS if "load" in result.dims else OF_JOINTS
