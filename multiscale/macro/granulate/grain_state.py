"""What is known of grains at a time, and their neighbours."""

from dataclasses import dataclass, replace

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.contacts import Contacts, find_wall_pairs, penetration
from multiscale.macro.granulate.model import Model
from multiscale.macro.granulate.neighbours import find_pairs

__all__ = ["GrainState", "look_around", "start"]

SKIN = 0.3
"""Reach of the neighbour list beyond what moves in a step, relative to the mean radius."""

OVERLAP = 0.01
"""Overlap that grains may have at the start, relative to the smaller radius."""


@dataclass(frozen=True)
class GrainState:
    """What is known at a time.

    ``pairs`` are the neighbours with the impulses ``kept`` of the last step and what their springs
    ``held`` of them, and the normal velocities ``approach`` before impacts that have yet to bounce;
    they were found at the positions ``seen`` with the reach ``margin``. ``rate`` (3,) is that of
    the strain of the cell, 1/s. Impulses are those of forces that acted for the time ``acted`` in a
    step of the length ``last``, s.
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
    rate: np.ndarray
    last: float
    acted: float
    contacts: Contacts


def start(model: Model) -> GrainState:
    """Return the state at the beginning.

    Raises
    ------
    CaseError
        If grains overlap, lie behind a wall, or nothing holds them against gravity.
    """
    grains, walls = model.grains, model.walls
    velocity = np.zeros_like(model.push)
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
    period = np.array(model.period, dtype=float)
    state = GrainState(
        0.0,
        grains.position,
        velocity,
        point,
        period,
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
    state = look_around(model, state, 0.0)
    _check_hold(model)
    _check_overlap(model, state)
    return state


def _check_hold(model: Model) -> None:
    """Refuse gravity that no wall stands against: grains would fall for ever."""
    gravity = np.asarray(model.gravity, dtype=float)
    if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
        raise CaseError(f"gravity must be three finite numbers (m/s2), got {model.gravity}")
    below = any(np.isinf(model.period[a]) and gravity[a] != 0.0 for a in range(3)) and not any(
        wall.holds(gravity) for wall in model.walls
    )
    if below:
        raise CaseError(
            f"no wall holds the grains against gravity {tuple(map(float, gravity))} m/s2: they "
            f"fall for ever; close the box or set gravity to zero"
        )


def _check_overlap(model: Model, state: GrainState) -> None:
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


def look_around(model: Model, state: GrainState, reach: float) -> GrainState:
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
    kept = np.zeros((len(pairs), state.kept.shape[1]))
    held = np.zeros_like(kept)
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
