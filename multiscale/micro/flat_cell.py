"""The flat cell: small slopes, one unknown per contact node, no unknowns in the depth."""

from collections.abc import Callable
from functools import partial

import numpy as np

from multiscale.micro.cell import FlatCell, PeriodicLayer
from multiscale.micro.coating import coating_faces
from multiscale.micro.contact_state import (
    ContactState,
    ElasticCell,
    at_first_touch,
    untouched,
)
from multiscale.micro.flat import coarse_start, solve_flat
from multiscale.micro.lateral_fft import SurfaceFilter
from multiscale.micro.layered import layered_compliance
from multiscale.micro.slope_expansion import expanded_compliance

__all__ = ["assemble_flat_cell", "flat_gap"]

TOLERANCE = 1e-6  # relative to the range of the gap; see solve_flat


def flat_gap(cell: FlatCell) -> tuple[np.ndarray, float, np.ndarray]:
    """Heights of the obstacle at first touch, m, area of a node, m², symbol of the compliance, m/N.

    The symbol takes nodal forces, not pressures.
    """
    heights, spacing = cell.surface.heights, cell.surface.spacing
    area = spacing[0] * spacing[1]
    symbol = np.sum([_compliance(body) for body in cell.bodies], axis=0) / area
    obstacle, _ = at_first_touch(heights, 0.0 if cell.obstacle is None else cell.obstacle.heights)
    return obstacle, area, symbol


def _compliance(body: PeriodicLayer) -> np.ndarray:
    """Symbol of the compliance of one body, m/Pa; coatings have their exact thickness."""
    shape, size = body.surface.heights.shape, body.surface.size
    if not body.coating:
        return layered_compliance(shape, size, body.planes, *body.layer_moduli)
    faces = coating_faces(body.coating, body.depth)[::-1]
    planes = np.concatenate([[0.0], faces, [body.depth]])
    return layered_compliance(shape, size, planes, *body.moduli_between(planes))


def assemble_flat_cell(cell: FlatCell) -> ElasticCell:
    """Set up the contact of a cell whose roughness is gap alone, on a flat elastic layer."""
    heights = cell.surface.heights
    nx, ny = heights.shape
    obstacle, area, symbol = flat_gap(cell)
    normal = np.zeros((nx, 3, ny))
    normal[:, 2] = 1.0

    gap, closing = obstacle - heights, np.ones((nx, ny))
    flat = SurfaceFilter(symbol)
    respond: Callable[[np.ndarray], np.ndarray] = flat
    lift = respond  # along z; forces of expanded bodies act along their normal
    if cell.slope_order == 2:
        moduli = [np.array(body.layer_moduli)[:, 0] for body in cell.bodies]
        lame, shear = np.array([*moduli, (0.0, np.inf)][:2]).T
        respond = expanded_compliance(cell.surfaces, symbol, shear, 0.5 * lame / (lame + shear))
        lift = partial(respond, vertical=True)
    cap = np.inf if cell.hardness is None else cell.hardness * area

    def solve(
        *,
        load: float | None = None,
        approach: float | None = None,
        start: ContactState | None = None,
        tolerance: float = TOLERANCE,
    ) -> ContactState:
        if load == 0.0 or (approach is not None and approach <= 0.0):
            return untouched((nx, 3, ny), gap, closing, approach)
        guess = None
        if load is not None:
            guess = coarse_start(flat, gap, closing, load=load, cap=cap)
        if guess is None and start is not None:
            guess = start.force
        found = solve_flat(
            respond,
            gap,
            closing,
            load=load,
            approach=approach,
            cap=cap,
            start=guess,
            max_iterations=5000,
            tolerance=max(tolerance, TOLERANCE),
        )
        displacement = np.zeros((nx, 3, ny))
        displacement[:, 2] = -lift(found.value)
        return ContactState(
            displacement,
            found.value,
            found.approach,
            found.value > 0.0,
            found.value,
            found.status,
            found.residuals[-1:],
            len(found.residuals),
        )

    node_area = np.full((nx, ny), area)
    return ElasticCell(solve, normal, heights, obstacle, node_area, lambda u: u, cap=cap)
