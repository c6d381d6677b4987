"""From a case to its cells: surfaces, one elastic body for both, and the error budget."""

from collections.abc import Mapping
from itertools import pairwise
from os.path import realpath
from pathlib import Path

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk import J2, Elastic, NeoHookean
from multiscale.laws.bulk.bulk_law import contact_modulus
from multiscale.micro import Coating, FiniteCell, FlatCell, SecondBody
from multiscale.micro.cell import AnyCell, Cell, GridCell
from multiscale.micro.mesh.mesh_cell import CellSides, MeshCell
from multiscale.micro.mesh.meshing import ElementKind, cell_from_file, graph_mesh_cell
from multiscale.pipeline.measured_sides import Measured, RoughSide, measured_map, measured_side
from multiscale.pipeline.tables.case_tables import CellSettings
from multiscale.pipeline.tables.rough_bodies import InstrumentSurface, SyntheticSurface
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import Dataset
from multiscale.surfaces import composite, self_affine
from multiscale.surfaces.surface import Surface
from multiscale.upscaling import error_budget
from multiscale.upscaling.budget import how_attribute
from multiscale.upscaling.sampling import FEWEST_REALISATIONS
from multiscale.upscaling.scales import ScaleSeparation, compare_scales

ALIKE = 1e-3  # relative error of the compliance of a mode below which a single body replaces both


def composite_material(case: Case) -> tuple[float, float]:
    """Young's modulus, Pa, and Poisson's ratio of the composite body, without coatings."""
    # 1/E* = sum (1 - nu²)/E is of the pair; nu, the mean by compliance, does not matter at small
    # slopes
    return _composite(*((body.youngs_modulus, body.poissons_ratio) for body in case.bodies))


def surface_modulus(case: Case) -> float:
    """Contact modulus of the outermost layers of both bodies, Pa."""
    return contact_modulus(*(body.moduli[0] for body in case.bodies))


def _composite(*pair: tuple[float, float]) -> tuple[float, float]:
    compliance = [(1.0 - nu**2) / modulus for modulus, nu in pair]
    nu = float(np.average([nu for _, nu in pair], weights=compliance))
    return contact_modulus(*pair) * (1.0 - nu**2), nu


def longest_wave(case: Case) -> float:
    """Longest wavelength of the roughness of both bodies, m; the cell for a map or a mesh."""
    surfaces = [body.surface for body in case.bodies]
    wavelengths = [
        surface.longest_wave for surface in surfaces if isinstance(surface, SyntheticSurface)
    ]
    if case.from_maps or case.cell.mesh is not None:
        wavelengths.append(max(case.cell.size))
    return max(wavelengths)


def make_cells(case: Case) -> list[AnyCell]:
    """Build the cell of each realisation.

    Raises
    ------
    CaseError
        If a surface cannot be made or read, or a map has too few windows.
    """
    return measured_cells(case)[0]


def make_surfaces(case: Case) -> list[Surface]:
    """Return the composite surface of each realisation."""
    return _composites(rough_sides(case))


def _composites(sides: list[RoughSide]) -> list[Surface]:
    rough = [side.surfaces for side in sides if side.surfaces]
    return [pair[0] if len(pair) == 1 else composite(*pair) for pair in zip(*rough, strict=True)]


def try_cells(case: Case) -> None:
    """Refuse cells that cannot be built, by building the first, and maps with too few windows."""
    measured_cells(case, made=1)


def measured_cells(
    case: Case, *, made: int | None = None
) -> tuple[list[AnyCell], dict[str, Measured]]:
    """Build the cell of each realisation, and describe the roughness of each measured body."""
    if case.cell.mesh is not None:
        return [_mesh_of_file(case, case.cell.mesh)], {}
    sides = {f"body_{k}": side for k, side in enumerate(rough_sides(case, made=made), 1)}
    cells: list[AnyCell]
    if case.cell.slope_order == 2:  # the slopes of each body enter separately
        cells = [flat_pair(case, *pair) for pair in _pairs(case, list(sides.values()))]
    else:
        surfaces = _composites(list(sides.values()))
        cells = [cell_of(case, surface, k) for k, surface in enumerate(surfaces)]
    return cells, {name: side.measured for name, side in sides.items() if side.measured is not None}


def cell_of(case: Case, surface: Surface, realisation: int = 0) -> AnyCell:
    """Build the cell of a case under a composite surface, or on the mesh of a file."""
    if case.cell.mesh is not None:
        return _mesh_of_file(case, case.cell.mesh)
    if case.cell.geometry == "mesh":
        element, sides = _elements(case.cell)
        law, depth = _metal(case) or Elastic(*composite_material(case)), case.cell.given_depth
        drawn = (*case.cell.size, depth), case.micro.seed + realisation
        pores = case.cell.pores.draw(*drawn) if case.cell.pores else None
        return graph_mesh_cell(
            surface, depth, case.cell.layers, law, element, sides=sides, pores=pores
        )
    return _grid_cell(case, surface)


