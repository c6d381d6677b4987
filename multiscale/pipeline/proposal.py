"""A case for measured surfaces: cells that fit into the maps, and a structure under a preload."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, floor, pi, sqrt
from pathlib import Path

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk.bulk_law import contact_modulus
from multiscale.pipeline.case import validate_case
from multiscale.pipeline.measured_sides import Measured, measured_side
from multiscale.pipeline.tables.case_tables import POINTS_PER_WAVE, CellSettings
from multiscale.pipeline.tables.rough_bodies import InstrumentSurface
from multiscale.surfaces import Surface
from multiscale.surfaces.fourier import Spectrum
from multiscale.units import readable, to_si

MOST_POINTS = 256  # of flat cells, along an edge
SLOPE_HELD = 0.95
REALISATIONS = (4, 3, 2, 1)
SMALLER, MOST_SHRINKS = 0.85, 12  # until there are windows of few filled points
STEEL = (210e9, 0.3)
LOADS = np.geomspace(0.004, 0.12, 8)  # of contact modulus times slope: contact of 1 to 20 %
FRICTION, FRICTION_ERROR = 0.2, 0.25  # of points of contact, and its half-width over it
BOLTS = (4, 5, 6, 8, 10, 12, 14, 16, 20, 24, 30, 36, 42, 48)  # mm, diameters of shanks
BOLT_STRESS = 450e6  # Pa, of a shank under its preload
SLIDING = 0.3  # share of the sliding load of the full preload, for cycles at half of it and more
HARDNESS = 1e9  # Pa, of soft steel, about three times its yield stress
EXAMPLES = {"N": "kN", "Pa": "MPa"}  # prefixed units of preloads
PRELOADS = (0.5, 1.0)  # shares of the preload
ROOM = (0.25, 2.0)  # of pressures of the cells below and above the pressures of the interface


@dataclass(frozen=True, eq=False)
class MeasuredFace:
    """A measured face: its map, the keys of its table, its spectrum and reliable wavelengths."""

    whole: Surface
    settings: InstrumentSurface
    spectrum: Spectrum
    reliable: tuple[float, float]

    @property
    def finest(self) -> float:
        """Shortest wavelength that the cells need, m."""
        return max(self.reliable[0], self.spectrum.cutoff_holding(SLOPE_HELD, order=2))


@dataclass(frozen=True, eq=False)
class Proposal:
    """A case for measured surfaces."""

    text: str  # the case, a TOML file
    measured: Sequence[Measured]  # roughness of each map and of its cells

    def shares(self, face: int) -> tuple[float, float]:
        """Return the shares of the rms height and slope of a map that its cells hold."""
        whole, cells = self.measured[face].stages[0], self.measured[face].stages[2]
        return cells.rms_height / whole.rms_height, cells.rms_slope / whole.rms_slope


def propose_case(faces: Sequence[MeasuredFace], further: str = "") -> Proposal:
    """Propose cells that hold the heights and slopes of faces; see :func:`write_structure`."""
    if any(not face.reliable[0] < face.reliable[1] for face in faces):
        raise CaseError("the map has too few points for any reliable wavelength")
    coarse = max(faces, key=lambda face: face.finest)
    small = min(faces, key=lambda face: max(face.whole.size))
    if coarse.finest > max(small.whole.size):
        raise CaseError(
            f"{coarse.settings.file.name} has no reliable wavelength below "
            f"{readable(f'{coarse.finest:.3g} m')}, and {small.settings.file.name} measures "
            f"{readable(f'{max(small.whole.size):.3g} m')}; measure both faces over similar lengths"
        )
    shared = len({face.settings.file for face in faces}) < len(faces)  # windows of one map
    refusal = CaseError("the map has no rough window")
    for count in REALISATIONS:
        sizes = _common_sizes(faces, count * (1 + shared))

        def least_share(size: float) -> float:
            grid = POINTS_PER_WAVE * size / MOST_POINTS
            return min(
                face.spectrum.share(size, max(face.finest, grid), order=order)
                for face in faces
                for order in (0, 2)
            )

        size = max(sizes, key=least_share)
        filled = any(face.whole.filled_share for face in faces)
        for _ in range(MOST_SHRINKS if filled else 1):
            tables, cell = _cells(faces, size)
            try:
                measured = _measure(faces, tables, cell, count, shared)
            except CaseError as error:
                refusal = error
                size *= SMALLER
                continue
            return _write(tables, cell, count, measured, further)
    raise refusal


def _measure(
    faces: Sequence[MeasuredFace],
    tables: Sequence[InstrumentSurface],
    cell: CellSettings,
    count: int,
    shared: bool,
) -> list[Measured]:
    """Cut the windows of the faces, and measure their roughness; see ``rough_sides``."""
    results = []
    for side, (face, table) in enumerate(zip(faces, tables, strict=True)):
        which = range(side, 2 * count, 2) if shared else range(count)
        needed = count * (1 + shared)
        made = measured_side(
            *(face.whole, table, cell, which, needed, 0),
            side=side,
            of_map=face.spectrum,
            other_map=len(faces) == 2 and not shared,
        )
        assert made.measured is not None
        results.append(made.measured)
    return results


def _common_sizes(faces: Sequence[MeasuredFace], count: int) -> list[float]:
    """Sizes of cells with enough windows in the maps of all faces."""
    sizes = [
        [
            (1.0 if face.settings.profile == "isotropic" else 2.0) * edge
            for edge in _edges(face.whole, count)
        ]
        for face in faces
    ]
    if not all(sizes):
        return [min(min(face.whole.size) for face in faces)]
    most = min(map(max, sizes))
    return [size for size in min(sizes, key=max) if size <= most]


def _edges(whole: Surface, count: int) -> list[float]:
    """Edges of square windows that fit often enough into a map, or of sections of a line scan."""
    profile = whole.heights.shape[1] == 1
    room = whole.size[0] if profile else min(whole.size)
    edges = room / np.geomspace(1.0, 32.0, 16) * (1.0 - 1e-4)
    return [
        float(edge)
        for edge in edges
        if profile or floor(whole.size[0] / edge) * floor(whole.size[1] / edge) >= count
    ]


def _cells(
    faces: Sequence[MeasuredFace], size: float
) -> tuple[list[InstrumentSurface], CellSettings]:
    """Choose the grid of cells of a size, and the cut-off of each face."""
    size = float(f"{size:.4g}")  # as in the file
    finest = min(face.finest for face in faces)
    n = min(MOST_POINTS, 2 * max(8, ceil(0.5 * POINTS_PER_WAVE * size / finest)))
    given = {"size": [f"{size!r} m"] * 2, "points": [n, n], "geometry": "flat"}
    tables = []
    for face in faces:
        cutoff = float(f"{max(face.finest, POINTS_PER_WAVE * size / n) * 1.0005:.4g}")
        tables.append(face.settings.model_copy(update={"short_cutoff": cutoff}))
    return tables, CellSettings.model_validate(given)


def _write(
    tables: Sequence[InstrumentSurface],
    cell: CellSettings,
    count: int,
    measured: Sequence[Measured],
    further: str,
) -> Proposal:
    """Write the case file of chosen cells, under pressures of the structure or of their slope."""
    slope = sqrt(sum(each.stages[2].rms_slope ** 2 for each in measured))
    pressures = contact_modulus(STEEL, STEEL) * slope * LOADS

    def write(pressures: np.ndarray) -> str:
        listed = ", ".join(f'"{float(f"{1e-6 * p:.2g}"):g} MPa"' for p in pressures)
        bodies = [_body(k, tables[k - 1 : k]) for k in (1, 2)]
        smooth = " and the smooth second body" * (len(tables) == 1)
        drawing = ", materials and dimensions" if further else ", materials"
        return f"""\
