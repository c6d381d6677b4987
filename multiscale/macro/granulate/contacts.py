r"""Pairs of neighbouring grains and their contacts: gaps, normals, masses and biases."""

from typing import NamedTuple

import numpy as np

from multiscale.macro.granulate.grain_bodies import PLANE
from multiscale.numerics.compiled import compiled

__all__ = [
    "Contacts",
    "FreeStep",
    "Pairs",
    "Positions",
    "Walls",
    "allowed_step",
    "build_contacts",
    "find_wall_pairs",
    "mark_overlaps",
    "penetration",
]

CONTACT_DISTANCE = 0.02
"""Gap below which a pair is a contact from the first solve on, relative to the smaller radius."""

APART_OVERLAP, CONTACT_OVERLAP = 1e-3, 8e-3
"""Allowed overlap after a step of a pair that is no contact, and of a compliant contact, relative
to the smaller radius."""

STIFFENING, LEAST_COMPLIANCE = 0.1, 5e-5
"""Factor on the compliance of a contact that overlaps too far, and the compliance below which a
contact is not stiffened further; dimensionless."""


class Walls(NamedTuple):
    """Kind (walls,), point (walls, 3), m, direction (walls, 3) and radius (walls,), m, of walls."""

    kind: np.ndarray
    point: np.ndarray
    axis: np.ndarray
    bore: np.ndarray


class Positions(NamedTuple):
    """Centres (grains, 3), radii (grains,) and periods of space (3,), m, and walls."""

    position: np.ndarray
    radius: np.ndarray
    period: np.ndarray
    walls: Walls


class Pairs(NamedTuple):
    """Pairs that may touch in a step; impulses have c = 1 or 3 components.

    Attributes
    ----------
    ends : ndarray of int32, shape (pairs, 2), bodies; walls are numbered after the grains
    impulse, anchor : ndarray, shape (pairs, c)
        Impulses from which the sweeps start, and at which contact springs are relaxed, N s.
    approach, hits : ndarray, shape (pairs,)
        Normal velocity before an impact at the end of the last step, and before one caused in this
        step, else zero, m/s.
    wanted : ndarray of bool, shape (pairs,), pairs that are contacts whatever their gap
    compliance : ndarray, shape (pairs,), dimensionless
    """

    ends: np.ndarray
    impulse: np.ndarray
    anchor: np.ndarray
    approach: np.ndarray
    hits: np.ndarray
    wanted: np.ndarray
    compliance: np.ndarray


class FreeStep(NamedTuple):
    """A step before its contacts are known.

    Attributes
    ----------
    length : float, s
    before, velocity : ndarray, shape (bodies, 4 or 8), before and after the forces act, m/s
    mobility : ndarray, shape (bodies, 1 or 3), as of :class:`~.contact_solver.Velocities`
    friction : ndarray, coefficients of the grains and of each wall; empty without friction
    strain : ndarray, shape (2, 3)
        Strain rates of the cell, 1/s, and one over the root of its inertia, 1/(kg m2)^.5.
    restitution, relaxation, rest : float
        Coefficient, time in which overlaps relax, s, and speed up to which nothing bounces, m/s.
    first, last : float, shares of the change of velocity before and after an impact
    """

    length: float
    before: np.ndarray
    velocity: np.ndarray
    mobility: np.ndarray
    friction: np.ndarray
    strain: np.ndarray
    restitution: float
    relaxation: float
    rest: float
    first: float
    last: float


