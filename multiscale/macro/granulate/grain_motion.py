r"""Time steps of rigid grains in frictional contact, eqs (6) and (9) of the source."""

from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.contact_solver import collide, solve_velocities
from multiscale.macro.granulate.contacts import (
    APART_OVERLAP,
    Contacts,
    FreeStep,
    Geometry,
    Pairs,
    Positions,
    Velocities,
    Walls,
    allowed_step,
    build_contacts,
    find_pairs,
    find_wall_pairs,
    mark_overlaps,
    measure_pairs,
    penetration,
    relative_velocity,
)
from multiscale.macro.granulate.model import Model, Solver

LIST_MARGIN = 0.3
"""Reach of the neighbour list beyond the motion of a step, relative to the mean radius."""

ALLOWED_START_OVERLAP = 0.02
"""Allowed overlap of grains at the start, relative to the smaller radius."""


@dataclass(frozen=True)
class GrainState:
    """State of grains, walls and cell at a time."""

    time: float  # s
    position: np.ndarray  # centres, shape (grains, 3), m
    velocity: np.ndarray  # of the bodies as in :class:`Velocities`, m/s
    point: np.ndarray  # point on each wall, shape (walls, 3), m
    period: np.ndarray  # periods of the cell, shape (3,), m; infinite along axes without a period
    pairs: np.ndarray  # neighbours: two grains, or a grain and a wall, int32, shape (pairs, 2)
    listed_position: np.ndarray  # centres for which the neighbours were listed, (grains, 3), m
    list_reach: float  # largest gap of the listed pairs, m
    rate: np.ndarray  # strain rates of the cell, shape (3,), 1/s
    step_length: float  # length of the last step, s
    force_time: float  # time in which the forces of the last step acted, s; nan before the first
    contacts: Contacts  # contacts of the last step, numbered as the current pairs

    @property
    def contact_forces(self) -> np.ndarray:
        """Forces of the contacts on their first bodies in the last step, shape (contacts, 3), N."""
        return self.contacts.vectors / self.force_time

    def place(self, model: Model) -> Positions:
        """Return the place of grains and walls for the kernels."""
        kind, axis, bore = model.shapes
        walls = Walls(kind, self.point, axis, bore)
        return Positions(self.position, model.grains.radius, self.period, walls)


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
    number, none, nothing = np.empty(0, np.int64), np.empty((0, 2), np.int32), np.empty(0)
    normal, impulse = np.empty((0, 3)), np.empty((0, 3 if model.frictional else 1))
    scalars = (nothing,) * 4
    empty = Contacts(number, none, normal, *scalars, None, normal, impulse, impulse, None)
    state = GrainState(
        time=0.0,
        position=grains.position,
        velocity=velocity,
        point=point,
        period=np.array(model.period, dtype=float),
        pairs=none,
        listed_position=grains.position,
        list_reach=0.0,
        rate=np.zeros(3),
        step_length=0.0,
        force_time=np.nan,
        contacts=empty,
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
            f"no wall supports the grains against gravity {tuple(map(float, gravity))} m/s2; close "
            f"the box or set gravity to zero"
        )
    worst, which = penetration(state.pairs, state.place(model))
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
    r"""Solve a Moreau-Jean step, (9) of the source; in free flight F acts between middles of steps.

    With the gap :math:`g` at the beginning and :math:`b = g/h`

    .. math::
        M (v^+ - v^-) = h F + H r, \quad u = H^T v^+, \quad x^+ = x^- + h v^+, \quad
        K_\mu \ni r \perp u + (b + \mu \|u_T\|) n \in K_\mu^*.    \tag{1}
    """
    began = perf_counter()
    state, h, acted = _choose_step(model, state, h, accuracy)
    # without impulses: damping, then gravity, forces on walls and the pressure on the cell
    decay = np.exp(-model.damping_rate * acted)
    inertia, thrust = _cell_inertia(model, state.period)
    damped, damped_rate = state.velocity.copy(), state.rate if model.driven else decay * state.rate
    damped[: model.grains.n] *= decay
    damped_rate = np.where(model.free, damped_rate, model.prescribed_rate)
    velocity = damped + acted * model.free_acceleration
    strain = np.array(
        [damped_rate + acted * thrust / inertia * model.free, model.free / np.sqrt(inertia)]
    )
    law, nowhere, place = model.law, np.zeros((0, 3)), state.place(model)
    constants = (law.relaxation * h, law.tangential_compliance, np.zeros(2), -np.inf)
    step = FreeStep(
        h, model.grains.n, velocity, nowhere, model.mobility, model.friction, strain, *constants
    )

    # impulses, motion, and energies
    pairs, geometry = pairs_of_step(model, state, acted), measure_pairs(state.pairs, place)
    complete = True  # unless impacts are left
    if law.restitution > 0.0:
        first = 0.5 * (state.step_length / acted if accuracy else 1.0)
        step, pairs, complete = _bounce(
            model, geometry, pairs, step, (damped, damped_rate), (first, acted)
        )
    parts = (solver, step, pairs, geometry)
    solved, sweeps, residual = _solve_contacts(model, state, *parts, acted)
    new, contacts = _advance(model, solved, step.shift), solved.contacts
    worst, _ = penetration(new.pairs, new.place(model))
    done = {
        "residual": residual,
        "converged": int(complete and residual <= solver.tolerance),
        "impacts_left": not complete,
        "iterations": sweeps,
        "penetration": worst,
        "n_contacts": int(np.count_nonzero(contacts.loaded)),
    }
    cell = (inertia, thrust)
    done |= _account_grains(model, state, (damped, damped_rate), new, cell, step.shift)
    if model.pressure is not None:  # diagonal of the mean stress after Love and Weber
        moments = np.sum(contacts.vectors * contacts.branch, axis=0)
        done["stress"] = -moments / (acted * model.volume(state.period))
    return new, done | {"wall_time": perf_counter() - began}


