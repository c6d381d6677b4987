r"""Time steps of rigid grains in frictional contact, eqs (6) and (9) of the source."""

from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.contact_solver import solve_velocities
from multiscale.macro.granulate.contacts import (
    Contacts,
    allowed_step,
    build_contacts,
    find_wall_pairs,
    mark_overlaps,
    penetration,
)
from multiscale.macro.granulate.model import Model, Solver
from multiscale.macro.granulate.neighbours import find_pairs

__all__ = ["GrainState", "initial_state", "step_grains"]

LIST_MARGIN = 0.3
"""Reach of the neighbour list beyond the motion of a step, relative to the mean radius."""

ALLOWED_START_OVERLAP = 0.01
"""Allowed overlap of grains at the start, relative to the smaller radius."""

CONTACT_DISTANCE = 0.02
"""Gap below which a pair is a contact from the first solve on, relative to the smaller radius."""

ALLOWED_OVERLAP = (1e-3, 8e-3)
"""Allowed overlap after a step of a pair that is no contact, and of a compliant contact, relative
to the smaller radius."""


@dataclass(frozen=True)
class GrainState:
    """State of grains, walls and cell at a time; impulses have c = 1 or 3 components.

    Attributes
    ----------
    time : float, s
    position : ndarray, shape (grains, 3), centres, m
    velocity : ndarray, shape (bodies, 4 or 8)
        Velocities and radius times spin, as in :mod:`~multiscale.macro.granulate.contact_solver`.
    point : ndarray, shape (walls, 3), A point on each wall, m
    period : ndarray, shape (3,), periods of the cell, m; infinite along axes without a period
    pairs : ndarray of int32, shape (pairs, 2)
        Neighbours: two grains, or a grain and a wall, numbered after the grains.
    pair_impulse : ndarray, shape (pairs, c), impulse of each pair in the last step, N s
    spring_impulse : ndarray, shape (pairs, c)
        Part of the last impulse carried by the contact springs, N s.
    approach : ndarray, shape (pairs,)
        Normal velocity before an impact that bounces in the next step, else zero, m/s.
    listed_position : ndarray, shape (grains, 3), centres at which the neighbours were found, m
    list_reach : float, largest gap of the listed pairs, m
    rate : ndarray, shape (3,), strain rates of the cell, 1/s
    step_length : float, length of the last step, s
    force_time : float
        Time in which the forces of the last step acted, s; nan before the first step.
    contacts : Contacts, contacts of the last step
    """

    time: float
    position: np.ndarray
    velocity: np.ndarray
    point: np.ndarray
    period: np.ndarray
    pairs: np.ndarray
    pair_impulse: np.ndarray
    spring_impulse: np.ndarray
    approach: np.ndarray
    listed_position: np.ndarray
    list_reach: float
    rate: np.ndarray
    step_length: float
    force_time: float
    contacts: Contacts


