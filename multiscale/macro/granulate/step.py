"""Solution of the contacts of a step: by sweeps, then by an assembled problem if they fail."""

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.fe.elements import sum_blocks
from multiscale.macro.granulate.contacts import Contacts, colour_pairs
from multiscale.macro.granulate.model import Model, Solver
from multiscale.macro.granulate.sweeps import (
    apply_impulses,
    closing_size,
    natural_map_error,
    relax,
    relax_coloured,
)
from multiscale.nonsmooth import solve_friction, solve_lcp

__all__ = ["solve_velocities"]

SWEEPS_PER_CHECK = 10
"""Number of sweeps between two evaluations of the error."""


def solve_velocities(
    model: Model, solver: Solver, velocity: np.ndarray, contacts: Contacts, cell: np.ndarray
) -> tuple[int, float]:
    r"""Solve the contacts of a step in place."""
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
    found = _solve_assembled(free, mobility, contacts, 0.1 * solver.tolerance)
    apply_impulses(free, mobility, ends, data, coulomb, found, None)
    new = natural_map_error(free, ends, data, coulomb, found, anchor, None)
    if new < error:
        velocity[:], impulse[:], error = free, found, new
    return done, error / scale


def _solve_assembled(
    velocity: np.ndarray, mobility: np.ndarray, contacts: Contacts, tolerance: float
) -> np.ndarray:
    """Solve the assembled problem by :func:`multiscale.nonsmooth.solve_friction`, or as an LCP.

    It serves problems on which Gauss-Seidel stalls: heavy grains on light grains, wedges. It takes
    the arguments of :func:`solve_velocities`, with velocities before the impulses act. It returns
    impulses, N s, of the shape of ``contacts.impulse``, that may miss the tolerance.
    """
    ends, data, coulomb, impulse, anchor = contacts.arrays
    if coulomb is None:
        return _solve_normal(velocity, mobility, contacts, tolerance)
    m = len(ends)
    normal = data[:, :3]
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    first /= np.linalg.norm(first, axis=1)[:, None]
    # (contacts, 3, 3), right-handed: rows normal and tangents
    frames = np.stack([normal, first, np.cross(normal, first)], axis=1)
    transfer, inverse = _transfer(frames, ends, mobility)
    across = coulomb[:, 0]
    compliance = data[:, 5:6] / np.column_stack([data[:, 4], across, across])  # 1/kg
    operator = transfer.T @ diags_array(inverse) @ transfer + diags_array(compliance.ravel())

    u = velocity[ends[:, 0]] - velocity[ends[:, 1]]
    turning = velocity[ends[:, 0], 4:7] + velocity[ends[:, 1], 4:7]
    free = np.einsum("cab,cb->ca", frames, u[:, :3] - np.cross(turning, data[:, :3]))
    free[:, 0] += data[:, 3]
    free -= compliance * np.einsum("cab,cb->ca", frames, anchor)
    begin = np.einsum("cab,cb->ca", frames, impulse).ravel()
    found = solve_friction(
        csr_array(operator), free.ravel(), coulomb[:, 1], tolerance=tolerance, start=begin
    )
    return np.asarray(np.einsum("cab,ca->cb", frames, found.value.reshape(m, 3)))


def _solve_normal(
    velocity: np.ndarray, mobility: np.ndarray, contacts: Contacts, tolerance: float
) -> np.ndarray:
    """Solve frictionless contacts: one impulse per contact, three velocities per body."""
    normal, m = contacts.data[:, :3], len(contacts.ends)
    compliance = contacts.data[:, 5] / contacts.data[:, 4]  # 1/kg
    at = (3 * contacts.ends[:, :, None] + np.arange(3)).reshape(m, 6)
    values = np.hstack([normal, -normal])[:, :, None]
    transfer = sum_blocks(values, at, np.arange(m)[:, None], (3 * len(mobility), m))
    inverse = np.repeat(mobility[:, 0], 3)
    operator = transfer.T @ diags_array(inverse) @ transfer + diags_array(compliance)
    free = transfer.T @ velocity[:, :3].ravel() + contacts.data[:, 3]
    free -= compliance * contacts.anchor[:, 0]
    found = solve_lcp(csr_array(operator), free, tolerance=tolerance, start=contacts.impulse[:, 0])
    return np.asarray(found.value[:, None])


def _transfer(
    frames: np.ndarray, ends: np.ndarray, mobility: np.ndarray
) -> tuple[csr_array, np.ndarray]:
    r"""Return H, from contact impulses to momenta of bodies, and the inverse masses, 1/kg.

    The unknowns of a body are its velocity and radius times spin. A loaded wall moves along its
    normal only, so its entries of the tangential columns are zero.
    """
    m, bodies = len(ends), len(mobility)
    transfer, place = csr_array((6 * bodies, 3 * m)), np.arange(3 * m).reshape(m, 3)
    spin = np.cross(frames[:, :1], frames)  # n x axis, by axis
    for side, sign in ((0, 1.0), (1, -1.0)):
        body = ends[:, side]
        across = np.where(mobility[body, 1] > 0.0, 1.0, 0.0)
        axes = frames.copy()
        axes[:, 1:] *= across[:, None, None]
        for block, first, factor in ((axes, 0, sign), (-spin, 3, 1.0)):
            at = 6 * body[:, None] + first + np.arange(3)
            values = factor * block.transpose(0, 2, 1)
            transfer = transfer + sum_blocks(values, at, place, transfer.shape)
    return csr_array(transfer), np.repeat(mobility[:, [0, 2]], 3, axis=1).ravel()
