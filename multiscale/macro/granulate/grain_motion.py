r"""Time steps of rigid grains in frictional contact, eqs (6) and (9) of the source."""

from dataclasses import dataclass, replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from multiscale.macro.granulate.contacts import (
    Contacts,
    allowed_step,
    build_contacts,
    missed,
    penetration,
)
from multiscale.macro.granulate.grain_energy import account_grains, cell_inertia
from multiscale.macro.granulate.grain_state import GrainState, look_around
from multiscale.macro.granulate.model import Model, Solver
from multiscale.macro.granulate.step import solve_velocities

__all__ = ["Step", "step_grains"]

NEAR = 0.02
"""Pairs that come this near, relative to the smaller radius, are contacts from the outset."""

ALLOWED = (1e-3, 8e-3)
"""Overlap that a pair without contact, and a compliant contact, may have after a step, relative to
the smaller radius."""


@dataclass(frozen=True)
class Step:
    """How a step went: energies in J, times in s, the rest dimensionless.

    ``stress`` are the mean normal stresses of a cell under a pressure along its axes, Pa.
    """

    residual: float
    converged: bool
    sweeps: int
    penetration: float
    n_contacts: int
    kinetic: float
    elastic: float
    work: float
    contact_dissipation: float
    numerical_dissipation: float
    damping: float
    search_time: float
    solver_time: float
    stress: np.ndarray | None


def step_grains(
    model: Model, state: GrainState, h: float, solver: Solver, accuracy: float | None = None
) -> tuple[GrainState, Step]:
    r"""Make one Moreau-Jean step.

    Parameters
    ----------
    model, state : Model, State
    h : float
        Length of the step, s, or the longest if an accuracy is given.
    solver : Solver
    accuracy : float, optional
        By how much grains may approach in the step of their impact, relative to the smaller radius.

    Returns
    -------
    state, step : State, Step
        The new state and how the step went.

    Notes
    -----
    With the gap :math:`g` at the beginning, the step solves (9) of the source,

    .. math::
        M (v^+ - v^-) = h F + H r, \quad u = H^T v^+, \quad x^+ = x^- + h v^+, \quad
        K_\mu \ni r \perp u + (b + \mu \|u_T\|) n \in K_\mu^*    \tag{1}

    with :math:`b = g/h`: the linearised gap at the end is not negative, and neither is the true one
    of two spheres, which is larger. Pairs that overlap after all are made contacts, compliant ones
    that overlap by more than 0.8 % of a radius become ten times stiffer, and the step is solved
    again. With restitution :math:`e` an impact in the first half of a step has :math:`b = e u^-`;
    one in the second half ends the step touching, and has it in the next. In steps of changing
    length the velocities are those in the middle of the steps, so that F acts from the middle of
    the last step to that of this one, and free flight is exact.
    """
    began = perf_counter()
    state, h, acted = _choose_step(model, state, h, accuracy)
    free = _push(model, state, acted)
    searched = perf_counter() - began
    met = _meet(model, state, solver, (h, acted, accuracy is not None), free)
    new = _move(model, state, (h, acted), met)
    worst, _ = penetration(
        new.pairs, new.position, model.grains.radius, new.period, model.walls_at(new.point)
    )
    energies = account_grains(
        model,
        (h, acted),
        (state.velocity, free.damped, new.velocity),
        met.contacts,
        -model.law.restitution * new.approach[met.numbers],
        (state.rate, free.damped_rate, new.rate),
        met.cell[2:],
        cell_inertia(model, state.period),
    )
    total = perf_counter() - began
    return new, Step(
        met.residual,
        met.residual <= solver.tolerance,
        met.sweeps,
        worst,
        int(np.count_nonzero(met.contacts.impulse.any(axis=1))),
        *energies,
        searched,
        total - searched,
        None if model.pressure is None else _stress(model, state.period, met, acted),
    )


def _stress(model: Model, period: np.ndarray, met: "_Met", acted: float) -> np.ndarray:
    """Diagonal of the mean stress after Love and Weber, shape (3,), Pa; tension positive."""
    moments = np.sum(met.contacts.vectors * met.cell[2:], axis=0)
    return np.asarray(-moments / (acted * model.volume(period)))


class _Free(NamedTuple):
    """Velocities after the damping and after the forces, and rates of strain of the cell there."""

    damped: np.ndarray
    velocity: np.ndarray
    damped_rate: np.ndarray
    rate: np.ndarray