# Proposed by multiscale inspect; assumptions{drawing.replace(",", ":", 1)}{smooth}.
title = {_text(" on ".join(table.file.name for table in tables))}

{bodies[0]}
{bodies[1]}
[cell]
size = [{_length(cell.size[0])}, {_length(cell.size[1])}]
points = [{cell.points[0]}, {cell.points[1]}]
geometry = "flat"

[micro]
realisations = {count}
pressures = [{listed}]
{further}"""

    if further:  # the case extrapolates, until its loads are known
        draft = tomllib.loads(write(pressures)) | {"law": {"extrapolate": True}}
        case = validate_case(draft, Path("proposed.toml"))
        assert case.structure is not None  # as the further tables have one
        (pressed,) = case.structure.pressed(case)
        ends = min(low for low, _ in pressed.steps), max(high for _, high in pressed.steps)
        pressures = np.geomspace(ROOM[0] * ends[0], ROOM[1] * ends[1], len(LOADS))
    return Proposal(write(pressures), measured)


def _body(number: int, tables: Sequence[InstrumentSurface]) -> str:
    lines = [f"[body_{number}]", 'youngs_modulus = "210 GPa"', "poissons_ratio = 0.3", ""]
    for table in tables:
        lines += [f"[body_{number}.surface]", _table(table)]
    return "\n".join(lines)


def write_structure(kind: str, preload: str) -> str:
    """Write the tables of blocks, or of a lap joint, under a preload, with usual dimensions."""
    if kind == "blocks":
        return _blocks(preload)
    force = _positive(preload, {"N": 1.0})
    least = 1e3 * sqrt(4.0 * force / (pi * BOLT_STRESS))
    shank = next((bolt for bolt in BOLTS if bolt >= least), 0)
    if not shank:
        raise CaseError(
            f"--preload {preload}: no bolt of up to {BOLTS[-1]} mm carries this force; give a "
            f"smaller one"
        )
    hole, washer = shank + 1, 2 * shank + 2
    pressure = 1e6 * force / (pi / 4.0 * (washer**2 - hole**2))  # under the washer, Pa
    shear = SLIDING * FRICTION * 1e6 * force / (5 * shank**2)  # on the end of a plate, Pa
    return f"""
