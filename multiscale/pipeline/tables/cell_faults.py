"""Checks of the tables of cells against each other."""

from collections.abc import Iterator
from operator import truediv
from typing import TYPE_CHECKING

from multiscale.micro.slide import LONGEST_SLIDE
from multiscale.pipeline.tables.joint_settings import RoughInterface
from multiscale.pipeline.tables.rough_bodies import CONDUCTIVITIES, CoatingSettings, RoughBody

if TYPE_CHECKING:
    from multiscale.pipeline.tables.settings import Case

HARDEST = 0.1  # largest hardness over Young's modulus; the hardness of diamond is about as large


def cell_faults(case: "Case") -> Iterator[str]:
    """Report tables and keys that are wrong for cells."""
    rough = [k for k, body in enumerate(case.bodies, 1) if body.surface is not None]
    if case.cell.mesh is not None and rough:
        yield (
            f"mesh in [cell] is a body with its roughness, and body_{rough[0]} has a [surface] "
            f"too; leave out one of them"
        )
    if case.cell.mesh is None and not rough:
        yield "both bodies are smooth; give one of them a [surface] table"
    if case.cell.geometry == "mesh":
        yield from _mesh_faults(case)
    yield from _metal_faults(case)
    yield from _coating_faults(case)
    yield from _conductivity_faults(case)
    yield from _shear_faults(case)
    yield from _coarser_faults(case)
    yield from _control_faults(case)
    yield from _leakage_faults(case)
    if case.slide is not None:
        yield from _slide_faults(case)


def _mesh_faults(case: "Case") -> Iterator[str]:
    if case.cell.mesh is not None and case.micro.realisations != 1:
        yield (
            f"mesh in [cell] is one cell, and [micro] has {case.micro.realisations} "
            f"realisations; set realisations = 1"
        )
    if case.cell.mesh is not None and case.micro.shear is not None:
        yield (
            "[micro.shear] shears cells on surfaces of two bodies, and mesh in [cell] has no "
            "surfaces; leave out one of them"
        )
    if case.hardness is not None and case.cell.volumes:
        yield (
            "named volumes in [cell] are elastic, and a body has a hardness, by which all of a "
            "mesh flows; leave out one of them"
        )
    if case.slide is not None:
        yield (
            'cells on meshes do not slide; set geometry = "conforming" in [cell], or leave '
            "[slide] out"
        )


def _slide_faults(case: "Case") -> Iterator[str]:
    if case.cell.geometry == "flat":
        yield 'flat cells do not slide; set geometry = "conforming" in [cell], or leave [slide] out'
    periods = case.slide.distance / case.cell.size[0]
    if periods > LONGEST_SLIDE:
        yield (
            f"distance in [slide] is {periods:.3g} lengths of the cell, whose friction repeats "
            "after one, or after a few of metal that flows: slide at most "
            f"{LONGEST_SLIDE:g}"
        )


def _shear_faults(case: "Case") -> Iterator[str]:
    """Report cells that cannot be sheared, and options of sheared cells without shear."""
    shear = case.micro.shear
    if shear is None:
        if case.law.apart is not None:
            yield (
                "apart in [law] is an option of the fit to sheared cells, and no cells are "
                "sheared; give [micro.shear], or leave it out"
            )
        return
    if case.hardness is not None:
        yield (
            "[micro.shear] shears elastic bodies, independently at each pressure, and "
            "a body has a hardness; leave out one of them"
        )
    points = shear.points or case.cell.points
    if any(
        n_sheared > all_cells for n_sheared, all_cells in zip(points, case.cell.points, strict=True)
    ):
        yield (
            f"points in [micro.shear] are {points[0]} x {points[1]}, more than the "
            f"{case.cell.scope} in [cell]; cells that are sheared may be coarser"
        )


def _control_faults(case: "Case") -> Iterator[str]:
    if not (case.micro.control or case.micro.control_realisations):
        return
    if case.cell.geometry == "flat" or case.cell.mesh is not None:
        here = "flat already" if case.cell.mesh is None else "on a mesh without a surface"
        yield (
            f"control in [micro] uses flat cells on the surfaces of other cells, and the cells "
            f"are {here}; leave it out"
        )


