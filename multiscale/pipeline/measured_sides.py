"""Surfaces of a body from a measured file: a map cut into windows, or a line scan."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import open_topography
from multiscale.pipeline.case_tables import POINTS_PER_WAVE, CellSettings
from multiscale.pipeline.rough_bodies import InstrumentSurface
from multiscale.pipeline.windows import HELD, Measured, cut_windows
from multiscale.surfaces import (
    Roughness,
    Spectrum,
    describe_surface,
    fit_of_statistics,
    rotate,
    self_affine,
    spectrum,
)
from multiscale.surfaces.surface import Surface
from multiscale.units import readable

__all__ = ["RoughSide", "measured_map", "measured_side"]


@dataclass(frozen=True, eq=False)
class RoughSide:
    """Realisations of one body's surface, none if it is smooth, and their share of a map."""

    surfaces: list[Surface]
    measured: Measured | None = None

    def with_cautions(self, said: Sequence[str]) -> "RoughSide":
        """Return the same surfaces with further cautions about their map, the first of all."""
        if self.measured is None:
            return self
        cautions = (*said, *self.measured.cautions)
        return replace(self, measured=replace(self.measured, cautions=cautions))


def measured_map(settings: InstrumentSurface) -> tuple[Surface, list[str]]:
    """Read the map or line scan of a surface table, remove its trend and describe the removal."""
    found = open_topography(
        settings.file, channel=settings.channel, size=settings.size, unit=settings.unit
    )
    if found.is_profile and settings.profile is None:
        raise CaseError(
            f"{settings.file}: holds a line scan of {found.heights.size} points, and cells need an "
            f'area; set profile = "isotropic", for surfaces with its spectrum, or '
            f'"one_directional", for grooves across the scan'
        )
    if not found.is_profile and settings.profile is not None:
        raise CaseError(f"{settings.file}: holds a map, no line scan; leave out profile")
    if settings.spikes == "remove":
        found = found.without_spikes()
    surface = found.to_surface(
        detrend_order=settings.detrend_order, fill_undefined=settings.fill_undefined
    )
    turned = surface if found.is_profile else rotate(surface, settings.rotate)
    return turned, found.say_spikes()


def measured_side(
    whole: Surface,
    settings: InstrumentSurface,
    cell: CellSettings,
    which: range,
    needed: int,
    seed: int,
    *,
    side: int = 0,
    of_map: Spectrum | None = None,
    beside_map: bool = False,
) -> RoughSide:
    """Make the realisations of one body from its measured map or line scan."""
    if settings.profile == "isotropic":
        # windows of a shared file are counted for both bodies, random surfaces are not
        seeds = [2 * (seed + k) + side for k in range(len(which))]
        return _isotropic(whole, settings, cell, seeds)
    if settings.profile == "one_directional":
        step = whole.spacing[0]
        n = int(np.ceil(max(cell.size) / step))  # lines of the scan, repeated along y
        filled = None if whole.filled is None else np.repeat(whole.filled, n, axis=1)
        grooves = Surface(np.repeat(whole.heights, n, axis=1), (whole.size[0], n * step), filled)
        whole = rotate(grooves, settings.rotate)
    surfaces, record = cut_windows(
        whole, settings, cell, which, needed, seed, of_map=of_map, beside_map=beside_map
    )
    if side == 1:  # measured from outside: turned over as paper is
        surfaces = [Surface(piece.heights[::-1], piece.size) for piece in surfaces]
    return RoughSide(surfaces, record)


def _isotropic(
    scan: Surface, settings: InstrumentSurface, cell: CellSettings, seeds: list[int]
) -> RoughSide:
    """Make isotropic surfaces with the self-affine spectrum fitted to a line scan.

    The rms height of an isotropic surface is the rms height of its profiles, and its rms slope is
    larger by the square root of two. Waviness above the fit is in the line scan alone.
    """
    told = open_topography(
        settings.file, channel=settings.channel, size=settings.size, unit=settings.unit
    )
    statistics = describe_surface(scan, resolution=told.resolution)
    fit = fit_of_statistics(statistics)
    if fit is None:
        raise CaseError(
            f"{settings.file}: a line scan of {scan.heights.size} points has too few waves for a "
            f"spectrum; measure a longer one"
        )
    longest, shortest = float(statistics["longest_wave"]), 2.0 * scan.spacing[0]
    long = min(longest, max(cell.size))
    resolved = max(POINTS_PER_WAVE * cell.spacing, shortest)
    short = settings.short_cutoff or resolved
    if short >= long:
        raise CaseError(
            f"short_cutoff {short:.3g} m leaves no wave of the line scan, the longest of which is "
            f"{long:.3g} m; give a shorter one, and more points"
        )
    surfaces = [
        self_affine(
            cell.points,
            cell.size,
            seed,
            hurst_exponent=fit.hurst_exponent,
            long_cutoff=long,
            short_cutoff=short,
            roll_off=float(np.clip(fit.roll_off, short, long)),
            rms_height=fit.rms_height(long, short),
        )
        for seed in seeds
    ]
    measured = Roughness(
        float(statistics["rms_height"]),
        np.sqrt(2.0) * float(statistics["rms_slope"]),
        longest,
        float(statistics["shortest_wave"]),
    )
    of_cells = spectrum(surfaces).roughness()
    shares = {
        name: getattr(of_cells, name) / getattr(measured, name)
        for name in ("rms_height", "rms_slope")
    }
    ends = [readable(f"{wave:.3g} m") for wave in (short, long)]
    said = (
        f"isotropic self-affine surfaces stand for a line scan, fitted with a Hurst exponent of "
        f"{fit.hurst_exponent:.2g} and a roll-off at {readable(f'{fit.roll_off:.3g} m')}; a lay "
        f"is not seen in one line",
        *(
            f"the cells hold {share:.2g} of the {name.replace('_', ' ')} that belongs to the line "
            f"scan, by their waves from {ends[0]} to {ends[1]}"
            for name, share in shares.items()
            if not HELD <= share <= 1.0 / HELD
        ),
    )
    chosen = "the short_cutoff of the case" if settings.short_cutoff else "grid and line scan"
    stages = (measured, measured, of_cells)
    kept = (scan.filled_share,) * len(seeds)
    return RoughSide(surfaces, Measured(stages, kept[0], kept, f"{ends[0]}, {chosen}", said))
