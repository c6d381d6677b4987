"""The contacts of one step: sweeps first, and what they do not solve another way."""

import numpy as np

from multiscale.macro.granulate.assembled_grains import solve_assembled
from multiscale.macro.granulate.contacts import Contacts, colour
from multiscale.macro.granulate.model import Model, Solver
from multiscale.macro.granulate.sweeps import (
    apply_impulses,
    closing_size,
    natural_map_error,
    relax,
    relax_coloured,
)

__all__ = ["solve_velocities"]

BURST = 10
"""Sweeps between two looks at the error."""


def solve_velocities(
    model: Model,
    solver: Solver,
    velocity: np.ndarray,
    contacts: Contacts,
    cell: np.ndarray,
) -> tuple[int, float]:
    r"""Solve the contacts of a step in place.

    Parameters
    ----------
    model, solver : Model, Solver
    velocity, cell : ndarray
        Arrays of :mod:`multiscale.macro.granulate.sweeps`; the velocities are those without
        impulses and become those with them.
    contacts : Contacts
        Whose impulses are a guess and become the solution.

    Returns
    -------
    sweeps : int
        Number of sweeps made.
    residual : float
        Natural-map error relative to the velocities of the contacts that would close.
    """
    ends, data, coulomb, impulse, anchor = contacts.arrays
    strained = cell if model.pressure is not None else None
    scale = closing_size(velocity, ends, data, coulomb, strained)
    if scale == 0.0:
        impulse[:] = 0.0
        return 0, 0.0
    free, mobility, target = velocity.copy(), model.mobility, solver.tolerance * scale
    apply_impulses(velocity, mobility, ends, data, coulomb, impulse, strained)
    limit = solver.max_iterations
    if strained is not None or solver.threads == 1:
        done, error = relax(velocity, mobility, *contacts.arrays, strained, target, limit, BURST)
    else:
        moves = np.asarray(mobility.any(axis=1))
        order, bounds = colour(ends, model.grains.n, moves)
        sorted_contacts = contacts.reordered(order)
        arrays = (velocity, mobility, *sorted_contacts.arrays)
        done, error = relax_coloured(*arrays, bounds, solver.threads, target, limit, BURST)
        impulse[order] = sorted_contacts.impulse
    if error <= target or strained is not None or len(ends) > solver.most_assembled:
        return done, error / scale
    found = solve_assembled(free, mobility, contacts, 0.1 * solver.tolerance)
    apply_impulses(free, mobility, ends, data, coulomb, found, None)
    new = natural_map_error(free, ends, data, coulomb, found, anchor, None)
    if new < error:
        velocity[:], impulse[:], error = free, found, new
    return done, error / scale
