"""From a case to its cells: surfaces of both bodies, and one elastic body that stands for both."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import read_surface
from multiscale.laws.bulk import J2, Elastic, NeoHookean
from multiscale.laws.bulk.moduli import contact_modulus
from multiscale.micro import FiniteCell, SecondBody
from multiscale.micro.cell import AnyCell, CellSides, MeshCell
from multiscale.micro.cell_maker import Cell
from multiscale.micro.mesh.file_cell import cell_from_file
from multiscale.micro.mesh.graph_elements import ElementKind, graph_mesh_cell
from multiscale.pipeline.case_tables import CellSettings
from multiscale.pipeline.rough_bodies import InstrumentSurface
from multiscale.pipeline.settings import Case
from multiscale.pipeline.windows import Measured, cut_windows
from multiscale.surfaces import composite, self_affine
from multiscale.surfaces.surface import Surface

__all__ = [
    "RoughSide",
    "cell_of",
    "composite_material",
    "longest_wave",
    "make_cells",
    "make_surfaces",
    "measured_cells",
    "rough_sides",
    "smooth_pair",
    "two_bodies",
    "two_surfaces",
]


@dataclass(frozen=True, eq=False)
class RoughSide:
    """Realisations of one body's surface, none if it is smooth, and their share of a map."""

    surfaces: list[Surface]
    measured: Measured | None = None


def composite_material(case: Case) -> tuple[float, float]:
    r"""Young's modulus, Pa, and Poisson's ratio of the body that stands for both.

    Its contact modulus belongs to the pair, :math:`1/E^* = \sum (1-\nu_i^2)/E_i`. For small slopes
    and without friction nothing else of the elastic constants enters; Poisson's ratio is the mean
    weighted by compliance.
    """
    return _composite(*((body.youngs_modulus, body.poissons_ratio) for body in case.bodies))


def _composite(*pair: tuple[float, float]) -> tuple[float, float]:
    """Young's modulus, Pa, and Poisson's ratio of the body that stands for two."""
    compliance = [(1.0 - nu**2) / modulus for modulus, nu in pair]
    nu = float(np.average([nu for _, nu in pair], weights=compliance))
    return contact_modulus(*pair) * (1.0 - nu**2), nu


def longest_wave(case: Case) -> float:
    """Longest wavelength of the roughness of both bodies, m; the cell for a map or a mesh."""
    synthetic = [
        body.surface.long_cutoff
        for body in case.bodies
        if body.surface is not None and not isinstance(body.surface, InstrumentSurface)
    ]
    measured = any(isinstance(body.surface, InstrumentSurface) for body in case.bodies)
    whole = measured or case.cell.mesh is not None
    return max([*synthetic, *([max(case.cell.size)] if whole else [])])


def make_cells(case: Case) -> list[AnyCell]:
    """Build the cell of each realisation.

    Raises
    ------
    CaseError
        If a surface cannot be made or read, or a map has too few windows.
    """
    return measured_cells(case)[0]


def make_surfaces(case: Case) -> list[Surface]:
    """Make the composite surface of each realisation.

    Raises
    ------
    CaseError
        As :func:`make_cells`.
    """
    rough = [side.surfaces for side in rough_sides(case) if side.surfaces]
    return [pair[0] if len(pair) == 1 else composite(*pair) for pair in zip(*rough, strict=True)]


def measured_cells(case: Case) -> tuple[list[AnyCell], dict[str, Measured]]:
    """Build the cell of each realisation, and say of each measured body what the cells hold of it.

    Raises
    ------
    CaseError
        As :func:`make_cells`.
    """
    if case.cell.mesh is not None:
        return [_mesh_of_file(case, case.cell.mesh)], {}
    sides = {f"body_{k}": side for k, side in enumerate(rough_sides(case), 1)}
    rough = [side.surfaces for side in sides.values() if side.surfaces]
    cells = [
        cell_of(case, pair[0] if len(pair) == 1 else composite(*pair))
        for pair in zip(*rough, strict=True)
    ]
    return cells, {name: side.measured for name, side in sides.items() if side.measured is not None}


def cell_of(case: Case, surface: Surface) -> AnyCell:
    """Build the cell of a case under one composite surface; a mesh from a file has its own."""
    if case.cell.mesh is not None:
        return _mesh_of_file(case, case.cell.mesh)
    material, depth = composite_material(case), case.cell.depth or max(case.cell.size)
    if case.cell.geometry == "mesh":
        element, sides = _elements(case.cell)
        law, layers = Elastic(*material), case.cell.layers
        return graph_mesh_cell(surface, depth, layers, law, element, sides=sides)
    flat = case.cell.geometry == "flat"
    bulk = None  # elastic
    if case.softer is not None and case.yield_stress is not None:
        bulk = J2(*material, case.yield_stress, case.softer.hardening_modulus or 0.0)
    return Cell(
        surface,
        depth,
        case.cell.layers,
        *material,
        geometry=case.cell.geometry,
        hardness=case.hardness if flat else None,
        bulk=bulk,
    )


