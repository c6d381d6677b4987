r"""Time steps of rigid grains in frictional contact, eqs (6) and (9) of the source."""

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.bodies import Cylinder, Wall
from multiscale.macro.granulate.contacts import (
    Contacts,
    build_contacts,
    find_wall_pairs,
    missed,
    penetration,
)
from multiscale.macro.granulate.energy import account, cell_of
from multiscale.macro.granulate.model import Model, Solver
from multiscale.macro.granulate.neighbours import find_pairs
from multiscale.macro.granulate.step import solve_step

__all__ = ["State", "Step", "advance", "start"]

SKIN = 0.3
"""Reach of the neighbour list beyond what moves in a step, relative to the mean radius."""

NEAR = 0.02
"""Pairs that come this near, relative to the smaller radius, are contacts from the outset."""

ALLOWED = (1e-3, 8e-3)
"""Overlap that a pair without contact, and a compliant contact, may have after a step, relative to
the smaller radius."""

OVERLAP = 0.01
"""Overlap that grains may have at the start, relative to the smaller radius."""


@dataclass(frozen=True)
class State:
    """What is known at a time.

    ``pairs`` are the neighbours with the impulses ``kept`` of the last step and what their springs
    ``held`` of them, and the normal velocities ``approach`` before impacts that have yet to bounce;
    they were found at the positions ``seen`` with the reach ``margin``. ``rate`` is that of the
    strain of the cell, 1/s.
    """

    time: float
    position: np.ndarray
    velocity: np.ndarray
    point: np.ndarray
    period: np.ndarray
    pairs: np.ndarray
    kept: np.ndarray
    held: np.ndarray
    approach: np.ndarray
    seen: np.ndarray
    margin: float
    rate: float
    contacts: Contacts


@dataclass(frozen=True)
class Step:
    """How a step went: energies in J, times in s, the rest dimensionless."""

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


def start(model: Model) -> State:
    """Return the state at the beginning.

    Raises
    ------
    CaseError
        If grains overlap, lie behind a wall, or nothing holds them against gravity.
    """
    grains, walls = model.grains, model.walls
    velocity = np.zeros((grains.n + len(walls), 8))
    velocity[: grains.n, :3] = grains.velocity
    velocity[: grains.n, 4:7] = grains.radius[:, None] * grains.spin
    for w, wall in enumerate(walls, grains.n):
        velocity[w, :3] = wall.velocity
    point = np.array([wall.point for wall in walls], dtype=float).reshape(-1, 3)
    none = np.empty((0, 2), np.int32)
    empty = Contacts(none, np.empty((0, 8)), np.empty((0, 3)), np.empty((0, 3)))
    period = np.array(model.period, dtype=float)
    state = State(
        0.0,
        grains.position,
        velocity,
        point,
        period,
        none,
        np.empty((0, 3)),
        np.empty((0, 3)),
        np.empty(0),
        grains.position,
        0.0,
        0.0,
        empty,
    )
    state = _look_around(model, state, 0.0)
    _check_hold(model)
    _check_overlap(model, state)
    return state


def _check_hold(model: Model) -> None:
    """Refuse gravity that no wall stands against: grains would fall for ever."""
    gravity = np.asarray(model.gravity, dtype=float)
    if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
        raise CaseError(f"gravity must be three finite numbers (m/s2), got {model.gravity}")
    below = any(np.isinf(model.period[a]) and gravity[a] != 0.0 for a in range(3)) and not any(
        _holds(wall, gravity) for wall in model.walls
    )
    if below:
        raise CaseError(
            f"no wall holds the grains against gravity {tuple(map(float, gravity))} m/s2: they "
            f"fall for ever; close the box or set gravity to zero"
        )


def _holds(wall: Wall, gravity: np.ndarray) -> bool:
    """Whether a wall stops what falls."""
    along = float(wall.unit @ gravity)
    if isinstance(wall, Cylinder):
        return abs(along) < (1.0 - 1e-9) * float(np.linalg.norm(gravity))
    return along < 0.0


def _check_overlap(model: Model, state: State) -> None:
    """Refuse grains that overlap each other or a wall."""
    walls = model.walls_at(state.point)
    worst, which = penetration(
        state.pairs, state.position, model.grains.radius, state.period, walls
    )
    if worst > OVERLAP:
        i, j = (int(body) for body in state.pairs[which])
        other = f"grain {j}" if j < model.grains.n else f"wall {j - model.grains.n}"
        raise CaseError(
            f"grain {i} overlaps {other} by {worst:.3g} of its radius at the start, at most "
            f"{OVERLAP:g} is allowed; move them apart"
        )