def _grid_cell(case: Case, surface: Surface) -> GridCell:
    flat = case.cell.geometry == "flat"
    if flat and (case.coated or case.cell.slope_order == 2):
        return flat_pair(case, surface)
    return Cell(
        surface,
        case.cell.given_depth,
        case.cell.layers,
        *composite_material(case),
        geometry="flat" if flat else "conforming",
        hardness=case.hardness if flat else None,
        bulk=_metal(case),
        coating=composite_coating(case),
    )


def _metal(case: Case) -> J2 | None:
    """Law of the composite body, if it flows."""
    if case.softer is None or case.yield_stress is None:
        return None
    hardening = case.softer.hardening_modulus or 0.0
    return J2(*composite_material(case), case.yield_stress, hardening)


def flat_pair(
    case: Case, surface: Surface, opposite: Surface | None = None, *, depth: float | None = None
) -> FlatCell:
    """Build the flat cell of both bodies; their compliances add up exactly."""
    depth, layers = depth or case.cell.given_depth, case.cell.layers
    lower, upper = (
        SecondBody(depth, layers, Elastic(body.youngs_modulus, body.poissons_ratio), body.stack)
        for body in case.bodies
    )
    return FlatCell(
        surface,
        depth,
        layers,
        lower.law,
        obstacle=None if opposite is None else Surface(-opposite.heights, opposite.size),
        hardness=case.hardness,
        slope_order=case.cell.slope_order,
        second=upper,
        coating=lower.coating,
    )


def flat_bodies(case: Case) -> FlatCell:
    """Build the flat cell of half-spaces below their coatings, in the first realisation."""
    bare = case.without_coatings()
    depth = case.cell.given_depth if case.cell.geometry == "flat" else max(case.cell.size)
    return flat_pair(bare, *two_surfaces(bare)[0], depth=depth)


def flat_composite(case: Case) -> FlatCell:
    """Build the flat cell of the composite body, as :func:`flat_bodies`."""
    surface = composite(*two_surfaces(case)[0])
    return FlatCell(surface, max(case.cell.size), 2, Elastic(*composite_material(case)))


def composite_coating(case: Case) -> tuple[Coating, ...]:
    """Coatings of the composite body: at each depth the composite of both materials."""
    below = [np.cumsum([0.0, *(layer.thickness for layer in body.coating)]) for body in case.bodies]
    faces = np.unique(np.concatenate(below))
    coatings = []
    for top, bottom in pairwise(faces):
        middle = 0.5 * (top + bottom)
        pair = [
            body.moduli[int(np.searchsorted(tops, middle)) - 1]
            for body, tops in zip(case.bodies, below, strict=True)
        ]
        coatings.append(Coating(float(bottom - top), *_composite(*pair)))
    return tuple(coatings)


def coating_caution(case: Case) -> list[str]:
    """Report the error of the compliance of a single coated body; flat cells add both bodies."""
    from multiscale.micro.elastic.elastic_cells import flat_compliance

    if not case.coated or case.cell.geometry == "flat":
        return []
    n = max(case.cell.points)
    line = Surface(np.zeros((n, 1)), (max(case.cell.size), case.cell.spacing))
    single, pair = _grid_cell(case, line), flat_pair(case, line)
    composite_cell = FlatCell(line, single.depth, single.layers, single.law, coating=single.coating)
    approximate, exact = (flat_compliance(cell)[1:, 0] for cell in (composite_cell, pair))
    error = float(np.max(np.abs(approximate / exact - 1.0)))
    cautions = single.element_cautions()
    if error <= ALIKE:
        return cautions
    return [
        *cautions,
        f"a single coated body replaces both, with an error of its compliance of up to "
        f'{100.0 * error:.2g} %; geometry = "flat" in [cell] adds the compliances of both',
    ]


def _elements(cell: CellSettings) -> tuple[ElementKind, CellSides]:
    return ElementKind(cell.element or "hex8"), CellSides(cell.sides or "periodic")


