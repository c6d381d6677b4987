"""From a case to its cells: surfaces of both bodies, and one elastic body that stands for both."""

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import read_surface
from multiscale.io.surfaces import Surface
from multiscale.laws.bulk import J2
from multiscale.micro.cell import Cell, contact_modulus
from multiscale.micro.topography import (
    composite,
    detrend,
    low_pass,
    mirror,
    resample,
    self_affine,
    window,
)
from multiscale.pipeline.rough_bodies import InstrumentSurface
from multiscale.pipeline.settings import POINTS_PER_WAVE, Case

__all__ = ["body_surfaces", "cell_of", "composite_material", "longest_wave", "make_cells"]

FEWEST_PIXELS = 16  # measured points across a window


def composite_material(case: Case) -> tuple[float, float]:
    r"""Young's modulus, Pa, and Poisson's ratio of the body that stands for both.

    Its contact modulus is that of the pair, :math:`1/E^* = \sum (1-\nu_i^2)/E_i`. For small slopes
    and without friction nothing else of the elastic constants enters; Poisson's ratio is the mean
    weighted by compliance.
    """
    pair = [(body.youngs_modulus, body.poissons_ratio) for body in case.bodies]
    compliance = [(1.0 - nu**2) / modulus for modulus, nu in pair]
    nu = float(np.average([nu for _, nu in pair], weights=compliance))
    return contact_modulus(*pair) * (1.0 - nu**2), nu


def longest_wave(case: Case) -> float:
    """Longest wavelength of the roughness of both bodies, m: that of a measured map is the cell."""
    synthetic = [
        body.surface.long_cutoff
        for body in case.bodies
        if body.surface is not None and not isinstance(body.surface, InstrumentSurface)
    ]
    measured = any(isinstance(body.surface, InstrumentSurface) for body in case.bodies)
    return max([*synthetic, *([max(case.cell.size)] if measured else [])])


def make_cells(case: Case) -> list[Cell]:
    """Build the cell of each realisation.

    Raises
    ------
    CaseError
        If a surface cannot be made or read, or a map has too few windows.
    """
    sides = [body_surfaces(case, number) for number in (1, 2)]
    cells = []
    for k in range(case.micro.realisations):
        rough = [side[k] for side in sides if side]
        surface = rough[0] if len(rough) == 1 else composite(rough[0], rough[1])
        cells.append(cell_of(case, surface))
    return cells


def cell_of(case: Case, surface: Surface) -> Cell:
    """Build the cell of a case under one composite surface."""
    material = composite_material(case)
    flat = case.cell.geometry == "flat"
    return Cell(
        surface,
        case.cell.depth if case.cell.depth is not None else max(case.cell.size),
        case.cell.layers,
        *material,
        geometry=case.cell.geometry,
        hardness=case.hardness if flat else None,
        bulk=_metal(case, material),
    )


def _metal(case: Case, material: tuple[float, float]) -> J2 | None:
    """Law of a conforming cell whose case gives a hardness: that of the softer body."""
    if case.yield_stress is None or case.softer is None:
        return None
    return J2(*material, case.yield_stress, case.softer.hardening_modulus or 0.0)


def body_surfaces(case: Case, number: int) -> list[Surface]:
    """Realisations of one body's surface; none if it is smooth."""
    body, other = case.bodies[:: 1 if number == 1 else -1]
    settings = body.surface
    if settings is None:
        return []
    count = case.micro.realisations
    try:
        if not isinstance(settings, InstrumentSurface):
            return [
                self_affine(
                    case.cell.points,
                    case.cell.size,
                    2 * (case.micro.seed + k) + number - 1,  # the two sides are independent
                    **settings.model_dump(),
                )
                for k in range(count)
            ]
        shared = isinstance(other.surface, InstrumentSurface) and (
            other.surface.file.resolve() == settings.file.resolve()
        )
        windows = _windows(case, settings, 2 * count if shared else count)
        if number == 1:
            return windows[:count]
        # side 2 is measured from outside: turned over as paper is
        return [Surface(piece.heights[::-1], piece.size) for piece in windows[-count:]]
    except CaseError as error:
        raise CaseError(f"[body_{number}.surface] {error}") from error


