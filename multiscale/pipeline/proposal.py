"""A case for a measured surface: cells that fit into its map, and their share of its roughness."""

from dataclasses import dataclass
from math import ceil, floor

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk.bulk_law import contact_modulus
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


@dataclass(frozen=True, eq=False)
class Proposal:
    """A case for a measured surface."""

    text: str  # the case, a TOML file
    measured: Measured  # roughness of the map and of its cells

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the rms height and slope of the surface that the cells hold."""
        whole, cells = self.measured.stages[0], self.measured.stages[2]
        names = ("rms_height", "rms_slope")
        return {name: getattr(cells, name) / getattr(whole, name) for name in names}


def propose_case(
    whole: Surface,
    settings: InstrumentSurface,
    spectrum: Spectrum,
    *,
    reliable: tuple[float, float],
) -> Proposal:
    """Propose cells for a measured surface that hold its height and its slope."""
    if not reliable[0] < reliable[1]:
        raise CaseError("the map has too few points for any reliable wavelength")
    finest = max(reliable[0], spectrum.cutoff_holding(SLOPE_HELD, order=2))
    mirrored = 1.0 if settings.profile == "isotropic" else 2.0
    refusal = CaseError("the map holds no window of roughness")
    for count in REALISATIONS:
        sizes = [mirrored * edge for edge in _edges(whole, count)]

        def least_share(size: float) -> float:
            cutoff = max(finest, POINTS_PER_WAVE * size / MOST_POINTS)
            return min(spectrum.share(size, cutoff, order=order) for order in (0, 2))

        size = max(sizes, key=least_share)
        for _ in range(MOST_SHRINKS if whole.filled_share else 1):
            table, cell = _cells(settings, size, finest)
            try:
                side = measured_side(whole, table, cell, range(count), count, 0, of_map=spectrum)
            except CaseError as error:
                refusal = error
                size *= SMALLER
                continue
            assert side.measured is not None
            return _write(table, cell, count, side.measured)
    raise refusal


def _edges(whole: Surface, count: int) -> list[float]:
    """Edges of square windows that fit often enough into a map, or of pieces of a line scan."""
    profile = whole.heights.shape[1] == 1
    room = whole.size[0] if profile else min(whole.size)
    edges = room / np.geomspace(1.0, 32.0, 16) * (1.0 - 1e-4)
    return [
        float(edge)
        for edge in edges
        if profile or floor(whole.size[0] / edge) * floor(whole.size[1] / edge) >= count
    ]


def _cells(
    settings: InstrumentSurface, size: float, finest: float
) -> tuple[InstrumentSurface, CellSettings]:
    """Choose grid and cut-off of cells of a size."""
    size = float(f"{size:.4g}")  # as in the file
    n = min(MOST_POINTS, 2 * max(8, ceil(0.5 * POINTS_PER_WAVE * size / finest)))
    cutoff = float(f"{max(finest, POINTS_PER_WAVE * size / n) * 1.0005:.4g}")
    given = {"size": [f"{size!r} m"] * 2, "points": [n, n], "geometry": "flat"}
    return settings.model_copy(update={"short_cutoff": cutoff}), CellSettings.model_validate(given)


def _write(
    table: InstrumentSurface, cell: CellSettings, count: int, measured: Measured
) -> Proposal:
    """Write the case file of chosen cells."""
    scale = contact_modulus(STEEL, STEEL) * measured.stages[2].rms_slope
    rounded = [float(f"{1e-6 * scale * load:.2g}") for load in LOADS]
    pressures = ", ".join(f'"{pressure:g} MPa"' for pressure in rounded)
    text = f"""\
# Proposed by multiscale inspect; the materials and the smooth second body are assumptions.
title = {_text(table.file.name)}

[body_1]
youngs_modulus = "210 GPa"
poissons_ratio = 0.3

[body_1.surface]
{_table(table)}
[body_2]
youngs_modulus = "210 GPa"
poissons_ratio = 0.3

[cell]
size = [{_length(cell.size[0])}, {_length(cell.size[1])}]
points = [{cell.points[0]}, {cell.points[1]}]
geometry = "flat"

[micro]
realisations = {count}
pressures = [{pressures}]
"""
    return Proposal(text, measured)


def _table(settings: InstrumentSurface) -> str:
    """Write the keys of a surface table that are not defaults."""
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
    """Write text as TOML."""
    import tomli_w

    return tomli_w.dumps({"a": value}).removeprefix("a = ").strip()


def _length(value: float) -> str:
    """Write a length with the prefix that suits it, or in m where digits would be lost."""
    text = readable(f"{value!r} m").replace("µ", "u")
    return f'"{text}"' if to_si(text, "m") == value else f'"{value!r} m"'