class Contacts(NamedTuple):
    """The contacts of a step.

    Attributes
    ----------
    number : ndarray of int, shape (contacts,), number of the pair of each contact
    ends : ndarray of int32, shape (contacts, 2), bodies i and j
    normal : ndarray, shape (contacts, 3), from j to i
    bias : ndarray, shape (contacts,), m/s
    mass, compliance : ndarray, shape (contacts,), along the normal, kg, and dimensionless
    coulomb : ndarray, shape (contacts, 2), or None
        Mass across the normal, kg, and friction coefficient; None without friction.
    branch : ndarray, shape (contacts, 3), from centre j to centre i, m; zero at walls
    impulse, anchor : ndarray, shape (contacts, 3), or (contacts, 1) without friction
        Impulses in global axes, or along the normal, and those at which springs are relaxed, N s.
    """

    number: np.ndarray
    ends: np.ndarray
    normal: np.ndarray
    bias: np.ndarray
    mass: np.ndarray
    compliance: np.ndarray
    coulomb: np.ndarray | None
    branch: np.ndarray
    impulse: np.ndarray
    anchor: np.ndarray

    @property
    def frictional(self) -> bool:
        """Whether impulses have three components."""
        return self.coulomb is not None

    @property
    def vectors(self) -> np.ndarray:
        """Impulses in global axes, shape (contacts, 3), N s."""
        return self.impulse if self.frictional else self.impulse * self.normal

    @property
    def loaded(self) -> np.ndarray:
        """Contacts with an impulse, shape (contacts,), bool."""
        return np.asarray(self.impulse.any(axis=1))


@compiled(inline="always")
def _gap(i, j, position, radius, period, kind, point, axis, bore):  # type: ignore[no-untyped-def]
    """Return the gap, m, and the normal from body j, a grain or a wall, to grain i."""
    n = radius.size
    nx, ny, nz = position[i, 0], position[i, 1], position[i, 2]
    if j < n:
        nx, ny, nz = nx - position[j, 0], ny - position[j, 1], nz - position[j, 2]
        if period[0] < np.inf:
            nx -= period[0] * np.round(nx / period[0])
        if period[1] < np.inf:
            ny -= period[1] * np.round(ny / period[1])
        if period[2] < np.inf:
            nz -= period[2] * np.round(nz / period[2])
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        return length - radius[i] - radius[j], nx / length, ny / length, nz / length
    w = j - n
    nx, ny, nz = nx - point[w, 0], ny - point[w, 1], nz - point[w, 2]
    height = nx * axis[w, 0] + ny * axis[w, 1] + nz * axis[w, 2]
    if kind[w] == PLANE:
        return height - radius[i], axis[w, 0], axis[w, 1], axis[w, 2]
    nx, ny, nz = nx - height * axis[w, 0], ny - height * axis[w, 1], nz - height * axis[w, 2]
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if length == 0.0:
        return bore[w] - radius[i], 1.0, 0.0, 0.0
    return bore[w] - length - radius[i], -nx / length, -ny / length, -nz / length


@compiled(inline="always")
def _had_impulse(k, impulse):  # type: ignore[no-untyped-def]
    """Whether a pair had an impulse in the last step."""
    loaded = False
    for a in range(impulse.shape[1]):
        loaded = loaded or impulse[k, a] != 0.0
    return loaded


@compiled
def find_wall_pairs(place, reach):  # type: ignore[no-untyped-def]
    """List the pairs (grain, grains + wall) with a gap of at most the reach."""
    position, radius, period, walls = place
    kind, point, axis, bore = walls
    n, found = radius.size, 0
    pairs = np.empty((n * kind.size, 2), np.int32)
    for w in range(kind.size):
        for i in range(n):
            if _gap(i, n + w, position, radius, period, kind, point, axis, bore)[0] <= reach:
                pairs[found, 0], pairs[found, 1] = i, n + w
                found += 1
    return pairs[:found].copy()


