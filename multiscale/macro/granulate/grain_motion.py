r"""Time steps of rigid grains in frictional contact, eqs (6) and (9) of the source."""

from dataclasses import replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from multiscale.macro.granulate.contacts import (
    Contacts,
    allowed_step,
    build_contacts,
    mark_overlaps,
    penetration,
)
from multiscale.macro.granulate.grain_energy import account_grains, cell_inertia
from multiscale.macro.granulate.grain_state import GrainState, update_neighbours
from multiscale.macro.granulate.model import Model, Solver
from multiscale.macro.granulate.step import solve_velocities

__all__ = ["step_grains"]

CONTACT_DISTANCE = 0.02
"""Gap below which a pair is a contact from the first solve on, relative to the smaller radius."""

ALLOWED_OVERLAP = (1e-3, 8e-3)
"""Allowed overlap after a step of a pair that is no contact, and of a compliant contact, relative
to the smaller radius."""


def step_grains(
    model: Model, state: GrainState, h: float, solver: Solver, accuracy: float | None = None
) -> tuple[GrainState, dict[str, Any]]:
    r"""Make one Moreau-Jean step.

    Notes
    -----
    With the gap :math:`g` at the beginning, the step solves (9) of the source,

    .. math::
        M (v^+ - v^-) = h F + H r, \quad u = H^T v^+, \quad x^+ = x^- + h v^+, \quad
        K_\mu \ni r \perp u + (b + \mu \|u_T\|) n \in K_\mu^*    \tag{1}

    with :math:`b = g/h`: the linearised gap at the end is not negative, and the true gap of two
    spheres is larger. If pairs that are no contacts overlap after the step they become contacts,
    compliant contacts that overlap by more than 0.8 % of a radius become ten times stiffer, and the
    step is solved again. With restitution :math:`e` an impact in the first half of a step has
    :math:`b = e u^-`; an impact in the second half ends the step in contact and bounces in the next
    step. In steps of changing length the velocities belong to the middle of the steps, so that F
    acts from the middle of the last step to the middle of this step, and free flight is exact.
    """
    began = perf_counter()
    state, h, acted = _choose_step(model, state, h, accuracy)
    # without impulses: damping, then gravity, forces on walls and the pressure on the cell
    keep, (inertia, thrust) = np.exp(-model.damping_rate * acted), cell_inertia(model, state.period)
    damped, damped_rate = state.velocity.copy(), state.rate if model.driven else keep * state.rate
    damped[: model.grains.n] *= keep
    damped_rate = np.where(model.free, damped_rate, model.prescribed_rate)
    velocity = damped + acted * model.free_acceleration
    cell = np.array(
        [damped_rate + acted * thrust / inertia * model.free, model.free / np.sqrt(inertia)]
    )
    times = (h, acted, accuracy is not None)
    solved = _solve_contacts(model, state, solver, times, (damped, velocity), cell)
    new = _advance(model, state, (h, acted), solved)
    worst, _ = penetration(
        new.pairs, new.position, model.grains.radius, new.period, model.walls_at(new.point)
    )
    done = {
        "residual": solved.residual,
        "converged": int(solved.residual <= solver.tolerance),
        "iterations": solved.sweeps,
        "penetration": worst,
        "n_contacts": int(np.count_nonzero(solved.contacts.impulse.any(axis=1))),
    }
    done |= account_grains(
        model,
        (h, acted),
        (state.velocity, damped, new.velocity),
        solved.contacts,
        -model.law.restitution * new.approach[solved.numbers],
        (state.rate, damped_rate, new.rate),
        solved.cell[2:],
        (inertia, thrust),
    )
    if model.pressure is not None:  # diagonal of the mean stress after Love and Weber
        moments = np.sum(solved.contacts.vectors * solved.cell[2:], axis=0)
        done["stress"] = -moments / (acted * model.volume(state.period))
    return new, done | {"wall_time": perf_counter() - began}


class _SolvedContacts(NamedTuple):
    """Solved contacts of a step.

    Attributes
    ----------
    contacts : Contacts, contacts with their impulses
    numbers : ndarray of int, shape (contacts,), number of the pair of each contact
    velocity : ndarray, shape (bodies, 4 or 8), velocities after the step, m/s
    approach : ndarray, shape (pairs,)
        Normal velocity before an impact that bounces in the next step, else zero, m/s.
    cell : ndarray, shape (contacts + 2, 3)
        Strain rates, inertia and branches, as in :mod:`multiscale.macro.granulate.sweeps`.
    sweeps : int, number of sweeps made
    residual : float, natural-map error, dimensionless
    """

    contacts: Contacts
    numbers: np.ndarray
    velocity: np.ndarray
    approach: np.ndarray
    cell: np.ndarray
    sweeps: int
    residual: float