def _leakage_faults(case: "Case") -> Iterator[str]:
    if not case.micro.leakage:
        if case.seal is not None:
            yield (
                "[seal] needs the leakage through the gap of the cells, and [micro] has "
                "leakage = false; leave out one of them"
            )
        return
    if case.cell.mesh is not None:
        yield (
            "leakage in [micro] needs the gap above a surface, and mesh in [cell] may overhang "
            "or have pores; leave out one of them"
        )


def _coarser_faults(case: "Case") -> Iterator[str]:
    """Report cells that half of the points cannot resolve."""
    if not case.micro.coarser:
        return
    shear = case.micro.shear
    grids = {case.cell.points, (shear and shear.points) or case.cell.points}
    for points in sorted(grids):
        if any(n % 4 for n in points):
            yield (
                f"coarser in [micro] halves the points, and half of them should be even, got "
                f"{points[0]} x {points[1]}; give multiples of 4"
            )
        spacing = 2.0 * max(map(truediv, case.cell.size, points))
        for number, body in enumerate(case.bodies, start=1):
            if body.surface is None:
                continue
            cutoff = body.surface.short_cutoff
            if cutoff is None or cutoff <= 2.0 * spacing * (1.0 + 1e-9):
                yield (
                    f"coarser in [micro] leaves {1e6 * spacing:.4g} um between points, and the "
                    f"same surface needs a short_cutoff of body_{number} of more than twice "
                    f"that; give a longer cut-off, or more points"
                )


def _metal_faults(case: "Case") -> Iterator[str]:
    flat = case.cell.geometry == "flat"
    for number, body in enumerate(case.bodies, start=1):
        if flat and body.hardening_modulus is not None:
            yield (
                f"hardening_modulus of body_{number} has no effect in flat cells, which limit "
                f'the pressure; set geometry = "conforming" in [cell], or leave it out'
            )
        parts: tuple[RoughBody | CoatingSettings, ...] = (body, *body.coating)
        for material in parts:
            ratio = (material.hardness or 0.0) / material.youngs_modulus
            where = f"body_{number}" if material is body else f"a coating of body_{number}"
            if ratio > HARDEST:
                yield (
                    f"hardness of {where} is {1e-9 * (material.hardness or 0.0):g} GPa, "
                    f"{ratio:.2g} of its youngs_modulus, and no solid has more than "
                    f"{HARDEST:g}; the hardness of a metal is about a hundredth, and an "
                    f"elastic body needs no hardness"
                )
    if case.elastic and case.hardness is not None:
        yield "elastic = true and a hardness exclude each other; leave one out"
    if case.micro.unload is not False and (flat or case.hardness is None):
        yield (
            "unload in [micro] needs conforming cells and the hardness of a body: without "
            "flow an interface unloads as it was loaded"
        )


def _coating_faults(case: "Case") -> Iterator[str]:
    if not case.coated:
        return
    if case.cell.geometry == "mesh":
        yield (
            "cells on meshes take their layers from named volumes, and a body has coatings; "
            'leave them out, or set geometry = "flat" or "conforming" in [cell]'
        )
    hard = any(body.hardness or body.surface_hardness for body in case.bodies)
    if case.cell.geometry != "flat" and hard:
        yield (
            "conforming cells that flow are of one material, and there are coatings and a "
            'hardness; set geometry = "flat" in [cell], or leave out one of them'
        )
    if case.cell.slope_order != 1:
        yield (
            "slope_order = 2 is derived for bodies of one material, and a body has coatings; "
            "leave out one of them"
        )
    if case.slide is not None:
        yield "[slide] moves bodies of one material, and a body has coatings; leave out one"
    joint = case.interface
    by_theory = isinstance(joint, RoughInterface) and joint.stiffness_ratio is None
    if by_theory and case.micro.shear is None:
        yield (
            "the stiffness_ratio of theory is derived for bodies of one material, and a body "
            "has coatings; shear the cells by [micro.shear], or give stiffness_ratio in "
            "[interface]"
        )


def _conductivity_faults(case: "Case") -> Iterator[str]:
    """Report a conductivity of a single body, and of bodies with coatings."""
    for name in CONDUCTIVITIES:
        given = [k for k, body in enumerate(case.bodies, 1) if getattr(body, name) is not None]
        if len(given) == 1:
            yield f"body_{given[0]} has the {name} that body_{3 - given[0]} lacks; give both"
        if given and case.coated:
            yield (
                f"the conductance of an interface is derived for bodies of one material, and a "
                f"body has coatings; leave out the coatings or {name}"
            )