@compiled
def allowed_step(pairs, place, velocity, longest, last, accuracy, gravity):  # type: ignore[no-untyped-def]
    r"""Longest step, s, in which no impact is missed by more than a share of a radius.

    A pair with gap g and smaller radius R that closes with the speed u requires

        h <= max(g - accuracy R, accuracy R) / u,                                         (1)

    so that the step before the impact is short too: forces that act from the middle of a long step
    on would take part in the impact. Grains that roll or slide over each other with the speed v, or
    would fall off each other, require

        h <= sqrt(accuracy) R / max(v, sqrt(gravity R)).                                  (2)

    The closing speed of pairs that do not touch includes gravity, since one grain may be supported.
    """
    position, radius, period, walls = place
    kind, point, axis, bore = walls
    ends, impulse = pairs.ends, pairs.impulse
    h, turn = longest, np.sqrt(accuracy)
    for k in range(ends.shape[0]):
        i, j = ends[k, 0], ends[k, 1]
        gap, nx, ny, nz = _gap(i, j, position, radius, period, kind, point, axis, bore)
        smaller = min(radius[i], radius[j]) if j < radius.size else radius[i]
        touched = _had_impulse(k, impulse)
        x, y = velocity[j, 0] - velocity[i, 0], velocity[j, 1] - velocity[i, 1]
        z = velocity[j, 2] - velocity[i, 2]
        closing, room = x * nx + y * ny + z * nz, accuracy * smaller
        room = max(gap - room, room)
        if not touched:
            closing += 0.5 * (last + h) * gravity
        if touched and j < radius.size:
            past = np.sqrt(max(x * x + y * y + z * z - closing * closing, 0.0))
            past = max(past, np.sqrt(gravity * smaller))
            if h * past > turn * smaller:
                h = turn * smaller / past
        if h * closing > room:
            h = room / closing
    return h


@compiled
def build_contacts(pairs, place, step):  # type: ignore[no-untyped-def]
    """Build the contacts from the pairs that may touch within a step.

    A pair becomes a contact if it is wanted, had an impulse, or comes nearer than
    ``CONTACT_DISTANCE`` in a step without impulses.

    An impact in the first half of a step bounces in this step. An impact in the second half, or
    one caused within the step, ends the step in contact and bounces in the next step: the second
    return value, shape (pairs,), is the normal velocity before such an impact, m/s.
    """
    position, radius, period, walls = place
    kind, point, axis, bore = walls
    pair_ends, start, spring, approach, hits, wanted, give = pairs
    h, old, velocity, mobility, coefficient, strain = (
        step.length,
        step.before,
        step.velocity,
        step.mobility,
        step.friction,
        step.strain,
    )
    restitution, relaxation, rest = step.restitution, step.relaxation, step.rest
    n, m = radius.size, 0
    size, width = start.shape
    number, ends = np.empty(size, np.int64), np.empty((size, 2), np.int32)
    normal, branch = np.empty((size, 3)), np.empty((size, 3))
    bias, mass, compliance = np.empty(size), np.empty(size), np.empty(size)
    frictional = coefficient.size > 0
    coulomb = np.empty((size if frictional else 0, 2))
    impulse, anchor = np.empty((size, width)), np.empty((size, width))
    delayed_velocity = np.zeros(size)
    for k in range(size):
        i, j = pair_ends[k, 0], pair_ends[k, 1]
        gap, nx, ny, nz = _gap(i, j, position, radius, period, kind, point, axis, bore)
        if j < n:
            smaller, length = min(radius[i], radius[j]), gap + radius[i] + radius[j]
        else:
            smaller, length = radius[i], 0.0
        affine = length * (strain[0, 0] * nx * nx + strain[0, 1] * ny * ny + strain[0, 2] * nz * nz)
        ahead = affine  # normal velocity without impulses, and before the step
        ahead += (velocity[i, 0] - velocity[j, 0]) * nx + (velocity[i, 1] - velocity[j, 1]) * ny
        ahead += (velocity[i, 2] - velocity[j, 2]) * nz
        near = gap + h * min(ahead, 0.0) < CONTACT_DISTANCE * smaller
        if not (wanted[k] or near or _had_impulse(k, start)):
            continue
        before = (old[i, 0] - old[j, 0]) * nx + (old[i, 1] - old[j, 1]) * ny
        before += (old[i, 2] - old[j, 2]) * nz
        gained = ahead - affine - before
        fastest = min(before + step.first * gained, approach[k], hits[k])
        impact = restitution > 0.0 and fastest < -rest
        delayed = impact and approach[k] == 0.0 and gap + 0.5 * h * before > 0.0
        bias[m] = gap / h if gap > 0.0 else gap / relaxation
        if impact and not delayed:
            bias[m] = restitution * fastest - step.last * gained
        delayed_velocity[k] = fastest if delayed else 0.0
        number[m], ends[m, 0], ends[m, 1] = k, i, j
        normal[m, 0], normal[m, 1], normal[m, 2] = nx, ny, nz
        bx, by, bz = length * nx, length * ny, length * nz
        branch[m, 0], branch[m, 1], branch[m, 2] = bx, by, bz
        cell = (strain[1, 0] * bx) ** 2 + (strain[1, 1] * by) ** 2 + (strain[1, 2] * bz) ** 2
        mass[m] = 1.0 / (mobility[i, 0] + mobility[j, 0] + cell)
        compliance[m] = 0.0 if impact else give[k]  # a spring would reduce the bounce
        if frictional:
            masses = mobility[i, 1] + mobility[j, 1] + mobility[i, 2] + mobility[j, 2]
            coulomb[m, 0], coulomb[m, 1] = 1.0 / (masses + cell), coefficient[max(0, 1 + j - n)]
        for a in range(width):
            impulse[m, a], anchor[m, a] = start[k, a], spring[k, a]
        m += 1
    contacts = Contacts(
        number[:m],
        ends[:m],
        normal[:m],
        bias[:m],
        mass[:m],
        compliance[:m],
        coulomb[:m],
        branch[:m],
        impulse[:m],
        anchor[:m],
    )
    return contacts, delayed_velocity