def initial_state(model: Model) -> GrainState:
    """Return the state at time zero with its neighbours, without impulses."""
    grains, walls = model.grains, model.walls
    velocity = np.zeros_like(model.free_acceleration)
    velocity[: grains.n, :3] = grains.velocity
    if model.turns:
        velocity[: grains.n, 4:7] = grains.radius[:, None] * grains.spin
    for w, wall in enumerate(walls, grains.n):
        velocity[w, :3] = wall.velocity
    point = np.array([wall.point for wall in walls], dtype=float).reshape(-1, 3)
    none = np.empty((0, 2), np.int32)
    impulse = np.empty((0, 3 if model.frictional else 1))
    coulomb = np.empty((0, 2)) if model.frictional else None
    empty = Contacts(none, np.empty((0, 6)), coulomb, impulse, impulse)
    state = GrainState(
        0.0,
        grains.position,
        velocity,
        point,
        np.array(model.period, dtype=float),
        none,
        impulse,
        impulse,
        np.empty(0),
        grains.position,
        0.0,
        np.zeros(3),
        0.0,
        np.nan,
        empty,
    )
    state = _update_neighbours(model, state, 0.0)

    gravity = np.asarray(model.gravity, dtype=float)
    if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
        raise CaseError(f"gravity must be three finite numbers (m/s2), got {model.gravity}")
    below = any(np.isinf(model.period[a]) and gravity[a] != 0.0 for a in range(3)) and not any(
        wall.holds(gravity) for wall in model.walls
    )
    if below:
        raise CaseError(
            f"no wall supports the grains against gravity {tuple(map(float, gravity))} m/s2: they "
            f"fall for ever; close the box or set gravity to zero"
        )
    shapes = model.walls_at(state.point)
    worst, which = penetration(state.pairs, state.position, grains.radius, state.period, shapes)
    if worst > ALLOWED_START_OVERLAP:
        i, j = (int(body) for body in state.pairs[which])
        other = f"grain {j}" if j < grains.n else f"wall {j - grains.n}"
        raise CaseError(
            f"grain {i} overlaps {other} by {worst:.3g} of its radius at the start, at most "
            f"{ALLOWED_START_OVERLAP:g} is allowed; move them apart"
        )
    return state


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
    keep, (inertia, thrust) = (
        np.exp(-model.damping_rate * acted),
        _cell_inertia(model, state.period),
    )
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
    done |= _account_grains(
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
        Strain rates, inertia and branches, as in :mod:`multiscale.macro.granulate.contact_solver`.
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
    inertia, thrust = _cell_inertia(model, state.period)
    prescribed = np.abs(np.where(model.free, state.rate, model.prescribed_rate))
    rate = float(prescribed.max()) + acted * abs(thrust) / inertia
    moved = state.position - state.listed_position + h * free[:n, :3]
    speed = h * float(np.sqrt(np.max(np.sum(free[:, :3] ** 2, axis=1), initial=0.0)))
    reach = 2.0 * speed + 4.0 * h * rate * float(radius.max())
    farthest = 2.0 * float(np.sqrt(np.max(np.sum(moved**2, axis=1), initial=0.0)))
    if farthest + reach > state.list_reach:
        return _update_neighbours(model, state, 2.0 * reach)
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


def _update_neighbours(model: Model, state: GrainState, reach: float) -> GrainState:
    """Return the state with a new list of neighbours, and the impulses of those already listed."""
    radius, n = model.grains.radius, model.mobility.shape[0]
    margin = reach + LIST_MARGIN * float(radius.mean())
    least = 2.0 * (2.0 * float(radius.max()) + margin)  # a pair has one shortest distance
    short = np.flatnonzero(state.period < least)
    if short.size:
        raise CaseError(
            f"period along {'xyz'[short[0]]} is {state.period[short[0]]:.4g} m and must be at "
            f"least {least:.4g} m, twice the reach of the largest grains"
        )
    walls = model.walls_at(state.point)
    near = find_pairs(state.position, radius, margin, state.period)
    at_walls = find_wall_pairs(state.position, radius, margin, state.period, *walls)
    pairs = np.concatenate([near, at_walls])
    # from the bottom upwards, so that one sweep carries impulses through the pile
    height = -(state.position @ np.asarray(model.gravity))
    lower = np.minimum(
        height[pairs[:, 0]], np.append(height, np.full(len(model.walls), -np.inf))[pairs[:, 1]]
    )
    pairs = pairs[np.argsort(lower, kind="stable")]
    pair_impulse = np.zeros((len(pairs), state.pair_impulse.shape[1]))
    spring_impulse = np.zeros_like(pair_impulse)
    approach = np.zeros(len(pairs))
    if len(state.pairs) and len(pairs):
        before = state.pairs[:, 0].astype(np.int64) * n + state.pairs[:, 1]
        now = pairs[:, 0].astype(np.int64) * n + pairs[:, 1]
        order = np.argsort(before)
        found = np.minimum(np.searchsorted(before, now, sorter=order), before.size - 1)
        same = before[order[found]] == now
        pair_impulse[same] = state.pair_impulse[order[found[same]]]
        spring_impulse[same] = state.spring_impulse[order[found[same]]]
        approach[same] = state.approach[order[found[same]]]
    return replace(
        state,
        pairs=pairs,
        pair_impulse=pair_impulse,
        spring_impulse=spring_impulse,
        approach=approach,
        listed_position=state.position,
        list_reach=margin,
    )


def _cell_inertia(model: Model, period: np.ndarray) -> tuple[float, float]:
    r"""Return the inertia of a periodic cell, kg m2, and the moment of the pressure on it, J.

    The inertia belongs to an affine motion of the grains, :math:`m L^2 / 4`; the power of the
    pressure is :math:`-p\,V\,d\,\dot\varepsilon` for the d directions in which the cell strains
    freely. If a strain rate is prescribed along another axis, the smaller inertia
    :math:`m (2 R)^2` makes the cell follow the pressure. The inertia of a cell of given size is
    infinite.
    """
    if model.pressure is None:
        return np.inf, 0.0
    edges, mass = period[model.free], float(model.grains.mass.sum())
    if model.driven:
        inertia = mass * float(2.0 * model.grains.radius.mean()) ** 2
    else:
        inertia = 0.25 * mass * float(np.mean(edges**2))
    return inertia, -model.pressure * model.volume(period) * edges.size


def _account_grains(
    model: Model,
    times: tuple[float, float],
    velocities: tuple[np.ndarray, np.ndarray, np.ndarray],
    contacts: Contacts,
    rebound: np.ndarray,
    rates: tuple[np.ndarray, np.ndarray, np.ndarray],
    branch: np.ndarray,
    cell: tuple[float, float],
) -> dict[str, float]:
    r"""Return kinetic and elastic energy, work, and dissipation by contacts, scheme and damping, J.

    Notes
    -----
    With :math:`\Delta v` the change of velocity after the damping, the kinetic energy grows by

        work - contact dissipation - numerical dissipation - damping,

    where the contacts dissipate :math:`-r \cdot u` and the scheme
    :math:`\Delta v^T M \Delta v / 2`.

    The spring of a compliant contact relaxes its force but pushes the grains apart against their
    overlap: its energy counts as force times overlap.
    """
    h, acted = times
    mass, (old, slow, velocity) = model.masses, velocities
    inertia = cell[0] if np.isfinite(cell[0]) else 0.0

    def kinetic(v: np.ndarray, rate: np.ndarray) -> float:
        return 0.5 * float(np.sum(mass * v * v)) + 0.5 * inertia * mean_rate(rate) ** 2

    def mean_rate(rate: np.ndarray) -> float:
        return float(np.sum(rate[model.free])) / max(1, int(model.free.sum()))

    n, impulse, (i, j) = contacts.data[:, :3], contacts.vectors, contacts.ends.T
    v, along = velocity[:, :3], contacts.normal_impulse
    u = v[i] - v[j]
    if contacts.coulomb is not None:
        w = velocity[:, 4:7]
        u = u - np.cross(w[i] + w[j], n)
    moments = np.sum(impulse * branch, axis=0)  # on the cell, along its axes
    power = float(np.sum(impulse * u)) + float(moments @ rates[2])

    # prescribed velocities of walls; a loaded wall moves freely along its normal
    prescribed = np.where((np.arange(len(v)) >= model.grains.n)[:, None], v, 0.0)
    for k, wall in enumerate(model.walls, model.grains.n):
        if mass[k, 0] > 0.0:
            prescribed[k] -= (prescribed[k] @ wall.unit) * wall.unit
    walls = float(np.sum(impulse * prescribed[j]))
    prescribed_rate = np.where(model.free, 0.0, rates[2])
    work = float(np.sum(mass * model.free_acceleration * velocity)) + cell[1] * mean_rate(rates[2])
    work = acted * work + walls - float(moments @ prescribed_rate)

    data, bias = contacts.data, contacts.data[:, 3]
    speed = np.sum((u + rates[2] * branch) * n, axis=1)
    gap = h * (np.where(bias > 0.0, bias, bias * model.law.relaxation) + speed)
    overlap = np.where(data[:, 5] > 0.0, np.maximum(-gap, 0.0), 0.0)
    springs = 2.0 * along / acted * overlap
    closing = -acted * np.sum(
        (model.free_acceleration[i, :3] - model.free_acceleration[j, :3]) * n, axis=1
    )
    rise = rebound**2 - np.sum(u * n, axis=1) ** 2 + 2.0 * rebound * np.maximum(closing, 0.0)
    springs += data[:, 4] * np.where(rebound > 0.0, np.maximum(rise, 0.0), 0.0)
    return {
        "kinetic_energy": kinetic(velocity, rates[2]),
        "elastic_energy": 0.5 * float(np.sum(springs)),
        "work": work,
        "contact_dissipation": -power,
        "numerical_dissipation": kinetic(velocity - slow, rates[2] - rates[1]),
        "damping_dissipation": kinetic(old, rates[0]) - kinetic(slow, rates[1]),
    }