def _elements(cell: CellSettings) -> tuple[ElementKind, CellSides]:
    return ElementKind(cell.element or "hex8"), CellSides(cell.sides or "periodic")


def _mesh_of_file(case: Case, path: Path) -> MeshCell:
    """Build the cell on the mesh of a file; the moduli of its volumes stand for both bodies."""
    settings, other = case.cell, (case.body_2.youngs_modulus, case.body_2.poissons_ratio)
    volumes = {
        name: Elastic(*_composite((one.youngs_modulus, one.poissons_ratio), other))
        for name, one in (settings.volumes or {}).items()
    }
    element, sides = _elements(settings)
    cell = cell_from_file(
        path,
        Elastic(*composite_material(case)),
        element,
        scale=settings.unit or 1.0,
        volumes=volumes,
        contact=settings.contact_face or "top",
        base=settings.base_face or "bottom",
        sides=sides,
        points=settings.points,
    )
    size = np.ptp(cell.mesh.p, axis=1)[:2]
    if not np.allclose(size, settings.size, rtol=1e-6, atol=0.0):
        raise CaseError(
            f"{path} measures {size[0]:.6g} m x {size[1]:.6g} m along x and y, and size in [cell] "
            f"is {settings.size[0]:.6g} m x {settings.size[1]:.6g} m; correct size or unit"
        )
    return cell


def rough_sides(case: Case) -> list[RoughSide]:
    """Make the surfaces of both bodies; a map that both share is read once.

    Raises
    ------
    CaseError
        As :func:`make_cells`.
    """
    count, seed = case.micro.realisations, case.micro.seed
    settings = [body.surface for body in case.bodies]
    files = [one.file.resolve() for one in settings if isinstance(one, InstrumentSurface)]
    maps: dict[tuple[Any, ...], Surface] = {}
    sides = []
    for side, one in enumerate(settings):
        try:
            if one is None:
                sides.append(RoughSide([]))
            elif isinstance(one, InstrumentSurface):
                # two sides of one map take turns, so that more realisations change none
                shared = files.count(one.file.resolve()) == 2
                which = range(side, 2 * count, 2) if shared else range(count)
                needed = 2 * count if shared else count
                order, fill = one.detrend_order, one.fill_undefined
                key = (one.file.resolve(), order, fill)
                if key not in maps:
                    maps[key] = read_surface(one.file, detrend_order=order, fill_undefined=fill)
                pieces, record = cut_windows(maps[key], one, case.cell, which, needed, seed)
                if side == 1:  # measured from outside: turned over as paper is
                    pieces = [Surface(piece.heights[::-1], piece.size) for piece in pieces]
                sides.append(RoughSide(pieces, record))
            else:  # the two sides are independent
                grid, given = (case.cell.points, case.cell.size), one.model_dump()
                seeds = range(2 * seed + side, 2 * (seed + count), 2)
                sides.append(RoughSide([self_affine(*grid, k, **given) for k in seeds]))
        except CaseError as error:
            raise CaseError(f"[body_{side + 1}.surface] {error}") from error
    return sides


def two_surfaces(case: Case) -> list[tuple[Surface, Surface]]:
    """Make the surfaces of both bodies of each realisation, heights out of each body.

    Raises
    ------
    CaseError
        As :func:`make_cells`.
    """
    smooth = [Surface(np.zeros(case.cell.points), case.cell.size)] * case.micro.realisations
    lower, upper = (side.surfaces or smooth for side in rough_sides(case))
    return list(zip(lower, upper, strict=True))


def smooth_pair(cell: CellSettings) -> tuple[Surface, Surface]:
    """Return smooth surfaces of both bodies, which tell what a cell needs."""
    smooth = Surface(np.zeros(cell.points), cell.size)
    return smooth, smooth


def two_bodies(
    cell: CellSettings,
    surfaces: tuple[Surface, Surface],
    laws: tuple[Elastic | NeoHookean | J2, Elastic | NeoHookean | J2],
    friction_coefficient: float,
) -> FiniteCell:
    """Build the cell of two deformable bodies under their surfaces, heights out of each body."""
    depth = cell.depth if cell.depth is not None else max(cell.size)
    (lower, upper), (law, other) = surfaces, laws
    return FiniteCell(
        lower,
        depth,
        cell.layers,
        law,
        obstacle=Surface(-upper.heights, upper.size),
        friction_coefficient=friction_coefficient,
        second=SecondBody(depth, cell.layers, other),
    )