[structure]
kind = "lap_joint"
length = "{12.5 * shank:g} mm"
width = "{5 * shank} mm"
thickness = "{shank} mm"
overlap = "{5 * shank} mm"
hole = "{hole} mm"
washer = "{washer} mm"
bolt = "{shank} mm"              # shank, of {1e-3 * force:g} kN
element = "{0.25 * shank:g} mm"
youngs_modulus = "210 GPa"
poissons_ratio = 0.3

[interface]
friction = "{FRICTION:g} +- {100 * FRICTION_ERROR:g} %"       # assumptions, both
stiffness_ratio = 0.82

[statics]
preloads = [{_listed(pressure)}]   # under the washers: {_shares(force)} kN

[cycles]
shear = "{1e-6 * shear:.2g} MPa"   # on the end of the upper plate: {SLIDING:g} of sliding
cycles = 2
steps = 8
"""


def _blocks(preload: str) -> str:
    """Write the tables of two blocks of 10 x 10 x 5 mm under a force, or a pressure."""
    pressure = _positive(preload, {"N": 1e-4, "Pa": 1.0})
    if pressure > HARDNESS:
        raise CaseError(
            f"--preload {preload}: blocks of 10 x 10 mm have {1e-9 * pressure:.3g} GPa on their "
            f"faces, above {1e-9 * HARDNESS:g} GPa, the hardness of soft steel; reduce the force"
        )
    return f"""
[structure]
kind = "blocks"
height = "5 mm"
width = "10 mm"

[statics]
preloads = [{_listed(pressure)}]
"""


def _positive(text: str, areas: Mapping[str, float]) -> float:
    """Read a positive quantity in one of several units, over the area of its unit."""
    examples = " or ".join(f'"20 {EXAMPLES[unit]}"' for unit in areas)
    for unit, area in areas.items():
        try:
            value = to_si(text, unit) / area
        except CaseError:
            continue
        if 0.0 < value < np.inf:
            return value
    raise CaseError(f"--preload {text}: must be positive with its unit, such as {examples}")


def _listed(pressure: float) -> str:
    return ", ".join(f'"{1e-6 * share * pressure:.4g} MPa"' for share in PRELOADS)


def _shares(force: float) -> str:
    return " and ".join(f"{1e-3 * share * force:.4g}" for share in PRELOADS)


def _table(settings: InstrumentSurface) -> str:
    lines = [f"file = {_text(str(settings.file))}"]
    if settings.channel is not None:
        named = settings.channel
        lines.append(f"channel = {named if isinstance(named, int) else _text(named)}")
    if settings.size is not None:
        lines.append(f"size = [{', '.join(_length(edge) for edge in settings.size)}]")
    if settings.unit is not None:
        lines.append(f"unit = {_length(settings.unit)}")
    if settings.detrend_order != InstrumentSurface.model_fields["detrend_order"].default:
        lines.append(f"detrend_order = {settings.detrend_order}")
    if settings.fill_undefined:
        lines.append("fill_undefined = true")
    if settings.spikes == "remove":
        lines.append('spikes = "remove"')
    if settings.profile is not None:
        lines.append(f'profile = "{settings.profile}"')
    if settings.short_cutoff is not None:
        lines.append(f"short_cutoff = {_length(settings.short_cutoff)}")
    return "\n".join(lines) + "\n"


def _text(value: str) -> str:
    import tomli_w

    return tomli_w.dumps({"a": value}).removeprefix("a = ").strip()


def _length(value: float) -> str:
    """Write a length with the prefix that suits it, or in m where digits would be cut."""
    text = readable(f"{value!r} m").replace("µ", "u")
    return f'"{text}"' if to_si(text, "m") == value else f'"{value!r} m"'
