"""The flat cell: small slopes, one unknown per contact node, no unknowns in the depth."""

import numpy as np
from scipy import fft

from multiscale.convergence import Status
from multiscale.micro.cell import Cell, lame_parameters
from multiscale.micro.contact import ContactProblem, ContactState
from multiscale.micro.flat import solve_flat
from multiscale.micro.lateral_fft import surface_compliance
from multiscale.micro.mesh import graded_planes

__all__ = ["assemble_flat_cell"]

TOLERANCE = 1e-6  # relative to the range of the gap; see solve_flat


def assemble_flat_cell(cell: Cell) -> ContactProblem:
    """Set up the contact of a cell whose roughness is gap alone, on a flat elastic layer."""
    heights, spacing = cell.surface.heights, cell.surface.spacing
    nx, ny = heights.shape
    area = spacing[0] * spacing[1]
    lame, shear = (
        np.full(cell.layers, float(value))
        for value in lame_parameters(cell.youngs_modulus, cell.poissons_ratio)
    )
    symbol = surface_compliance(
        (nx, ny),
        spacing,
        graded_planes(cell.depth, cell.layers, min(spacing)),
        lame,
        shear,
        mean_dilatation=cell.nearly_incompressible,
    )[5]
    obstacle = np.zeros((nx, ny)) if cell.obstacle is None else cell.obstacle.heights
    obstacle = obstacle + np.max(heights - obstacle)
    normal = np.zeros((nx, 3, ny))
    normal[:, 2] = 1.0

    def respond(force: np.ndarray) -> np.ndarray:
        return np.asarray(fft.irfft2(fft.rfft2(force) * symbol, s=force.shape, overwrite_x=True))

    def solve(
        *,
        load: float | None,
        approach: float | None,
        start: ContactState | None,
        tolerance: float,
    ) -> ContactState:
        gap, closing = obstacle - heights, np.ones((nx, ny))
        if load == 0.0 or (approach is not None and approach <= 0.0):
            nothing, touch = np.zeros((nx, ny)), 0.0 if approach is None else approach
            return ContactState(
                np.zeros((nx, 3, ny)),
                nothing,
                touch,
                nothing > 0.0,
                nothing,
                Status.CONVERGED,
                (0.0,),
            )
        force, delta, residuals = solve_flat(
            respond,
            gap,
            closing,
            load=load,
            approach=approach,
            start=None if start is None else start.force,
            max_iterations=5000,
            tolerance=max(tolerance, TOLERANCE),
        )
        displacement = np.zeros((nx, 3, ny))
        displacement[:, 2] = -respond(force)
        done = residuals[-1] <= max(tolerance, TOLERANCE)
        status = Status.CONVERGED if done else Status.MAX_ITERATIONS
        return ContactState(
            displacement, force, delta, force > 0.0, force, status, (residuals[-1],), len(residuals)
        )

    return ContactProblem(
        solve,
        normal,
        heights,
        obstacle,
        np.full((nx, ny), area),
        surface_displacement=lambda u: u,
        recover=None,
    )