def _choose_step(
    model: Model, state: GrainState, h: float, accuracy: float | None
) -> tuple[GrainState, float, float]:
    """Return the state with neighbours, the length of the step and the time of the forces, s."""
    if accuracy is None:
        return _with_neighbours(model, state, h, h), h, h
    fastest = float(np.sqrt(np.max(np.sum(state.velocity[:, :3] ** 2, axis=1))))
    # no grain leaves its neighbour list
    h = min(h, float(model.grains.radius.mean()) / max(fastest, 1e-300))
    state = _with_neighbours(model, state, h, 0.5 * (state.step_length + h))
    h = allowed_step(
        state.pairs,
        state.pair_impulse,
        state.position,
        model.grains.radius,
        state.period,
        model.walls_at(state.point),
        state.velocity,
        h,
        state.step_length,
        accuracy,
        float(np.linalg.norm(model.gravity)),
    )
    acted = 0.5 * (state.step_length + h)
    if np.isfinite(state.force_time):  # forces persist, not impulses
        longer = acted / state.force_time
        state = replace(
            state,
            pair_impulse=longer * state.pair_impulse,
            spring_impulse=longer * state.spring_impulse,
        )
    return state, h, acted


def _with_neighbours(model: Model, state: GrainState, h: float, acted: float) -> GrainState:
    """Update the neighbours if a pair outside their list may touch within the step."""
    n, radius = model.grains.n, model.grains.radius
    free = state.velocity + acted * model.free_acceleration
    inertia, thrust = cell_inertia(model, state.period)
    prescribed = np.abs(np.where(model.free, state.rate, model.prescribed_rate))
    rate = float(prescribed.max()) + acted * abs(thrust) / inertia
    moved = state.position - state.listed_position + h * free[:n, :3]
    speed = h * float(np.sqrt(np.max(np.sum(free[:, :3] ** 2, axis=1), initial=0.0)))
    reach = 2.0 * speed + 4.0 * h * rate * float(radius.max())
    farthest = 2.0 * float(np.sqrt(np.max(np.sum(moved**2, axis=1), initial=0.0)))
    if farthest + reach > state.list_reach:
        return update_neighbours(model, state, 2.0 * reach)
    return state


def _solve_contacts(
    model: Model,
    state: GrainState,
    solver: Solver,
    times: tuple[float, float, bool],
    velocities: tuple[np.ndarray, np.ndarray],
    cell: np.ndarray,
) -> _SolvedContacts:
    """Solve (1), and again if other pairs overlap.

    ``velocities`` hold the velocities before and after the forces act, without impulses, m/s, and
    ``cell`` goes to :func:`build_contacts`.
    """
    h, acted, changing = times
    law = model.law
    shares = (0.5 * state.step_length / acted, 0.5 * h / acted) if changing else (0.0, 0.0)
    rest = 2.0 * acted * float(np.linalg.norm(model.gravity))
    constants = (law.restitution, law.relaxation * h, rest, *shares)
    place = (state.position, model.grains.radius, state.period, model.walls_at(state.point))
    wanted, hits = np.zeros(len(state.pairs), bool), np.zeros(len(state.pairs))
    compliance = np.full(len(state.pairs), law.compliance)
    pair_impulse, sweeps = state.pair_impulse, 0
    while True:
        arrays, index, stretch, approach = build_contacts(
            state.pairs,
            pair_impulse,
            state.spring_impulse,
            state.approach,
            hits,
            wanted,
            compliance,
            *place,
            *velocities,
            model.mobility,
            constants,
            model.friction,
            h,
            CONTACT_DISTANCE,
            cell,
        )
        contacts, velocity = Contacts(*arrays), velocities[1].copy()
        done, residual = solve_velocities(model, solver, velocity, contacts, stretch)
        sweeps += done
        pair_impulse = np.zeros_like(state.pair_impulse)
        pair_impulse[index] = contacts.impulse
        marks, after = (hits, wanted, compliance), (velocity, h, stretch[0], ALLOWED_OVERLAP)
        if not mark_overlaps(state.pairs, index, contacts.data, *marks, *place, *after):
            break
    approach[~pair_impulse.any(axis=1)] = 0.0  # no impact took place
    return _SolvedContacts(contacts, index, velocity, approach, stretch, sweeps, residual)


def _advance(
    model: Model, state: GrainState, times: tuple[float, float], solved: _SolvedContacts
) -> GrainState:
    """Return the state after the step: grains, walls and cell moved, impulses stored by pair."""
    (h, acted), n, rate = times, model.grains.n, solved.cell[0].copy()
    pair_impulse = np.zeros_like(state.pair_impulse)
    spring_impulse = np.zeros_like(pair_impulse)
    pair_impulse[solved.numbers] = solved.contacts.impulse
    if model.law.compliance > 0.0:
        share = solved.contacts.data[:, 5:6] / model.law.compliance
        spring_impulse[solved.numbers] = share * solved.contacts.impulse
    stretch = np.where(model.strained, 1.0 + h * rate, 1.0)
    widest = 2.0 * float(model.grains.radius.max())  # the strain brings pairs at the margin nearer
    margin = min(1.0, float(stretch.min())) * (widest + state.list_reach) - widest
    return replace(
        state,
        time=state.time + h,
        position=stretch * state.position + h * solved.velocity[:n, :3],
        velocity=solved.velocity,
        point=state.point + h * solved.velocity[n:, :3],
        period=stretch * state.period,
        listed_position=stretch * state.listed_position,
        list_reach=margin,
        pair_impulse=pair_impulse,
        spring_impulse=spring_impulse,
        approach=solved.approach,
        rate=rate,
        step_length=h,
        force_time=acted,
        contacts=solved.contacts,
    )