def _choose_step(
    model: Model, state: GrainState, h: float, accuracy: float | None
) -> tuple[GrainState, float, float]:
    """Return the state with neighbours, the length of the step and the time of the forces, s."""
    if accuracy is None:
        return _with_neighbours(model, state, h, h), h, h
    fastest = float(np.sqrt(np.max(np.sum(state.velocity[:, :3] ** 2, axis=1))))
    # the pairs of the step stay in the neighbour list
    h = min(h, float(model.grains.radius.mean()) / max(fastest, 1e-300))
    state = _with_neighbours(model, state, h, 0.5 * (state.step_length + h))
    h = allowed_step(
        pairs_of_step(model, state, state.force_time),
        state.place(model),
        state.velocity,
        h,
        state.step_length,
        accuracy,
        float(np.linalg.norm(model.gravity)),
    )
    return state, h, 0.5 * (state.step_length + h)


def pairs_of_step(model: Model, state: GrainState, acted: float) -> Pairs:
    """Return the pairs of a step with the impulses of the last forces over ``acted``, s."""
    count, contacts, given = len(state.pairs), state.contacts, model.law.compliance
    impulse, across = np.zeros((count, contacts.impulse.shape[1])), model.law.tangential_compliance
    anchor, longer = np.zeros_like(impulse), acted / state.force_time  # forces persist
    impulse[contacts.number] = longer * contacts.impulse
    if max(given, across) > 0.0:
        share = contacts.compliance[:, None] / given if given > 0.0 else 1.0
        relaxed = share * contacts.impulse
        if contacts.coulomb is not None:
            along = np.sum(contacts.impulse * contacts.normal, axis=1)[:, None] * contacts.normal
            turned = contacts.coulomb[:, 2:] / max(given, across)
            relaxed = share * along + turned * (contacts.impulse - along)
        anchor[contacts.number] = longer * relaxed
    unmet, forced = np.zeros((0, impulse.shape[1])), np.zeros(count, bool)
    return Pairs(state.pairs, impulse, anchor, unmet, forced, np.full(count, given))


def _bounce(
    model: Model,
    geometry: Geometry,
    pairs: Pairs,
    step: FreeStep,
    damped: tuple[np.ndarray, np.ndarray],
    times: tuple[float, float],
) -> tuple[FreeStep, Pairs, bool]:
    """Return step and pairs after impacts, and whether all are solved."""
    law, h, (first, acted) = model.law, step.length, times
    every = pairs._replace(forced=np.ones(len(pairs.ends), bool), impulse=0.0 * pairs.impulse)
    contacts = build_contacts(every, geometry, step)
    force, strained = step.velocity - damped[0], step.strain[0] - damped[1]
    start, rate = damped[0] + first * force, damped[1] + first * strained
    motion = Velocities(
        start.copy(),
        step.mobility,
        None if model.pressure is None else np.array([rate, step.strain[1]]),
    )
    rest, slack, least = 2.0 * acted * float(np.linalg.norm(model.gravity)), np.zeros(2), -np.inf
    if law.restitution == 1.0:  # all pairs bounce, and a contact would take energy
        rest, slack, least = 0.0, np.array([APART_OVERLAP, 0.25 * h * rest]), 0.25 * rest
    gained = relative_velocity(contacts, force, strained) * contacts.normal
    gained = h / acted * np.sum(gained, axis=1)
    shift, complete = collide(contacts, motion, gained, law.restitution, rest, h)
    strain = step.strain.copy()
    if motion.strain is not None:
        strain[0] += motion.strain[0] - rate
    velocity = step.velocity + motion.velocity - start
    step = step._replace(velocity=velocity, shift=shift, strain=strain, slack=slack, least=least)
    return step, pairs._replace(struck=contacts.impulse), complete


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
        return _update_neighbours(model, state, reach)
    return state


