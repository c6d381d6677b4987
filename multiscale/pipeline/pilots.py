"""Stored cells of a spectrum alike, from which a planner starts."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io import open_dataset
from multiscale.micro import contact_modulus
from multiscale.pipeline.case_cells import composite_material, make_surfaces
from multiscale.pipeline.rough_bodies import SyntheticSurface
from multiscale.pipeline.settings import Case
from multiscale.schema import MICRO_RESPONSE, STORED_CELLS, Dataset, branch_of
from multiscale.surfaces import rms_height, rms_slope

if TYPE_CHECKING:
    from multiscale.surfaces.surface import Surface

__all__ = ["Pilots", "stored_pilots", "surface_at_large"]

STORED = Path(__file__).with_name("stored_cells.nc")
HURST_RANGE, BAND_RANGE = (0.4, 0.9), (3.0, 12.0)  # what stored cells stand for
MANY_WAVES = 32  # across a surface at large
MOST_POINTS = 2048  # across it


@dataclass(frozen=True, eq=False)
class Pilots:
    """Stored responses that tell the scatter and the errors by size and grid."""

    sizes: Mapping[float, Dataset]  # by the edge of the cell, m
    grids: Mapping[float, Dataset]  # the same cells by the spacing of their grid, m
    source: str  # where they come from, in words

    def sizes_beside(self, case: Case) -> dict[float, Dataset]:
        """Return the responses by the ratio of their size to the size of a case."""
        return {one / max(case.cell.size): response for one, response in self.sizes.items()}

    def grids_beside(self, case: Case) -> dict[float, Dataset]:
        """Return the responses by the ratio of their spacing to the spacing of a case."""
        return {one / case.cell.spacing: response for one, response in self.grids.items()}


def surface_at_large(case: Case) -> "Surface | None":
    """Return the composite surface of a case on a patch of many waves; none of a measured map."""
    surfaces = [body.surface for body in case.bodies if body.surface is not None]
    synthetic = [one for one in surfaces if isinstance(one, SyntheticSurface)]
    if len(synthetic) < len(surfaces):
        return None
    wave = max(one.longest_wave for one in synthetic)
    wanted = MANY_WAVES * wave / max(case.cell.size)
    room = MOST_POINTS / max(case.cell.points)
    larger = 2 ** max(0, int(np.ceil(np.log2(min(wanted, room)))))
    cell = case.cell.model_copy(
        update={
            "size": tuple(larger * edge for edge in case.cell.size),
            "points": tuple(larger * n for n in case.cell.points),
        }
    )
    micro = case.micro.model_copy(update={"realisations": 1})
    (large,) = make_surfaces(case.model_copy(update={"cell": cell, "micro": micro}))
    return large


def stored_pilots(case: Case, large: "Surface | None") -> Pilots | None:
    """Return the stored cells of the spectrum nearest to that of a case, at its pressures.

    Gaps, over the height, and contact fractions of a self-affine surface depend on the pressure
    over contact modulus and slope, on the Hurst exponent, and on the cell over the longest and the
    grid over the shortest wave.

    There are none if the case is not one of flat elastic cells with one rough body whose spectrum
    and loads they cover; ``large`` is from :func:`surface_at_large`.
    """
    if large is None or not _is_plain(case):
        return None
    cells = open_dataset(STORED, STORED_CELLS)
    known = cells["relative_pressure"].to_numpy()
    scale = contact_modulus(composite_material(case)) * rms_slope(large)
    load = np.array(case.micro.pressures) / scale
    if not known[0] <= load.min() <= load.max() <= known[-1]:
        return None
    spectrum, height = _spectrum(case), rms_height(large)
    band = spectrum.long_cutoff / spectrum.short_cutoff
    far = ((cells["hurst_exponent"].to_numpy() - spectrum.hurst_exponent) / 0.3) ** 2
    far += np.log2(cells["band"].to_numpy() / band) ** 2
    cells = cells.isel(cell=np.flatnonzero(far == far.min()))

    def pick(waves: float, points: float) -> Dataset:
        chosen = ((cells["waves"] == waves) & (cells["points"] == points)).to_numpy()
        return _response(cells.isel(cell=np.flatnonzero(chosen)), load, case, height)

    waves, points = np.unique(cells["waves"]), np.unique(cells["points"])
    fine = {one: pick(waves[0], one) for one in points}
    n = min(one.sizes["realisation"] for one in fine.values())
    return Pilots(
        {one * spectrum.long_cutoff: pick(one, points[0]) for one in waves},
        {
            spectrum.short_cutoff / one: response.isel(realisation=slice(n))
            for one, response in fine.items()
        },
        source=f"stored cells of Hurst exponent {float(cells['hurst_exponent'][0]):g} and "
        f"{float(cells['band'][0]):g} times the shortest wave",
    )


def _spectrum(case: Case) -> SyntheticSurface:
    (one,) = [body.surface for body in case.bodies if isinstance(body.surface, SyntheticSurface)]
    return one


def _is_plain(case: Case) -> bool:
    """Whether cells are flat, elastic, square and under one surface that stored ones stand for."""
    rough = [body.surface for body in case.bodies if body.surface is not None]
    if len(rough) > 1 or case.cell.geometry != "flat" or case.hardness is not None or case.coated:
        return False
    one = _spectrum(case)
    return (
        len(set(case.cell.size)) == 1
        and one.roll_off in (None, one.long_cutoff)
        and one.anisotropy is None
        and HURST_RANGE[0] <= one.hurst_exponent <= HURST_RANGE[1]
        and BAND_RANGE[0] <= one.long_cutoff / one.short_cutoff <= BAND_RANGE[1]
    )


def _response(cells: Dataset, load: np.ndarray, case: Case, height: float) -> Dataset:
    """Turn stored cells into a response to the pressures of a case."""
    x = np.log(cells["relative_pressure"].to_numpy())

    def at(name: str) -> np.ndarray:
        logs = np.log(cells[name].to_numpy())
        return np.exp([np.interp(np.log(load), x, one) for one in logs])

    ones = np.ones((cells.sizes["cell"], load.size), dtype=int)
    traction = np.zeros((*ones.shape, 3))
    traction[..., 0] = -np.array(case.micro.pressures)
    values = {
        "mean_gap": height * at("gap_over_height"),
        "contact_fraction": at("contact_fraction"),
        "wall_time": at("wall_time"),
        "traction": traction,
        "displacement_jump": np.zeros(traction.shape),
        "nominal_pressure": np.array(case.micro.pressures),
        "branch": branch_of(np.array(case.micro.pressures)),
        "rms_height": np.full(len(ones), height),
    }
    counts = ("converged", "active_set_iterations", "linear_iterations")
    return MICRO_RESPONSE.build(values | dict.fromkeys(counts, ones))
