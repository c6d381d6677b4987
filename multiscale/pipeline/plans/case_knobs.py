"""The knobs of the stages of a case: cells, volumes, bodies and treads."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.layer import graded_planes
from multiscale.pipeline.case_cells import longest_wave
from multiscale.pipeline.plans.knobs import CaseKnob, as_read, scaled
from multiscale.pipeline.tables.settings import Case
from multiscale.upscaling.budget import MACRO
from multiscale.upscaling.sampling import FEWEST_REALISATIONS

FEWEST_CELLS, FIRST_CELLS = 4, 8
"""Cells for the scatter: the fewest of a plan, and the fewest to which it reduces more cells."""
FEWEST_POINTS = 8  # of a cell along an edge
FEWEST_WAVELENGTHS = 2.0  # across a cell: with fewer the error has no power law in the size
SIZE_SEED = 1_000_003
"""Distance of the seeds of cells of different sizes."""

CELLS, SHEAR, FLAT = "micro_response", "shear_response", "control_response"
STRUCTURE = "macro_result"
"""Stages by which costs grow."""

LAYERED, PLANE = 3.75, 2.5
"""Power of two by which the time of a cell grows with its points, with and without layers:
iterations grow, too."""


def cell_knobs(case: Case) -> Iterator[CaseKnob]:
    """Yield the knobs of pressed and sheared cells."""
    each = dict.fromkeys((CELLS, SHEAR, FLAT), 1.0)
    # a law that measured joints calibrate has the sampling error of their posterior, which does not
    # fall with the number of cells
    sampled = case.measured is None
    if sampled:
        yield CaseKnob("cells", _more, ("sampling",), (0.5, 0.5), each, measured=False, adds=True)
    pressed = dict.fromkeys((CELLS, FLAT), 1.0)
    yield CaseKnob("pressures", _denser, ("fit",), (2.0, 2.0), pressed, measured=False)
    if case.cell.mesh is None:
        fine = LAYERED if case.cell.geometry != "flat" else PLANE
        finer, larger = {CELLS: fine, SHEAR: LAYERED}, dict.fromkeys(each, PLANE)
        yield CaseKnob("points of the cells", _finer, ("micro discretisation",), costs=finer)
        if case.way == "direct":  # cells are as wide as the blocks
            return
        yield CaseKnob(
            "size of the cells",
            _larger,
            ("cell size",),
            costs=larger,
            scatters=True,
            draws=1.0 if sampled else 0.0,
            lowers=("surface",) if case.from_maps else (),  # windows hold longer waves of a map
        )


def volume_knobs(case: Case) -> Iterator[CaseKnob]:
    """Yield the knobs of representative volumes."""
    more, finer = scaled({"rve.recipe.realisations": 2}), scaled({"rve.voxels": 2})
    yield CaseKnob(
        "volumes", more, ("sampling",), (0.5, 0.5), {"rve": 1.0}, measured=False, adds=True
    )
    yield CaseKnob("voxels of the volumes", finer, ("micro discretisation",), costs={"rve": 3.2})


def road_knobs(case: Case) -> Iterator[CaseKnob]:
    """Yield the knobs of cells of rubber on a road."""
    more, each = scaled({"sliding.realisations": 2}), {CELLS: 1.0}
    yield CaseKnob("cells", more, ("sampling",), (0.5, 0.5), each, measured=False, adds=True)
    finer = scaled({"cell.points": 2})
    yield CaseKnob("points of the cells", finer, ("micro discretisation",), costs={CELLS: PLANE})


def grain_knobs(case: Case) -> Iterator[CaseKnob]:
    """Yield the knobs of sheared cells of grains."""
    more, each = scaled({"third_body.realisations": 2}), {CELLS: 1.0}
    yield CaseKnob("cells", more, ("sampling",), (0.5, 0.5), each, measured=False, adds=True)
    larger = {CELLS: 2.0}
    yield CaseKnob(
        "size of the cells", wider_grains, ("cell size",), costs=larger, scatters=True, draws=1.0
    )


def wider_grains(case: Case, rung: int = 1) -> Case:
    """Return a case with cells of grains of 2^rung times the periods, and as many layers."""
    wider = scaled({"third_body.size": 2, "grains.number": 4})(case, rung)
    wider.third_body.steps(wider.grains)  # refuses short periods
    return wider


def tread_knobs(case: Case) -> Iterator[CaseKnob]:
    """Yield the knob of a tread block."""
    yield CaseKnob("elements", scaled({"tread.elements": 2}), (MACRO,), costs={STRUCTURE: LAYERED})


def body_knobs(case: Case) -> Iterator[CaseKnob]:
    """Yield the knobs of bodies with joints, at rest, in cycles and in vibration."""
    spacing = {"structure.element": 0.5, "structure.elements": 2, "structure.bodies.element": 0.5}
    both = (STRUCTURE, "vibration")
    files = case.structure.file_meshes if case.structure else ()
    budgeted = any(files) and all(files)  # the error of all meshes is in the budget
    yield CaseKnob(
        "elements",
        scaled(spacing),
        () if files and not budgeted else (MACRO,),
        costs=dict.fromkeys(both, PLANE),
        measured=not budgeted,
        ratio=lambda case: case.structure.refinement() if case.structure else 2.0,
    )
    smaller = {"cycles.steps": 2, "statics.substeps": 2}
    yield CaseKnob("load steps", scaled(smaller), costs=dict.fromkeys(both, 1.0), eases=True)
    for name, keys, orders, cost in (
        ("layers of the elements", {"structure.layers": 2}, (1.0, 2.0), 1.3),
        ("tolerance of the substructures", {"substructures.tolerance": 0.1}, (3.0, 3.4), 0.1),
        ("slabs", {"vibration.slabs": 2, "cycles.slabs": 2}, (1.0, 2.0), 0.5),
        ("steps of a vibration", {"vibration.steps": 2}, (1.0, 2.0), 1.0),
    ):
        yield CaseKnob(name, scaled(keys), (), orders, dict.fromkeys(both, cost))


def _more(case: Case, rung: int) -> Case:
    """Return a case with more cells, pressed and sheared."""
    micro, factor = case.micro, 2.0**rung
    if rung < 0 and factor * micro.realisations < FIRST_CELLS:
        raise CaseError(f"fewer than {FIRST_CELLS} cells do not determine their scatter")
    count = round(factor * max(FEWEST_CELLS, micro.realisations))
    changes: dict[str, Any] = {
        "realisations": count if case.cell.mesh is None else micro.realisations
    }
    if micro.control_realisations is not None:
        changes["control_realisations"] = max(count, round(factor * micro.control_realisations))
    if micro.shear is not None:
        given = micro.shear.realisations
        sheared = min(count, max(min(FEWEST_REALISATIONS, given), round(factor * given)))
        changes["shear"] = micro.shear.model_copy(update={"realisations": sheared})
    return case.model_copy(update={"micro": micro.model_copy(update=changes)})


def _denser(case: Case, rung: int) -> Case:
    """Return a case with pressures between its pressures."""
    if rung < 0:
        raise CaseError("the pressures of the case are the fewest")
    pressures = case.micro.pressures
    for _ in range(rung):
        middle = map(as_read, np.sqrt(np.multiply(pressures[1:], pressures[:-1])))
        pressures = tuple(sorted((*pressures, *middle)))
    micro = case.micro.model_copy(update={"pressures": pressures})
    return case.model_copy(update={"micro": micro})


def _finer(case: Case, rung: int) -> Case:
    """Return a case with cells of more points, on the same surfaces."""
    return _resized(case, 0, rung)


def _larger(case: Case, rung: int) -> Case:
    """Return a case with larger cells of the same spacing, on other surfaces."""
    return _resized(case, rung, 0)


def _resized(case: Case, size: int, grid: int) -> Case:
    """Return a case with edges 2^size times as long and a spacing 2^-grid times as wide."""
    cell, larger, finer = case.cell, 2.0**size, 2.0 ** (size + grid)
    most, layers = float(max(cell.points)), cell.layers
    spacing = 2.0**-grid * cell.spacing
    count = finer * min(cell.points)
    if count < FEWEST_POINTS:
        raise CaseError(f"{count:g} points along an edge are too few for a cell")
    # a surface without a shortest wavelength has the wavelengths of its grid
    shortest = min((wave for wave in _cutoffs(case) if wave is not None), default=np.inf)
    if 2.0 * spacing >= shortest:
        raise CaseError(
            f"{count:g} points along an edge do not resolve wavelengths of {shortest:.3g} m"
        )
    across = larger * max(cell.size) / longest_wave(case)
    if size < 0 and not case.from_maps and across < FEWEST_WAVELENGTHS:
        raise CaseError(f"cells of {across:.2g} wavelengths are too small")
    thickness = np.diff(graded_planes(most, layers, 1.0))  # over the spacing, from base to top
    ratio = max(float(thickness[0] / thickness[-1]), 1.0 + 1e-6)
    growth = ratio ** (2.0**-grid / (layers - 1))
    graded = np.log1p((growth - 1.0) * finer * most) / np.log(growth)

    def points(given: tuple[int, int]) -> tuple[int, ...]:
        return tuple(2 * max(2, round(0.5 * finer * n)) for n in given)

    new = {
        "size": tuple(as_read(larger * edge) for edge in cell.size),
        "points": points(cell.points),
        "layers": max(4, round(graded)),
    }
    micro, seed = case.micro, case.micro.seed + SIZE_SEED * (size % 7)
    shear = micro.shear
    if shear is not None and shear.points is not None:
        shear = shear.model_copy(update={"points": points(shear.points)})
    micro = micro.model_copy(update={"seed": seed, "shear": shear})
    return case.model_copy(update={"cell": cell.model_copy(update=new), "micro": micro})


def _cutoffs(case: Case) -> list[float | None]:
    """Shortest wavelengths of the rough bodies, m; None where a surface has all."""
    return [body.surface.short_cutoff for body in case.bodies if body.surface is not None]


def refuse_surfaces(case: Case) -> None:
    """Refuse surfaces that differ between grids."""
    for number, body in enumerate(case.bodies, start=1):
        if body.surface is not None and body.surface.short_cutoff is None:
            raise CaseError(
                f"[accuracy] compares grids, on which the surface has to be the same: give "
                f"short_cutoff in [body_{number}.surface]"
            )