def _solve_contacts(
    model: Model,
    state: GrainState,
    solver: Solver,
    step: FreeStep,
    pairs: Pairs,
    geometry: Geometry,
    acted: float,
) -> tuple[GrainState, int, float]:
    """Solve (1), and again if other pairs overlap; return also the sweeps and the error."""
    sweeps = 0
    while True:
        contacts, strain = build_contacts(pairs, geometry, step), step.strain.copy()
        motion = Velocities(
            step.velocity.copy(), step.mobility, None if model.pressure is None else strain
        )
        done, residual = solve_velocities(solver, motion, contacts)
        sweeps += done
        pairs = pairs._replace(impulse=np.zeros_like(pairs.impulse))
        pairs.impulse[contacts.number] = contacts.impulse
        if not mark_overlaps(pairs, contacts, geometry, step, motion.velocity, strain[0]):
            break
    solved = replace(
        state,
        velocity=motion.velocity,
        rate=strain[0],
        step_length=step.length,
        force_time=acted,
        contacts=contacts,
    )
    return solved, sweeps, residual


def _advance(model: Model, state: GrainState, shift: np.ndarray) -> GrainState:
    """Return the state with grains, walls and cell moved by the velocities of the step."""
    h, n = state.step_length, model.grains.n
    stretch = np.where(model.strained, 1.0 + h * state.rate, 1.0)
    widest = 2.0 * float(model.grains.radius.max())  # the strain brings pairs at the margin nearer
    margin = min(1.0, float(stretch.min())) * (widest + state.list_reach) - widest
    way = h * state.velocity[:, :3]
    if len(shift):
        way = way + shift
    return replace(
        state,
        time=state.time + h,
        position=stretch * state.position + way[:n],
        point=state.point + way[n:],
        period=stretch * state.period,
        listed_position=stretch * state.listed_position,
        list_reach=margin,
    )


def least_period(radii: np.ndarray, reach: float = 0.0) -> float:
    """Return the shortest period in which listed pairs of grains have one shortest distance, m.

    Parameters
    ----------
    radii : ndarray, shape (grains,), m
    reach : float, largest approach of two grains in a step, m
    """
    return 2.0 * (2.0 * float(radii.max()) + LIST_MARGIN * float(radii.mean()) + reach)


def _update_neighbours(model: Model, state: GrainState, reach: float) -> GrainState:
    """Return the state with a new list of neighbours, and the contacts of persistent pairs."""
    radius, n = model.grains.radius, model.mobility.shape[0]
    margin = LIST_MARGIN * float(radius.mean())
    widest = 0.5 * least_period(radius)
    room = 0.5 * state.period - widest  # for a unique shortest distance of a pair
    short = np.flatnonzero(room < reach)
    if short.size:
        raise CaseError(
            f"period along {'xyz'[short[0]]} is {state.period[short[0]]:.4g} m and must be at "
            f"least {least_period(radius, reach):.4g} m, twice the reach of the largest grains in "
            f"a step; take a longer period (size in a case), more grains, or shorter steps"
        )
    margin += min(2.0 * reach, float(room.min()))  # the list holds for a second step, if possible
    near = find_pairs(state.position, radius, margin, state.period)
    pairs = np.concatenate([near, find_wall_pairs(state.place(model), margin)])
    # from the bottom upwards, so that a single sweep carries impulses through the pile
    height = -(state.position @ np.asarray(model.gravity))
    lower = np.minimum(
        height[pairs[:, 0]], np.append(height, np.full(len(model.walls), -np.inf))[pairs[:, 1]]
    )
    pairs = pairs[np.argsort(lower, kind="stable")]

    # contacts of pairs that stay in the list
    contacts = state.contacts
    listed = np.zeros(len(state.pairs), bool)  # in both lists
    if len(state.pairs) and len(pairs):
        before = state.pairs[:, 0].astype(np.int64) * n + state.pairs[:, 1]
        now = pairs[:, 0].astype(np.int64) * n + pairs[:, 1]
        order = np.argsort(now)
        number = order[np.minimum(np.searchsorted(now, before, sorter=order), now.size - 1)]
        listed = now[number] == before
        contacts = contacts._replace(number=number[contacts.number])
    remains = listed[state.contacts.number]
    fields = {
        name: field[remains] for name, field in contacts._asdict().items() if field is not None
    }
    contacts = contacts._replace(**fields)
    return replace(
        state,
        pairs=pairs,
        contacts=contacts,
        listed_position=state.position,
        list_reach=margin,
    )


