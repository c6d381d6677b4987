"""From a case to its cells: surfaces of both bodies, and one elastic body that stands for both."""

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import read_surface
from multiscale.io.surfaces import Surface
from multiscale.micro.cell import Cell, contact_modulus
from multiscale.micro.topography import (
    composite,
    crop,
    detrend,
    low_pass,
    mirror,
    resample,
    self_affine,
    window,
)
from multiscale.pipeline.case import POINTS_PER_WAVE, Body, Case, InstrumentSurface

__all__ = ["composite_material", "make_cells"]


def composite_material(case: Case) -> tuple[float, float]:
    r"""Young's modulus, Pa, and Poisson's ratio of the body that stands for both.

    Its contact modulus is that of the pair, :math:`1/E^* = \sum (1-\nu_i^2)/E_i`. For small slopes
    and without friction nothing else of the elastic constants enters; Poisson's ratio is the mean
    weighted by compliance.
    """
    pair = [(body.youngs_modulus, body.poissons_ratio) for body in (case.body_1, case.body_2)]
    compliance = [(1.0 - nu**2) / modulus for modulus, nu in pair]
    nu = float(np.average([nu for _, nu in pair], weights=compliance))
    return contact_modulus(*pair) * (1.0 - nu**2), nu


def make_cells(case: Case) -> list[Cell]:
    """Build the cell of each realisation.

    Raises
    ------
    CaseError
        If a surface cannot be made or read, or a map has too few windows.
    """
    modulus, nu = composite_material(case)
    sides = [_surfaces(case, number) for number in (1, 2)]
    depth = case.cell.depth if case.cell.depth is not None else max(case.cell.size)
    cells = []
    for k in range(case.micro.realisations):
        rough = [side[k] for side in sides if side]
        surface = rough[0] if len(rough) == 1 else composite(rough[0], rough[1])
        cells.append(Cell(surface, depth, case.cell.layers, modulus, nu))
    return cells


def _surfaces(case: Case, number: int) -> list[Surface]:
    """Realisations of one body's surface; none if it is smooth."""
    body: Body = (case.body_1, case.body_2)[number - 1]
    settings = body.surface
    if settings is None:
        return []
    try:
        if isinstance(settings, InstrumentSurface):
            return _windows(case, settings, reverse=number == 2)
        return [
            self_affine(
                case.cell.points,
                case.cell.size,
                2 * (case.micro.seed + k) + number - 1,  # the two sides are independent
                **settings.model_dump(),
            )
            for k in range(case.micro.realisations)
        ]
    except CaseError as error:
        raise CaseError(f"[body_{number}.surface] {error}") from error


def _windows(case: Case, settings: InstrumentSurface, *, reverse: bool) -> list[Surface]:
    """Cut a measured map into one periodic window per realisation."""
    whole = read_surface(
        settings.file,
        detrend_order=settings.detrend_order,
        fill_undefined=settings.fill_undefined,
    )
    share = 0.5 if settings.periodic == "mirror" else 1.0
    nx, ny = (
        max(2, round(share * length / step))
        for length, step in zip(case.cell.size, whole.spacing, strict=True)
    )
    room = (whole.heights.shape[0] // nx, whole.heights.shape[1] // ny)
    wanted = case.micro.realisations
    if room[0] * room[1] < wanted:
        size = " x ".join(f"{length:.3g}" for length in whole.size)
        part = " x ".join(f"{share * length:.3g}" for length in case.cell.size)
        raise CaseError(
            f"{settings.file.name} measures {size} m and holds {room[0] * room[1]} separate "
            f"windows of {part} m, but {wanted} realisations are asked for; make the cell smaller "
            f"or ask for fewer"
        )
    origins = [(i * nx, j * ny) for i in range(room[0]) for j in range(room[1])]
    if reverse:
        origins = origins[::-1]
    spacing = [length / n for length, n in zip(case.cell.size, case.cell.points, strict=True)]
    cutoff = settings.short_cutoff or POINTS_PER_WAVE * max(spacing)
    if cutoff < 2.0 * max(spacing):
        raise CaseError(
            f"short_cutoff {cutoff:.3g} m is finer than the grid; with a spacing of "
            f"{max(spacing):.3g} m it must be at least {2.0 * max(spacing):.3g} m, better "
            f"{POINTS_PER_WAVE * max(spacing):.3g} m"
        )
    periodic = mirror if settings.periodic == "mirror" else window
    windows = []
    for k in np.linspace(0, len(origins) - 1, wanted).round().astype(int):
        piece = periodic(detrend(crop(whole, origins[k], (nx, ny))))
        piece = resample(low_pass(piece, cutoff), case.cell.points)
        # the window is a whole number of measured points: give it the exact size of the cell
        windows.append(Surface(piece.heights, case.cell.size))
    return windows
