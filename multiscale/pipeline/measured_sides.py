"""Surfaces of a body from a measured file: windows of a map, or a line scan."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import ceil, floor, sqrt
from typing import NamedTuple

import numpy as np

from multiscale.errors import CaseError
from multiscale.io.surface_file import open_topography
from multiscale.pipeline.tables.case_tables import POINTS_PER_WAVE, CellSettings
from multiscale.pipeline.tables.rough_bodies import InstrumentSurface
from multiscale.surfaces import (
    Roughness,
    crop,
    describe_surface,
    detrend,
    find_lay,
    low_pass,
    mirror,
    resample,
    rotate,
    self_affine,
    spectrum,
    window,
)
from multiscale.surfaces.fourier import Spectrum
from multiscale.surfaces.statistics import fit_of_statistics
from multiscale.surfaces.surface import Surface
from multiscale.units import readable

STAGES = ("map", "windows", "cells")  # labels of the dimension ``stage`` of the roughness of a body
FEWEST_PIXELS = 16  # measured points across a window
HELD = 0.9  # share of the rms height and slope of a map below which its cells need a caution
MINOR = 0.99  # share of the roughness of both bodies above which the loss of one needs no caution
OBLIQUE = 1.0 / 3.0  # share of the lay lost in a mirror image that needs a caution: 10 degrees off


@dataclass(frozen=True, eq=False)
class Measured:
    """Roughness of a measured map, of its windows and of its cells."""

    stages: tuple[Roughness, Roughness, Roughness]  # of the map, of its windows and of the cells
    map_filled: float  # share of filled points
    filled: tuple[float, ...]  # share of filled points of each window
    cutoff: str  # the shortest wavelength of the cells, and the reason
    cautions: tuple[str, ...]  # roughness lost between map and cells, a sentence each
    losses: dict[str, str] = field(default_factory=dict)  # cautions by rms height and rms slope

    def cautions_beside(self, other: "Measured") -> list[str]:
        """Return the cautions of losses that matter next to the map of the other body."""
        minor = []
        for name, caution in self.losses.items():
            whole, cells = (getattr(stage, name) for stage in (self.stages[0], self.stages[2]))
            rest = getattr(other.stages[2], name)
            if np.hypot(rest, cells) >= MINOR * np.hypot(rest, whole):
                minor.append(caution)
        return [caution for caution in self.cautions if caution not in minor]


def cut_windows(
    whole: Surface,
    settings: InstrumentSurface,
    cell: CellSettings,
    which: range,
    needed: int,
    seed: int,
    *,
    of_map: Spectrum | None = None,
    other_map: bool = False,
) -> tuple[list[Surface], Measured]:
    """Cut separate windows from a measured map and make them periodic and band-limited."""
    cutoff, chosen = _cutoff(settings, cell, whole.spacing)
    of_map = of_map or spectrum([whole], periodic=False)
    mirrored = settings.periodic == "mirror"
    places = _place_windows(whole, settings, cell, needed, seed, of_map if other_map else None)
    # crop, make periodic, filter, resample and repeat
    cropped = [crop(whole, places.corners[k], places.pixels) for k in which]
    pieces = [detrend(Surface(patch.heights, places.size, patch.filled)) for patch in cropped]
    if any(np.ptp(piece.heights) == 0.0 for piece in pieces):
        raise CaseError(f"{settings.file.name} has a window of constant height; crop it")
    periodic = [(mirror if mirrored else window)(piece) for piece in pieces]
    repeats = places.repeats
    points = (cell.points[0] // repeats, cell.points[1] // repeats)
    surfaces = [resample(low_pass(piece, cutoff), points) for piece in periodic]
    if repeats > 1:
        tiled = [np.tile(surface.heights, (repeats, repeats)) for surface in surfaces]
        surfaces = [Surface(heights, cell.size) for heights in tiled]
    if any(np.ptp(surface.heights) == 0.0 for surface in surfaces):
        raise CaseError(
            f"{settings.file.name} has a window without wavelengths of {_length(cutoff)} or "
            f"more; give a finer grid with a shorter short_cutoff"
        )
    # roughness of map, windows and cells, and its losses
    of_pieces = spectrum(pieces, periodic=False)
    # a window and its mirror image have the same spectrum
    same = mirrored and not any(piece.filled_share for piece in pieces)
    of_periodic = of_pieces if same else spectrum(periodic)
    stages = of_map.roughness(), of_pieces.roughness(), spectrum(surfaces).roughness()
    share = (0.5 if mirrored else 1.0) / repeats
    losses = _losses(stages, of_map, of_periodic, whole.size, cell, share, chosen)
    cautions = [*losses.values(), *_herringbone(settings, whole, cutoff)]
    if repeats > 1:
        cautions = [
            f"its map is too small for the cells: windows of {_lengths(places.size)}, which hold "
            f"most of its rms height, repeat {repeats} x {repeats} times in a cell",
            *cautions,
        ]
    filled = tuple(piece.filled_share for piece in pieces)
    shortest = f"{_length(cutoff)}, {chosen}"
    return surfaces, Measured(stages, whole.filled_share, filled, shortest, tuple(cautions), losses)


class _Windows(NamedTuple):
    """Separate windows of a map, and how often a cell repeats each of them along an edge."""

    size: tuple[float, float]  # m
    pixels: tuple[int, int]
    corners: list[tuple[int, int]]  # first pixels
    repeats: int = 1


def _place_windows(
    whole: Surface,
    settings: InstrumentSurface,
    cell: CellSettings,
    needed: int,
    seed: int,
    repeated: Spectrum | None,
) -> _Windows:
    """Place windows of the size of a cell, or of its half with a mirror image.

    With the spectrum of the map, smaller windows may repeat: the other body has a map, too.
    """
    share = 0.5 if settings.periodic == "mirror" else 1.0

    def place(repeats: int) -> _Windows:
        size = (share * cell.size[0] / repeats, share * cell.size[1] / repeats)
        pixels = (round(size[0] / whole.spacing[0]), round(size[1] / whole.spacing[1]))
        fits = min(pixels) >= FEWEST_PIXELS
        corners = _corners(whole, pixels, settings.filled, seed) if fits else []
        return _Windows(size, pixels, corners, repeats)

    windows = place(1)
    if min(windows.pixels) < FEWEST_PIXELS:
        raise CaseError(
            f"a window of {_lengths(windows.size)} has only {min(windows.pixels)} measured points "
            f"across, and the spacing of {settings.file.name} is {_length(max(whole.spacing))}; "
            f"make the cell at least {_length(FEWEST_PIXELS * max(whole.spacing) / share)} large"
        )
    if len(windows.corners) >= needed:
        return windows
    # windows repeat along an edge on the grid, as long as they hold most modes
    longest = np.inf if repeated is None else repeated.length_holding(HELD)
    most = int(min(cell.size) / longest * share)
    for repeats in (k for k in range(2, most + 1) if not any(n % k for n in cell.points)):
        smaller = place(repeats)
        if len(smaller.corners) >= needed:
            return smaller
    raise CaseError(_too_few(whole, settings, windows.size, len(windows.corners), needed))


def _cutoff(
    settings: InstrumentSurface, cell: CellSettings, pixel: tuple[float, float]
) -> tuple[float, str]:
    """Return the cut-off wavelength, m, and its reason: the case, the grid or the pixels."""
    spacing = cell.spacing
    by_grid, by_map = POINTS_PER_WAVE * spacing, 2.0 * max(pixel)
    resolved = max(by_grid, by_map)
    if settings.short_cutoff is not None:
        cutoff, chosen = settings.short_cutoff, "the short_cutoff of the case"
    elif by_grid < by_map:
        cutoff, chosen = resolved, "two pixels of the map"
    else:
        cutoff = resolved
        chosen = f"{POINTS_PER_WAVE} points of the grid, as the case has no short_cutoff"
    least = max(2.0 * spacing, 2.0 / float(np.hypot(1.0 / pixel[0], 1.0 / pixel[1])))  # diagonal
    if cutoff < least:
        raise CaseError(
            f"short_cutoff {_length(cutoff)} is finer than the grid; with {_length(spacing)} "
            f"between its points and {_length(max(pixel))} between measured points it must be at "
            f"least {_length(least)}, better {_length(resolved)}"
        )
    if cutoff > 0.5 * min(cell.size):
        raise CaseError(
            f"short_cutoff {_length(cutoff)} removes all roughness of a cell of "
            f"{_length(min(cell.size))}; it must be at most half as long as the cell"
        )
    return cutoff, chosen


def _corners(
    whole: Surface, pixels: tuple[int, int], most: float, seed: int
) -> list[tuple[int, int]]:
    """Choose the corners of separate windows, those with the fewest filled points first."""
    (nx, ny), (m, n) = whole.heights.shape, pixels
    if m > nx or n > ny:
        return []
    random = np.random.default_rng(seed)
    if whole.filled is None:
        tiles = list(product(range(0, nx - m + 1, m), range(0, ny - n + 1, n)))
        return [tiles[k] for k in random.permutation(len(tiles))]
    total = np.zeros((nx + 1, ny + 1))
    total[1:, 1:] = np.cumsum(np.cumsum(whole.filled, axis=0), axis=1)
    filled = (total[m:, n:] - total[:-m, n:] - total[m:, :-n] + total[:-m, :-n]) / (m * n)
    places = np.argsort(filled, axis=None, kind="stable")
    free, taken = filled <= most, []
    for i, j in zip(
        *(index.tolist() for index in np.unravel_index(places, filled.shape)), strict=True
    ):
        if free[i, j]:
            taken.append((i, j))
            free[max(0, i - m + 1) : i + m, max(0, j - n + 1) : j + n] = False
    order = random.permutation(len(taken))
    return sorted((taken[k] for k in order), key=lambda corner: filled[corner])


def _too_few(
    whole: Surface,
    settings: InstrumentSurface,
    size: tuple[float, float],
    available: int,
    count: int,
) -> str:
    """Report the number of windows, and a size with enough windows."""
    within = (
        f" with at most {100.0 * settings.filled:.3g} % of their points filled"
        if whole.filled_share
        else ""
    )
    message = (
        f"{settings.file.name} measures {_lengths(whole.size)} and has {available} separate "
        f"window{'s' * (available != 1)} of {_lengths(size)}{within}, but {count} are needed; "
        f"{'reduce realisations' if available else 'make the cell smaller'}"
    )
    scale = 1.0
    while True:
        scale *= 0.95
        smaller = [scale * edge for edge in size]
        pixels = [round(edge / step) for edge, step in zip(smaller, whole.spacing, strict=True)]
        if min(pixels) < FEWEST_PIXELS:
            break
        enough = len(_corners(whole, (pixels[0], pixels[1]), settings.filled, 0))
        if enough >= count:
            double = 2.0 if settings.periodic == "mirror" else 1.0
            message += (
                f", or make the cell {_lengths([double * edge for edge in smaller])}, for which "
                f"there are {enough} windows"
            )
            break
    across = ceil(sqrt(count))  # windows, side by side
    message += f", or measure {_lengths([across * edge for edge in size])}"
    return message + (", or allow more by filled in the surface table" if within else "")


def _losses(
    stages: tuple[Roughness, Roughness, Roughness],
    of_map: Spectrum,
    of_periodic: Spectrum,
    size: tuple[float, float],
    cell: CellSettings,
    window_share: float,
    chosen: str,
) -> dict[str, str]:
    losses = {}
    faded = of_periodic.roughness()
    for order, name in ((0, "rms_height"), (2, "rms_slope")):
        whole, pieces, periodic, cells = (
            float(getattr(roughness, name))
            for roughness in (stages[0], stages[1], faded, stages[2])
        )
        if cells >= HELD * whole:
            continue
        lost = []
        if pieces < HELD * whole:
            edge = of_map.length_holding(HELD) / window_share
            separate = np.prod([floor(length / (window_share * edge)) for length in size])
            lost.append(
                f"its windows have {pieces / whole:.2g}, "
                + (
                    f"and cells of {_length(edge)} would have {HELD:g} (the map has space for "
                    f"{separate} of their windows)"
                    if order == 0 and edge > max(cell.size)
                    else "as the map is rougher elsewhere: use more realisations"
                )
            )
        if periodic < HELD * pieces:
            lost.append(
                f"filled points leave {periodic / pieces:.2g}"
                if window_share < 1.0
                else f"fading along the edges leaves {periodic / pieces:.2g}, where periodic = "
                f'"mirror" leaves all'
            )
        if cells < HELD * periodic:
            cutoff = 0.995 * of_periodic.cutoff_holding(
                HELD, order=order
            )  # the message has 3 digits
            points = [2 * int(np.ceil(0.5 * POINTS_PER_WAVE * edge / cutoff)) for edge in cell.size]
            finer = any(new > old for new, old in zip(points, cell.points, strict=True))
            grid = f" on a grid of {' x '.join(map(str, points))} points" if finer else ""
            lost.append(
                f"the cut-off ({chosen}) leaves {cells / periodic:.2g}, where short_cutoff = "
                f'"{_length(cutoff)}"{grid} would leave {HELD:g}'
            )
        losses[name] = (
            f"the cells have {cells / whole:.2g} of the {name.replace('_', ' ')} of the map: "
            + "; ".join(lost or ["windows, edges and cut-off take a little each"])
        )
    return losses


def _herringbone(settings: InstrumentSurface, whole: Surface, cutoff: float) -> list[str]:
    """Caution against mirroring a lay that is oblique to the edges of the window."""
    lay = find_lay(whole, cutoff)
    if settings.periodic != "mirror" or lay.oblique < OBLIQUE:
        return []
    degrees = np.rad2deg(lay.angle)
    return [
        f"the lay is at {degrees:.0f} degrees to the x axis, and mirrored it becomes a "
        f"herringbone of {degrees:.0f} and {180.0 - degrees:.0f} degrees: measure the map along "
        f'its lay, or set periodic = "window"'
    ]


def _lengths(edges: Sequence[float]) -> str:
    return " x ".join(map(_length, edges))


def _length(value: float) -> str:
    return readable(f"{value:.3g} m")


@dataclass(frozen=True, eq=False)
class RoughSide:
    """Realisations of the surface of a body, empty if it is smooth, and their roughness."""

    surfaces: list[Surface]
    measured: Measured | None = None

    def with_cautions(self, further: Sequence[str]) -> "RoughSide":
        """Return the same surfaces with further cautions about their map before all others."""
        if self.measured is None:
            return self
        cautions = (*further, *self.measured.cautions)
        return replace(self, measured=replace(self.measured, cautions=cautions))


def measured_map(settings: InstrumentSurface) -> tuple[Surface, list[str]]:
    """Read the map or line scan of a surface table, remove its trend and describe the removal."""
    topography = open_topography(
        settings.file, channel=settings.channel, size=settings.size, unit=settings.unit
    )
    if topography.is_profile and settings.profile is None:
        raise CaseError(
            f"{settings.file}: holds a line scan of {topography.heights.size} points, and cells "
            f'need an area; set profile = "isotropic", for surfaces with its spectrum, or '
            f'"one_directional", for grooves across the scan'
        )
    if not topography.is_profile and settings.profile is not None:
        raise CaseError(f"{settings.file}: holds a map, not a line scan; leave out profile")
    if settings.spikes == "remove":
        topography = topography.without_spikes()
    surface = topography.to_surface(
        detrend_order=settings.detrend_order, fill_undefined=settings.fill_undefined
    )
    turned = surface if topography.is_profile else rotate(surface, settings.rotate)
    return turned, topography.say_spikes()


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
    other_map: bool = False,
) -> RoughSide:
    """Build the realisations of a body from its measured map or line scan."""
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
        whole, settings, cell, which, needed, seed, of_map=of_map, other_map=other_map
    )
    if side == 1:  # measured from outside: turned over like a sheet of paper
        surfaces = [Surface(piece.heights[::-1], piece.size) for piece in surfaces]
    return RoughSide(surfaces, record)


def _isotropic(
    scan: Surface, settings: InstrumentSurface, cell: CellSettings, seeds: list[int]
) -> RoughSide:
    """Build isotropic surfaces with the self-affine spectrum fitted to a line scan."""
    topography = open_topography(
        settings.file, channel=settings.channel, size=settings.size, unit=settings.unit
    )
    statistics = describe_surface(scan, resolution=topography.resolution)
    fit = fit_of_statistics(statistics)
    if fit is None:
        raise CaseError(
            f"{settings.file}: a line scan of {scan.heights.size} points has too few wavelengths "
            f"for a spectrum; measure a longer line"
        )
    longest, shortest = float(statistics["longest_wave"]), 2.0 * scan.spacing[0]
    long = min(longest, max(cell.size))
    resolved = max(POINTS_PER_WAVE * cell.spacing, shortest)
    short = settings.short_cutoff or resolved
    if short >= long:
        raise CaseError(
            f"short_cutoff {short:.3g} m removes all wavelengths of the line scan, at most "
            f"{long:.3g} m; give a shorter cut-off, and more points"
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
    ends = [readable(f"{wavelength:.3g} m") for wavelength in (short, long)]
    cautions = (
        f"isotropic self-affine surfaces replace a line scan, fitted with a Hurst exponent of "
        f"{fit.hurst_exponent:.2g} and a roll-off at {readable(f'{fit.roll_off:.3g} m')}; a lay "
        f"is invisible in a line",
        *(
            f"the cells have {share:.2g} of the {name.replace('_', ' ')} of the line scan, "
            f"with wavelengths from {ends[0]} to {ends[1]}"
            for name, share in shares.items()
            if not HELD <= share <= 1.0 / HELD
        ),
    )
    chosen = "the short_cutoff of the case" if settings.short_cutoff else "grid and line scan"
    stages = (measured, measured, of_cells)
    filled = (scan.filled_share,) * len(seeds)
    return RoughSide(
        surfaces, Measured(stages, filled[0], filled, f"{ends[0]}, {chosen}", cautions)
    )