def _cell_inertia(model: Model, period: np.ndarray) -> tuple[float, float]:
    """Return the inertia of a periodic cell, kg m2, and the moment of the pressure on it, J."""
    if model.pressure is None:
        return np.inf, 0.0
    # m L²/4 for an affine motion; m (2 R)² under a prescribed strain rate, to follow the pressure
    edges, mass = period[model.free], float(model.grains.mass.sum())
    if model.driven:
        inertia = mass * float(2.0 * model.grains.radius.mean()) ** 2
    else:
        inertia = 0.25 * mass * float(np.mean(edges**2))
    return inertia, -model.pressure * model.volume(period) * edges.size


def _account_grains(
    model: Model,
    old: GrainState,
    damped: tuple[np.ndarray, np.ndarray],
    new: GrainState,
    cell: tuple[float, float],
    shift: np.ndarray,
) -> dict[str, float]:
    """Return kinetic and elastic energy, work, and losses by contacts, scheme and damping, J."""
    # the kinetic energy grows by the work less -r·u, dv^T M dv / 2 and damping; springs have the
    # energy force times overlap, and a |r_T|² / (2 m) across
    # kinetic energy
    h, acted, contacts, rate = new.step_length, new.force_time, new.contacts, new.rate
    mass, velocity = model.masses, new.velocity
    inertia = cell[0] if np.isfinite(cell[0]) else 0.0

    def kinetic(v: np.ndarray, rate: np.ndarray) -> float:
        return 0.5 * float(np.sum(mass * v * v)) + 0.5 * inertia * mean_rate(rate) ** 2

    def mean_rate(rate: np.ndarray) -> float:
        return float(np.sum(rate[model.free])) / max(1, int(model.free.sum()))

    # power of the impulses
    impulse, branch = contacts.vectors, contacts.branch
    v, u = velocity[:, :3], relative_velocity(contacts, velocity)
    moments = np.sum(impulse * branch, axis=0)  # on the cell, along its axes
    power = float(np.sum(impulse * u)) + float(moments @ rate)

    # prescribed velocities of walls; a loaded wall moves freely along its normal
    prescribed = np.where((np.arange(len(v)) >= model.grains.n)[:, None], v, 0.0)
    for k, wall in enumerate(model.walls, model.grains.n):
        if mass[k, 0] > 0.0:
            prescribed[k] -= (prescribed[k] @ wall.unit) * wall.unit
    walls = float(np.sum(impulse * prescribed[contacts.ends[:, 1]]))
    prescribed_rate = np.where(model.free, 0.0, rate)
    force = mass * model.free_acceleration
    pull = acted * float(np.sum(force * velocity))
    lost = kinetic(velocity - damped[0], rate - damped[1])
    if len(shift):
        # to the middle of the step, where its velocities belong, on the parabola of free flight;
        # impulses of impacts act at their times, and forces on the way until then
        last = 2.0 * acted - h
        ways = 0.5 * (last * damped[0] + h * velocity)
        ways -= 0.125 * (h**2 - last**2) * model.free_acceleration
        middle, before = float(np.sum(force * ways)), float(np.sum(force[:, :3] * shift))
        pull, lost, power = middle + before, lost + middle - pull, power - before
    work = pull + acted * cell[1] * mean_rate(rate) + walls - float(moments @ prescribed_rate)
    return {
        "kinetic_energy": kinetic(velocity, rate),
        "elastic_energy": _spring_energy(new, u + rate * branch),
        "work": work,
        "contact_dissipation": -power,
        "numerical_dissipation": lost,
        "damping_dissipation": kinetic(old.velocity, old.rate) - kinetic(*damped),
    }


def _spring_energy(state: GrainState, velocity: np.ndarray) -> float:
    """Return the energy of the springs along and across the normals, J."""
    contacts, n = state.contacts, state.contacts.normal
    openings = contacts.gap + state.step_length * np.sum(velocity * n, axis=1)
    overlap = np.where(contacts.compliance > 0.0, np.maximum(-openings, 0.0), 0.0)
    springs = 2.0 * np.sum(contacts.vectors * n, axis=1) / state.force_time * overlap
    if contacts.coulomb is not None:
        tangential = contacts.impulse - np.sum(contacts.impulse * n, axis=1)[:, None] * n
        give = contacts.coulomb[:, 2] / contacts.coulomb[:, 0]
        springs += give * np.sum(tangential**2, axis=1)
    return 0.5 * float(np.sum(springs))