def _look_around(model: Model, state: State, reach: float) -> State:
    """Find the neighbours anew and hand the impulses over."""
    radius, n = model.grains.radius, model.mobility.shape[0]
    margin = reach + SKIN * float(radius.mean())
    _check_period(model, state.period, margin)
    walls = model.walls_at(state.point)
    near = find_pairs(state.position, radius, margin, state.period)
    at_walls = find_wall_pairs(state.position, radius, margin, state.period, *walls)
    pairs = np.concatenate([near, at_walls])
    # from the bottom upwards, so that a sweep carries impulses through the pile
    height = -(state.position @ np.asarray(model.gravity))
    lower = np.minimum(
        height[pairs[:, 0]], np.append(height, np.full(len(model.walls), -np.inf))[pairs[:, 1]]
    )
    pairs = pairs[np.argsort(lower, kind="stable")]
    kept, held = np.zeros((len(pairs), 3)), np.zeros((len(pairs), 3))
    approach = np.zeros(len(pairs))
    if len(state.pairs) and len(pairs):
        before = state.pairs[:, 0].astype(np.int64) * n + state.pairs[:, 1]
        now = pairs[:, 0].astype(np.int64) * n + pairs[:, 1]
        order = np.argsort(before)
        found = np.minimum(np.searchsorted(before, now, sorter=order), before.size - 1)
        same = before[order[found]] == now
        kept[same] = state.kept[order[found[same]]]
        held[same] = state.held[order[found[same]]]
        approach[same] = state.approach[order[found[same]]]
    return replace(
        state,
        pairs=pairs,
        kept=kept,
        held=held,
        approach=approach,
        seen=state.position,
        margin=margin,
    )


def _check_period(model: Model, period: np.ndarray, margin: float) -> None:
    """Refuse periods in which a pair would meet twice."""
    least = 2.0 * (2.0 * float(model.grains.radius.max()) + margin)
    short = np.flatnonzero(period < least)
    if short.size:
        raise CaseError(
            f"period along {'xyz'[short[0]]} is {period[short[0]]:.4g} m and must be at least "
            f"{least:.4g} m, twice the reach of the largest grains"
        )


def advance(model: Model, state: State, h: float, solver: Solver) -> tuple[State, Step]:
    r"""Make one Moreau-Jean step.

    Parameters
    ----------
    model, state : Model, State
    h : float
        Length of the step, s.
    solver : Solver

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
    one in the second half ends the step touching, and has it in the next.
    """
    began = perf_counter()
    n, law = model.grains.n, model.law
    old = state.velocity
    keep = np.exp(-model.damping_rate * h)
    slow = old.copy()
    slow[:n] *= keep
    free = slow + h * model.push
    inertia, thrust = cell_of(model, state.period)
    rate = keep * state.rate + h * thrust / inertia
    moved = state.position - state.seen + h * free[:n, :3]
    speed = h * float(np.sqrt(np.max(np.sum(free[:, :3] ** 2, axis=1), initial=0.0)))
    reach = 2.0 * speed + 4.0 * h * abs(rate) * float(model.grains.radius.max())
    if (
        len(state.seen)
        and 2.0 * float(np.sqrt(np.max(np.sum(moved**2, axis=1)))) + reach > state.margin
    ):
        state = _look_around(model, state, 2.0 * reach)
    walls = model.walls_at(state.point)
    friction = np.array(
        [law.friction, *(law.friction if w.friction is None else w.friction for w in model.walls)]
    )
    rest = 2.0 * h * float(np.linalg.norm(model.gravity))
    constants = (law.restitution, law.relaxation * h, rest, friction)
    wanted, hits = np.zeros(len(state.pairs), bool), np.zeros(len(state.pairs))
    compliance = np.full(len(state.pairs), law.compliance)
    searched = perf_counter() - began

    place = (state.position, model.grains.radius, state.period, walls)
    kept, sweeps = state.kept, 0
    while True:
        ends, data, impulse, anchor, index, cell, approach = build_contacts(
            state.pairs,
            kept,
            state.held,
            state.approach,
            hits,
            wanted,
            compliance,
            *place,
            slow,
            free,
            model.mobility,
            constants,
            h,
            NEAR,
            (rate, 1.0 / inertia),
        )
        velocity = free.copy()
        done, residual = solve_step(
            model, solver, state.position, velocity, ends, data, impulse, anchor, cell
        )
        sweeps += done
        kept = np.zeros_like(state.kept)
        kept[index] = impulse
        if not missed(
            state.pairs,
            index,
            data,
            hits,
            wanted,
            compliance,
            *place,
            velocity,
            h,
            float(cell[0]),
            ALLOWED,
        ):
            break
    contacts = Contacts(ends, data, impulse, anchor)
    approach[~kept.any(axis=1)] = 0.0  # it passed by
    held = np.zeros_like(kept)
    if law.compliance > 0.0:
        held[index] = data[:, 6:7] / law.compliance * impulse
    stretch = np.where(np.isfinite(state.period), 1.0 + h * float(cell[0]), 1.0)
    position = stretch * state.position + h * velocity[:n, :3]
    new = replace(
        state,
        time=state.time + h,
        position=position,
        velocity=velocity,
        point=state.point + h * velocity[n:, :3],
        period=stretch * state.period,
        seen=stretch * state.seen,
        kept=kept,
        held=held,
        approach=approach,
        rate=float(cell[0]),
        contacts=contacts,
    )
    worst, _ = penetration(
        new.pairs, position, model.grains.radius, new.period, model.walls_at(new.point)
    )
    energies = account(
        model,
        h,
        (old, slow, velocity),
        contacts,
        -law.restitution * approach[index],
        (state.rate, keep * state.rate, new.rate),
        cell[2:],
        (inertia, thrust),
    )
    total = perf_counter() - began
    return new, Step(
        residual,
        residual <= solver.tolerance,
        sweeps,
        worst,
        int(np.count_nonzero(impulse.any(axis=1))),
        *energies,
        searched,
        total - searched,
    )
