"""A case for a measured surface: cells that fit into its map, and what they hold of it."""

import tomllib
from dataclasses import dataclass
from math import ceil, floor
from pathlib import Path

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk.moduli import contact_modulus
from multiscale.pipeline.case import validate_case
from multiscale.pipeline.case_tables import CellSettings
from multiscale.pipeline.measured_sides import measured_side
from multiscale.pipeline.rough_bodies import InstrumentSurface
from multiscale.pipeline.settings import POINTS_PER_WAVE
from multiscale.pipeline.windows import Measured
from multiscale.surfaces import Surface, spectrum

__all__ = ["Proposal", "propose_case"]

MOST_POINTS = 256  # of flat cells, along an edge
SLOPE_HELD = 0.95
REALISATIONS = (4, 3, 2, 1)
SMALLER = 0.85
STEEL = (210e9, 0.3)
LOADS = np.geomspace(0.004, 0.12, 8)  # of contact modulus times slope: contact of 1 to 20 %


@dataclass(frozen=True, eq=False)
class Proposal:
    """A case for a measured surface.

    Attributes
    ----------
    text : str
        The case, a TOML file.
    measured : Measured
        What its cells hold of the surface.
    """

    text: str
    measured: Measured

    @property
    def held(self) -> dict[str, float]:
        """Shares of the rms height and slope of the surface that the cells hold."""
        whole, cells = self.measured.stages[0], self.measured.stages[2]
        names = ("rms_height", "rms_slope")
        return {name: getattr(cells, name) / getattr(whole, name) for name in names}


def propose_case(
    whole: Surface, settings: InstrumentSurface, *, shortest_reliable: float, long: float
) -> Proposal:
    """Propose cells for a measured surface: as large as the map allows, as fine as it is reliable.

    Parameters
    ----------
    whole : Surface
        Map or line scan, without trend.
    settings : InstrumentSurface
        Surface table as far as the user has given it.
    shortest_reliable, long : float
        Shortest reliable wave, and wave beyond which a hundredth of the mean square height is, m.

    Returns
    -------
    Proposal
        Flat cells, steel on smooth steel: the materials of a surface are in no file.

    Raises
    ------
    CaseError
        If the map holds no window of enough points.
    """
    if settings.profile == "isotropic":
        edge = min(long, whole.size[0])
        found = _cells(whole, settings, edge, shortest_reliable, REALISATIONS[0])
    else:
        found = _windows(whole, settings, shortest_reliable)
    table, cell, count, measured = found
    scale = contact_modulus(STEEL, STEEL) * measured.stages[2].rms_slope
    pressures = ", ".join(f'"{1e-6 * scale * load:.2g} MPa"' for load in LOADS)
    text = f"""\
# Proposed by multiscale inspect; the materials and the smooth second body are assumptions.
title = {_text(settings.file.name)}

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
    validate_case(tomllib.loads(text), Path("the proposed case"))
    return Proposal(text, measured)


Found = tuple[InstrumentSurface, CellSettings, int, Measured]


def _windows(whole: Surface, settings: InstrumentSurface, shortest: float) -> Found:
    """Choose the largest windows of which the map holds enough, mirrored into cells."""
    refusal = CaseError("the map holds no window")
    for count in REALISATIONS:
        room = min(whole.size)
        pieces = (room / k for k in range(1, count + 1))
        edge = next(one for one in pieces if _fit_in(whole, one) >= count) * (1.0 - 1e-9)
        for _ in range(12 if whole.filled_share else 1):
            try:
                return _cells(whole, settings, 2.0 * edge, shortest, count)
            except CaseError as error:
                refusal = error
            edge *= SMALLER
    raise refusal


def _fit_in(whole: Surface, edge: float) -> int:
    return floor(whole.size[0] / edge * (1 + 1e-9)) * floor(whole.size[1] / edge * (1 + 1e-9))


def _cells(
    whole: Surface, settings: InstrumentSurface, size: float, shortest: float, count: int
) -> Found:
    """Choose grid and cut-off of cells of a size, and measure what they hold."""
    size = float(f"{size * (1.0 - 5e-5):.4g}")  # as the file says it, and no longer
    holding = spectrum([whole], periodic=False).cutoff_holding(SLOPE_HELD, order=2)
    cutoff = max(shortest, holding)
    n = min(MOST_POINTS, 2 * max(8, ceil(0.5 * POINTS_PER_WAVE * size / cutoff)))
    cutoff = float(f"{max(cutoff, POINTS_PER_WAVE * size / n) * 1.0005:.4g}")
    cell = CellSettings.model_validate(
        {"size": [f"{size!r} m"] * 2, "points": [n, n], "geometry": "flat"}
    )
    table = settings.model_copy(update={"short_cutoff": cutoff})
    side = measured_side(whole, table, cell, range(count), count, 0)
    assert side.measured is not None
    return table, cell, count, side.measured


def _table(settings: InstrumentSurface) -> str:
    """Write the keys of a surface table that are not defaults."""
    lines = [f"file = {_text(str(settings.file))}"]
    if settings.channel is not None:
        named = settings.channel
        lines.append(f"channel = {named if isinstance(named, int) else _text(named)}")
    if settings.size is not None:
        lines.append(f"size = [{', '.join(_length(one) for one in settings.size)}]")
    if settings.unit is not None:
        lines.append(f'unit = "{settings.unit!r} m"')
    if settings.detrend_order != InstrumentSurface.model_fields["detrend_order"].default:
        lines.append(f"detrend_order = {settings.detrend_order}")
    if settings.fill_undefined:
        lines.append("fill_undefined = true")
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
    return f'"{1e6 * value:.10g} um"'
