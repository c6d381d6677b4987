"""Solution of the contacts of a step: by sweeps, then by an assembled problem if they fail."""

import numpy as np

from multiscale.macro.granulate.assembled_grains import solve_assembled
from multiscale.macro.granulate.contacts import Contacts, colour_pairs
from multiscale.macro.granulate.model import Model, Solver
from multiscale.macro.granulate.sweeps import (
    apply_impulses,
    closing_size,
    natural_map_error,
    relax,
    relax_coloured,
)

__all__ = ["solve_velocities"]

SWEEPS_PER_CHECK = 10
"""Number of sweeps between two evaluations of the error."""


def solve_velocities(
    model: Model, solver: Solver, velocity: np.ndarray, contacts: Contacts, cell: np.ndarray
) -> tuple[int, float]:
    r"""Solve the contacts of a step in place.

    Parameters
    ----------
    solver : Solver, tolerance, limits and threads
    velocity, cell : ndarray
        Arrays of :mod:`multiscale.macro.granulate.sweeps` without the impulses; the impulses are
        added in place.
    contacts : Contacts
        Contacts of the step; their impulses are the initial guess and become the solution.

    Returns
    -------
    sweeps : int, number of sweeps made
    residual : float
        Natural-map error relative to the closing velocities without impulses, dimensionless.
    """
    ends, data, coulomb, impulse, anchor = contacts.arrays
    strained = cell if model.pressure is not None else None
    scale = closing_size(velocity, ends, data, coulomb, strained)
    if scale == 0.0:
        impulse[:] = 0.0
        return 0, 0.0
    free, mobility = velocity.copy(), model.mobility
    apply_impulses(velocity, mobility, ends, data, coulomb, impulse, strained)
    limits = (solver.tolerance * scale, solver.max_iterations, SWEEPS_PER_CHECK)
    if strained is not None or solver.threads == 1:
        done, error = relax(velocity, mobility, *contacts.arrays, strained, *limits)
    else:
        moves = np.asarray(mobility.any(axis=1))
        order, bounds = colour_pairs(ends, model.grains.n, moves)
        sorted_contacts = contacts.reordered(order)
        arrays = (velocity, mobility, *sorted_contacts.arrays)
        done, error = relax_coloured(*arrays, bounds, solver.threads, *limits)
        impulse[order] = sorted_contacts.impulse
    if error <= limits[0] or strained is not None or len(ends) > solver.most_assembled:
        return done, error / scale
    found = solve_assembled(free, mobility, contacts, 0.1 * solver.tolerance)
    apply_impulses(free, mobility, ends, data, coulomb, found, None)
    new = natural_map_error(free, ends, data, coulomb, found, anchor, None)
    if new < error:
        velocity[:], impulse[:], error = free, found, new
    return done, error / scale
