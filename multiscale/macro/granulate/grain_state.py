"""State of moving grains, and their neighbours."""

from dataclasses import dataclass, replace

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.contacts import Contacts, find_wall_pairs, penetration
from multiscale.macro.granulate.model import Model
from multiscale.macro.granulate.neighbours import find_pairs

__all__ = ["GrainState", "initial_state", "update_neighbours"]

LIST_MARGIN = 0.3
"""Reach of the neighbour list beyond the motion of a step, relative to the mean radius."""

ALLOWED_START_OVERLAP = 0.01
"""Allowed overlap of grains at the start, relative to the smaller radius."""


@dataclass(frozen=True)
class GrainState:
    """State of grains, walls and cell at a time; impulses have c = 1 or 3 components.

    Attributes
    ----------
    time : float, s
    position : ndarray, shape (grains, 3), centres, m
    velocity : ndarray, shape (bodies, 4 or 8)
        Velocities and radius times spin, as in :mod:`multiscale.macro.granulate.sweeps`, m/s.
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
    state = update_neighbours(model, state, 0.0)

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


def update_neighbours(model: Model, state: GrainState, reach: float) -> GrainState:
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