@compiled
def mark_overlaps(pairs, contacts, place, velocity, rate, h):  # type: ignore[no-untyped-def]
    """Find the pairs that overlap too far after the step; return their number.

    A pair that is no contact is wanted, with its normal velocity in ``hits``; the compliance of a
    contact is multiplied by ``STIFFENING``. ``rate`` are the strain rates of the cell, 1/s.
    """
    position, radius, period, walls = place
    kind, point, axis, bore = walls
    ends, hits, wanted, compliance = pairs.ends, pairs.hits, pairs.wanted, pairs.compliance
    number, used = contacts.number, contacts.compliance
    new, m = 0, 0
    for k in range(ends.shape[0]):
        touches = m < number.size and number[m] == k
        if touches:
            m += 1
            if used[m - 1] <= LEAST_COMPLIANCE:
                continue
        elif wanted[k]:
            continue
        i, j = ends[k, 0], ends[k, 1]
        gap, nx, ny, nz = _gap(i, j, position, radius, period, kind, point, axis, bore)
        u = (velocity[i, 0] - velocity[j, 0]) * nx + (velocity[i, 1] - velocity[j, 1]) * ny
        u += (velocity[i, 2] - velocity[j, 2]) * nz
        smaller = radius[i]
        if j < radius.size:
            smaller = min(smaller, radius[j])
            affine = rate[0] * nx * nx + rate[1] * ny * ny + rate[2] * nz * nz
            u += affine * (gap + radius[i] + radius[j])
        if gap + h * u < -(CONTACT_OVERLAP if touches else APART_OVERLAP) * smaller:
            wanted[k] = True
            if touches:
                compliance[k] *= STIFFENING
            else:
                hits[k] = u
            new += 1
    return new


@compiled
def penetration(ends, place):  # type: ignore[no-untyped-def]
    """Largest overlap of a pair relative to its smaller radius, and the pair (-1 if none)."""
    position, radius, period, walls = place
    kind, point, axis, bore = walls
    worst, which = 0.0, -1
    for k in range(ends.shape[0]):
        i, j = ends[k, 0], ends[k, 1]
        gap = _gap(i, j, position, radius, period, kind, point, axis, bore)[0]
        smaller = min(radius[i], radius[j]) if j < radius.size else radius[i]
        if -gap > worst * smaller:
            worst, which = -gap / smaller, k
    return worst, which