class _Met(NamedTuple):
    """Contacts of a step with the ``numbers`` of their pairs, and the velocities after it.

    ``cell`` holds the rates of strain of the cell, one over the root of its inertia, and the
    branches along which it moves each contact.
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
    """Look for neighbours if need be; give the length of the step and the time that forces act."""
    if accuracy is None:
        return _with_neighbours(model, state, h, h), h, h
    fastest = float(np.sqrt(np.max(np.sum(state.velocity[:, :3] ** 2, axis=1))))
    h = min(h, float(model.grains.radius.mean()) / max(fastest, 1e-300))  # none passes unseen
    state = _with_neighbours(model, state, h, 0.5 * (state.last + h))
    h = allowed_step(
        state.pairs,
        state.kept,
        state.position,
        model.grains.radius,
        state.period,
        model.walls_at(state.point),
        state.velocity,
        h,
        state.last,
        accuracy,
        float(np.linalg.norm(model.gravity)),
    )
    acted = 0.5 * (state.last + h)
    if np.isfinite(state.acted):  # forces last, not impulses
        longer = acted / state.acted
        state = replace(state, kept=longer * state.kept, held=longer * state.held)
    return state, h, acted


def _with_neighbours(model: Model, state: GrainState, h: float, acted: float) -> GrainState:
    """Find the neighbours anew if grains may have come nearer than their list reaches."""
    n, radius = model.grains.n, model.grains.radius
    free = state.velocity + acted * model.push
    inertia, thrust = cell_inertia(model, state.period)
    told = np.abs(np.where(model.free, state.rate, model.told_rate))
    rate = float(told.max()) + acted * abs(thrust) / inertia
    moved = state.position - state.seen + h * free[:n, :3]
    speed = h * float(np.sqrt(np.max(np.sum(free[:, :3] ** 2, axis=1), initial=0.0)))
    reach = 2.0 * speed + 4.0 * h * rate * float(radius.max())
    farthest = 2.0 * float(np.sqrt(np.max(np.sum(moved**2, axis=1), initial=0.0)))
    return look_around(model, state, 2.0 * reach) if farthest + reach > state.margin else state


def _push(model: Model, state: GrainState, acted: float) -> _Free:
    """Let damping, gravity, walls and the pressure on the cell act, without impulses."""
    keep = np.exp(-model.damping_rate * acted)
    damped = state.velocity.copy()
    damped[: model.grains.n] *= keep
    inertia, thrust = cell_inertia(model, state.period)
    rate = np.where(model.free, state.rate if model.driven else keep * state.rate, model.told_rate)
    return _Free(
        damped, damped + acted * model.push, rate, rate + acted * thrust / inertia * model.free
    )


def _meet(
    model: Model, state: GrainState, solver: Solver, times: tuple[float, float, bool], free: _Free
) -> _Met:
    """Solve (1), again with the pairs that overlap after all."""
    h, acted, changing = times
    law = model.law
    shares = (0.5 * state.last / acted, 0.5 * h / acted) if changing else (0.0, 0.0)
    rest = 2.0 * acted * float(np.linalg.norm(model.gravity))
    constants = (law.restitution, law.relaxation * h, rest, *shares)
    place = (state.position, model.grains.radius, state.period, model.walls_at(state.point))
    inertia, _ = cell_inertia(model, state.period)
    wanted, hits = np.zeros(len(state.pairs), bool), np.zeros(len(state.pairs))
    compliance = np.full(len(state.pairs), law.compliance)
    kept, sweeps = state.kept, 0
    while True:
        arrays, index, cell, approach = build_contacts(
            state.pairs,
            kept,
            state.held,
            state.approach,
            hits,
            wanted,
            compliance,
            *place,
            free.damped,
            free.velocity,
            model.mobility,
            constants,
            model.friction,
            h,
            NEAR,
            np.array([free.rate, model.free / np.sqrt(inertia)]),
        )
        contacts, velocity = Contacts(*arrays), free.velocity.copy()
        done, residual = solve_velocities(model, solver, velocity, contacts, cell)
        sweeps += done
        kept = np.zeros_like(state.kept)
        kept[index] = contacts.impulse
        after = (velocity, h, cell[0], ALLOWED)
        if not missed(state.pairs, index, contacts.data, hits, wanted, compliance, *place, *after):
            break
    approach[~kept.any(axis=1)] = 0.0  # it passed by
    return _Met(contacts, index, velocity, approach, cell, sweeps, residual)


def _move(model: Model, state: GrainState, times: tuple[float, float], met: _Met) -> GrainState:
    """Move grains, walls and the cell, and keep what the next step begins from."""
    (h, acted), n, rate = times, model.grains.n, met.cell[0].copy()
    kept, held = np.zeros_like(state.kept), np.zeros_like(state.kept)
    kept[met.numbers] = met.contacts.impulse
    if model.law.compliance > 0.0:
        share = met.contacts.data[:, 5:6] / model.law.compliance
        held[met.numbers] = share * met.contacts.impulse
    stretch = np.where(model.strained, 1.0 + h * rate, 1.0)
    widest = 2.0 * float(model.grains.radius.max())  # pairs at the margin come nearer by the strain
    margin = min(1.0, float(stretch.min())) * (widest + state.margin) - widest
    return replace(
        state,
        time=state.time + h,
        position=stretch * state.position + h * met.velocity[:n, :3],
        velocity=met.velocity,
        point=state.point + h * met.velocity[n:, :3],
        period=stretch * state.period,
        seen=stretch * state.seen,
        margin=margin,
        kept=kept,
        held=held,
        approach=met.approach,
        rate=rate,
        last=h,
        acted=acted,
        contacts=met.contacts,
    )