def _windows(case: Case, settings: InstrumentSurface, count: int) -> list[Surface]:
    """Cut separate windows from a measured map and make them periodic and band-limited."""
    whole = read_surface(
        settings.file,
        detrend_order=settings.detrend_order,
        fill_undefined=settings.fill_undefined,
    )
    spacing = [length / n for length, n in zip(case.cell.size, case.cell.points, strict=True)]
    cutoff = _cutoff(settings, case.cell.size, max(spacing), max(whole.spacing))
    share = 0.5 if settings.periodic == "mirror" else 1.0
    size = (share * case.cell.size[0], share * case.cell.size[1])
    pixels = [round(length / step) for length, step in zip(size, whole.spacing, strict=True)]
    if min(pixels) < FEWEST_PIXELS:
        raise CaseError(
            f"a window of {size[0]:.3g} x {size[1]:.3g} m has only {min(pixels)} measured points "
            f"across, where {settings.file.name} has one each {max(whole.spacing):.3g} m; make the "
            f"cell at least {FEWEST_PIXELS * max(whole.spacing) / share:.3g} m large"
        )
    room = [
        int(length / part * (1.0 + 1e-9)) for length, part in zip(whole.size, size, strict=True)
    ]
    if room[0] * room[1] < count:
        raise CaseError(
            f"{settings.file.name} measures {whole.size[0]:.3g} x {whole.size[1]:.3g} m and holds "
            f"{room[0] * room[1]} separate windows of {size[0]:.3g} x {size[1]:.3g} m, but "
            f"{count} are needed; make the cell smaller or ask for fewer realisations"
        )
    # a fixed shuffle: the first windows are the same for any number of realisations
    places = np.random.default_rng(case.micro.seed).permutation(room[0] * room[1])[:count]
    corners = [(place // room[1] * size[0], place % room[1] * size[1]) for place in places]
    periodic = mirror if settings.periodic == "mirror" else window
    windows = []
    for piece in _cut(whole, corners, size, (pixels[0], pixels[1])):
        smooth = resample(low_pass(periodic(detrend(piece)), cutoff), case.cell.points)
        if np.ptp(smooth.heights) == 0.0:
            raise CaseError(
                f"{settings.file.name} has a window of constant height; fill or crop it"
            )
        windows.append(smooth)
    return windows


def _cutoff(
    settings: InstrumentSurface, size: tuple[float, float], spacing: float, pixel: float
) -> float:
    """Shortest wavelength to keep, m: what the case says, or what grid and pixels resolve."""
    resolved = max(POINTS_PER_WAVE * spacing, 2.0 * pixel)
    cutoff = settings.short_cutoff or resolved
    if cutoff < 2.0 * max(spacing, pixel):
        raise CaseError(
            f"short_cutoff {cutoff:.3g} m is finer than the grid; with {spacing:.3g} m between its "
            f"points and {pixel:.3g} m between the measured ones it must be at least "
            f"{2.0 * max(spacing, pixel):.3g} m, better {resolved:.3g} m"
        )
    if cutoff > 0.5 * min(size):
        raise CaseError(
            f"short_cutoff {cutoff:.3g} m leaves no roughness in a cell of {min(size):.3g} m; it "
            f"must be at most half as long as the cell"
        )
    return cutoff


def _cut(
    whole: Surface,
    corners: list[tuple[float, float]],
    size: tuple[float, float],
    points: tuple[int, int],
) -> list[Surface]:
    """Windows of exact size with about as many points as were measured, by a cubic spline."""
    from scipy.interpolate import RectBivariateSpline

    axes = [np.arange(n) * step for n, step in zip(whole.heights.shape, whole.spacing, strict=True)]
    spline = RectBivariateSpline(*axes, whole.heights, s=0)
    return [
        Surface(
            spline(
                *(
                    np.minimum(corner[k] + np.arange(points[k]) * size[k] / points[k], axes[k][-1])
                    for k in range(2)
                )
            ),
            size,
        )
        for corner in corners
    ]