def _mesh_of_file(case: Case, path: Path) -> MeshCell:
    """Build the cell on the mesh of a file; its volumes have composite moduli with body 2."""
    settings, other = case.cell, (case.body_2.youngs_modulus, case.body_2.poissons_ratio)
    volumes = {
        name: Elastic(*_composite((volume.youngs_modulus, volume.poissons_ratio), other))
        for name, volume in (settings.volumes or {}).items()
    }
    element, sides = _elements(settings)
    cell = cell_from_file(
        path,
        _metal(case) or Elastic(*composite_material(case)),
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


def rough_sides(case: Case, *, made: int | None = None) -> list[RoughSide]:
    """Build the surfaces of both bodies, or the first ``made``; a map of both is read once."""
    count, seed = case.micro.realisations, case.micro.seed
    settings = [body.surface for body in case.bodies]
    files = [realpath(table.file) for table in settings if isinstance(table, InstrumentSurface)]
    maps: dict[str, tuple[Surface, list[str]]] = {}
    sides = []
    for side, table in enumerate(settings):
        try:
            if table is None:
                sides.append(RoughSide([]))
            elif isinstance(table, InstrumentSurface):
                # two sides of one map take turns, so that more realisations change none
                shared = files.count(realpath(table.file)) == 2
                which = range(side, 2 * count, 2) if shared else range(count)
                needed = 2 * count if shared else count
                key = table.checksum(exclude={"filled", "periodic", "short_cutoff"})
                if key not in maps:
                    maps[key] = measured_map(table)
                whole, cautions = maps[key]
                made_of = measured_side(
                    whole,
                    table,
                    case.cell,
                    which[:made],
                    needed,
                    seed,
                    side=side,
                    other_map=len(files) == 2 and not shared,
                )
                sides.append(made_of.with_cautions(cautions))
            else:  # the two sides are independent
                grid = (case.cell.points, case.cell.size)
                seeds = range(2 * seed + side, 2 * (seed + count), 2)
                sides.append(
                    RoughSide([self_affine(*grid, k, **table.options) for k in seeds[:made]])
                )
        except CaseError as error:
            raise CaseError(f"[body_{side + 1}.surface] {error}") from error
    return sides


def two_surfaces(case: Case) -> list[tuple[Surface, Surface]]:
    """Return the surfaces of both bodies of each realisation, heights out of each body."""
    return _pairs(case, rough_sides(case))


def _pairs(case: Case, sides: list[RoughSide]) -> list[tuple[Surface, Surface]]:
    number = max(len(side.surfaces) for side in sides)
    smooth = [Surface(np.zeros(case.cell.points), case.cell.size)] * number
    lower, upper = (side.surfaces or smooth for side in sides)
    return list(zip(lower, upper, strict=True))


def smooth_pair(cell: CellSettings) -> tuple[Surface, Surface]:
    """Return smooth surfaces of both bodies, from which the needs of a cell are computed."""
    smooth = Surface(np.zeros(cell.points), cell.size)
    return smooth, smooth


def two_bodies(
    cell: CellSettings,
    surfaces: tuple[Surface, Surface],
    laws: tuple[Elastic | NeoHookean | J2, Elastic | NeoHookean | J2],
    friction_coefficient: float,
    coatings: tuple[tuple[Coating, ...], tuple[Coating, ...]] = ((), ()),
) -> FiniteCell:
    """Build the cell of two deformable bodies under their surfaces, heights out of each body."""
    depth = cell.given_depth
    (lower, upper), (law, other) = surfaces, laws
    return FiniteCell(
        lower,
        depth,
        cell.layers,
        law,
        obstacle=Surface(-upper.heights, upper.size),
        friction_coefficient=friction_coefficient,
        second=SecondBody(depth, cell.layers, other, coatings[1]),
        coating=coatings[0],
    )


def joint_scales(case: Case) -> ScaleSeparation | None:
    """Compare the scales of cells and interface; None if the pressure is not even."""
    if case.interface_width is None:
        return None
    return compare_scales(longest_wave(case), max(case.cell.size), case.interface_width)


def case_budget(
    case: Case,
    response: Dataset,
    law: Dataset,
    pressed: Mapping[float, Dataset] = {},
    sheared: Mapping[float, Dataset] = {},
    control: Dataset | None = None,
) -> Dataset:
    """Estimate the errors of the law, with cells and sheared laws by the ratio of spacings."""
    budget = error_budget(
        response,
        law,
        resolutions=pressed,
        scales=joint_scales(case),
        tangential=None if case.micro.shear is None else sheared,
        control=control,
        discrepancy=case.law.discrepancy,
    )
    reasons = {
        "sampling": f"a single realisation has no scatter; give realisations = "
        f"{FEWEST_REALISATIONS} or more in [micro]",
        "cell size": "cells of one size were solved; a target in [accuracy] solves others",
        "micro discretisation": "cells on one grid were solved; give coarser = 1 in [micro], "
        "which --quick leaves out",
        "scale separation": "it depends on the pressure of the structure, which is not part of a "
        "law",
    }
    unknown = str(budget.attrs["unknown"]).split(", ")
    return budget.assign_attrs(
        {how_attribute(term): f"not known: {reasons[term]}" for term in reasons if term in unknown}
    )
