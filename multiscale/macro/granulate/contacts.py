r"""Pairs of neighbouring grains and their contacts: gaps, normals, masses and biases."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from multiscale.macro.granulate.model import PLANE
from multiscale.numerics.compiled import compiled

CONTACT_DISTANCE = 0.02
"""Gap below which a pair is a contact from the first solve on, relative to the smaller radius."""

APART_OVERLAP, CONTACT_OVERLAP = 1e-3, 8e-3
"""Allowed overlap after a step of a pair without contact, and of a compliant contact, relative to
the smaller radius."""

STIFFENING, LEAST_COMPLIANCE = 0.1, 5e-5
"""Factor on the compliance of a contact that overlaps too far, and the compliance below which a
contact is not stiffened further; dimensionless."""


class Walls(NamedTuple):
    """Planes and pipes."""

    kind: np.ndarray  # PLANE or CYLINDER, shape (walls,)
    point: np.ndarray  # point on the plane or the axis, shape (walls, 3), m
    axis: np.ndarray  # normal or direction of the axis, shape (walls, 3)
    bore: np.ndarray  # radius, shape (walls,), m; zero for planes


class Positions(NamedTuple):
    """Positions of grains and walls."""

    position: np.ndarray  # centres, shape (grains, 3), m
    radius: np.ndarray  # shape (grains,), m
    period: np.ndarray  # periods of space, shape (3,), m
    walls: Walls


class Pairs(NamedTuple):
    """Pairs that may touch in a step; impulses have c = 1 or 3 components."""

    ends: np.ndarray  # bodies, int32, shape (pairs, 2); walls are numbered after the grains
    impulse: np.ndarray  # impulses from which the sweeps start, shape (pairs, c), N s
    anchor: np.ndarray  # impulses at which contact springs are relaxed, shape (pairs, c), N s
    struck: np.ndarray  # impulses of impacts in this step; no rows without restitution, N s
    wanted: np.ndarray  # whether a pair is a contact for any gap, shape (pairs,)
    compliance: np.ndarray  # shape (pairs,), dimensionless


class FreeStep(NamedTuple):
    """A step before its contacts are known; arrays as in :class:`Velocities`."""

    length: float  # s
    velocity: np.ndarray  # velocities after forces and impacts, m/s
    shift: np.ndarray  # ways of the bodies before their impacts; no rows without restitution, m
    mobility: np.ndarray
    friction: np.ndarray  # coefficients of the grains and of each wall; empty without friction
    strain: np.ndarray
    relaxation: float  # time in which overlaps relax, s
    across: float  # least compliance across the normal, dimensionless
    slack: np.ndarray  # allowed overlap: over the smaller radius, and m, shape (2,)
    least: float  # least bias, m/s


class Velocities(NamedTuple):
    """Velocities of grains and then of walls; fewer columns if grains do not rotate."""

    # columns 0-2 velocity, 4-6 radius times spin, m/s, shape (bodies, 8) or (bodies, 4)
    velocity: np.ndarray
    # inverse mass along the normal and across it, squared radius over inertia, 1/kg,
    # shape (bodies, 3) or (bodies, 1)
    mobility: np.ndarray
    # strain rate of a periodic cell along each axis, 1/s, and inverse root of its inertia,
    # 1/(kg m2)^.5, zero for a prescribed rate, shape (2, 3); None if the cell is rigid
    strain: np.ndarray | None


class Contacts(NamedTuple):
    """The contacts of a step, shape (contacts, ...)."""

    number: np.ndarray  # number of the pair of each contact
    ends: np.ndarray  # bodies i and j, int32
    normal: np.ndarray  # from j to i, shape (contacts, 3)
    gap: np.ndarray  # at the start of the step, m
    bias: np.ndarray  # m/s
    mass: np.ndarray  # along the normal, kg
    compliance: np.ndarray  # along the normal, dimensionless
    # mass across the normal, kg, friction and compliance across; None without friction
    coulomb: np.ndarray | None
    branch: np.ndarray  # from centre j to centre i, shape (contacts, 3), m; zero at walls
    impulse: np.ndarray  # (contacts, 3) in global axes, or (contacts, 1) along the normal, N s
    anchor: np.ndarray  # impulses at which springs are relaxed, N s
    struck: np.ndarray | None  # impulses of impacts, N s; None without restitution

    @property
    def frictional(self) -> bool:
        """Whether impulses have three components."""
        return self.coulomb is not None

    @property
    def vectors(self) -> np.ndarray:
        """Impulses of contact and impacts in global axes, shape (contacts, 3), N s."""
        total = self.impulse if self.struck is None else self.impulse + self.struck
        return total if self.frictional else total * self.normal

    @property
    def loaded(self) -> np.ndarray:
        """Contacts with an impulse, shape (contacts,), bool."""
        return np.asarray(self.vectors.any(axis=1))


def relative_velocity(
    contacts: Contacts, velocity: np.ndarray, rate: np.ndarray | None = None
) -> np.ndarray:
    """Return u at the contacts, i minus j, with the strain rate of a cell, (contacts, 3), m/s."""
    (i, j), normal = contacts.ends.T, contacts.normal
    u = velocity[i, :3] - velocity[j, :3]
    if contacts.frictional:  # without friction, u is the velocity of the centres
        u -= np.cross(velocity[i, 4:7] + velocity[j, 4:7], normal)
    return np.asarray(u if rate is None else u + rate * contacts.branch)


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
def _way_apart(i, j, nx, ny, nz, shift):  # type: ignore[no-untyped-def]
    """Return the way by which the shift of two bodies parts them along a normal, m."""
    if shift.shape[0] == 0:
        return 0.0
    way = (shift[i, 0] - shift[j, 0]) * nx + (shift[i, 1] - shift[j, 1]) * ny
    return way + (shift[i, 2] - shift[j, 2]) * nz


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
    n, count = radius.size, 0
    pairs = np.empty((n * kind.size, 2), np.int32)
    for w in range(kind.size):
        for i in range(n):
            if _gap(i, n + w, position, radius, period, kind, point, axis, bore)[0] <= reach:
                pairs[count, 0], pairs[count, 1] = i, n + w
                count += 1
    return pairs[:count].copy()


@compiled
def allowed_step(pairs, place, velocity, longest, last, accuracy, gravity):  # type: ignore[no-untyped-def]
    r"""Longest step, s, after which overlaps by impacts are at most a share of a radius.

    A pair with gap g and smaller radius R that closes with the speed u, gravity included, requires
    :math:`h \le \max(g - \text{accuracy}\, R, \text{accuracy}\, R) / u`, so that the step before
    the impact is short too; grains that roll on each other or would fall off with the speed v
    require :math:`h \le \sqrt{\text{accuracy}}\, R / \max(v, \sqrt{\text{gravity}\, R})`.
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
    """Return the fields of :class:`Contacts` for pairs that may touch, and their number."""
    position, radius, period, walls = place
    kind, point, axis, bore = walls
    pair_ends, start, spring, struck, wanted, give = pairs
    h, velocity, shift, mobility, coefficient, strain = step[:6]
    relaxation, across, slack, least = step[6:]
    n, m = radius.size, 0
    size, width = start.shape
    number, ends = np.empty(size, np.int64), np.empty((size, 2), np.int32)
    normal, branch = np.empty((size, 3)), np.empty((size, 3))
    gaps, bias, mass, compliance = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    frictional = coefficient.size > 0
    coulomb = np.empty((size if frictional else 0, 3))
    impulse, anchor = np.empty((size, width)), np.empty((size, width))
    shock = np.zeros((size, width))
    for k in range(size):
        i, j = pair_ends[k, 0], pair_ends[k, 1]
        gap, nx, ny, nz = _gap(i, j, position, radius, period, kind, point, axis, bore)
        if j < n:
            smaller, length = min(radius[i], radius[j]), gap + radius[i] + radius[j]
        else:
            smaller, length = radius[i], 0.0
        gap += slack[0] * smaller + slack[1]
        way = _way_apart(i, j, nx, ny, nz, shift)
        ahead = length * (strain[0, 0] * nx * nx + strain[0, 1] * ny * ny + strain[0, 2] * nz * nz)
        ahead += (velocity[i, 0] - velocity[j, 0]) * nx + (velocity[i, 1] - velocity[j, 1]) * ny
        ahead += (velocity[i, 2] - velocity[j, 2]) * nz
        near = gap + way + h * min(ahead, 0.0) < CONTACT_DISTANCE * smaller
        met = struck.shape[0] > 0 and _had_impulse(k, struck)
        if not (wanted[k] or near or met or _had_impulse(k, start)):
            continue
        gaps[m] = gap + way
        bias[m] = max(least, (gap / h if gap > 0.0 else gap / relaxation) + way / h)
        number[m], ends[m, 0], ends[m, 1] = k, i, j
        normal[m, 0], normal[m, 1], normal[m, 2] = nx, ny, nz
        bx, by, bz = length * nx, length * ny, length * nz
        branch[m, 0], branch[m, 1], branch[m, 2] = bx, by, bz
        cell = (strain[1, 0] * bx) ** 2 + (strain[1, 1] * by) ** 2 + (strain[1, 2] * bz) ** 2
        mass[m] = 1.0 / (mobility[i, 0] + mobility[j, 0] + cell)
        compliance[m] = 0.0 if met else give[k]  # a spring would change the bounce
        if frictional:
            masses = mobility[i, 1] + mobility[j, 1] + mobility[i, 2] + mobility[j, 2]
            coulomb[m, 0], coulomb[m, 1] = 1.0 / (masses + cell), coefficient[max(0, 1 + j - n)]
            coulomb[m, 2] = max(across, compliance[m])
        for a in range(width):
            impulse[m, a], anchor[m, a] = start[k, a], spring[k, a]
            if met:
                shock[m, a] = struck[k, a]
        m += 1
    built = (number, ends, normal, gaps, bias, mass, compliance, coulomb, branch, impulse, anchor)
    return (*built, shock), m


@compiled
def mark_overlaps(pairs, number, used, place, step, velocity, rate):  # type: ignore[no-untyped-def]
    """Mark pairs that overlap too far after the step as ``wanted``; return their number.

    The compliance of a contact, ``used`` by the pair ``number``, is multiplied by ``STIFFENING``.
    """
    position, radius, period, walls = place
    kind, point, axis, bore = walls
    ends, wanted, compliance, h = pairs.ends, pairs.wanted, pairs.compliance, step.length
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
        gap += _way_apart(i, j, nx, ny, nz, step.shift) + step.slack[1]
        if gap + h * u < -(CONTACT_OVERLAP if touches else APART_OVERLAP) * smaller:
            wanted[k] = True
            if touches:
                compliance[k] *= STIFFENING
            new += 1
    return new


@compiled
def penetration(ends, place):  # type: ignore[no-untyped-def]
    """Largest overlap of a pair relative to its smaller radius, and the pair, or -1."""
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


def find_pairs(
    position: np.ndarray, radius: np.ndarray, reach: float, period: np.ndarray
) -> np.ndarray:
    """List all pairs of grains with a gap of at most a reach, by levels of halved sizes."""
    repeats = np.isfinite(period)
    place = position.copy()
    place[:, repeats] %= period[repeats]
    place[:, repeats] *= place[:, repeats] < period[repeats]  # a tiny negative rounds up to it
    box, largest = np.where(repeats, period, 0.0), float(radius.max())
    level = np.floor(np.log2(largest / radius) * (1.0 - 1e-12)).astype(int)
    members = [np.flatnonzero(level == k) for k in np.unique(level)]
    trees = [cKDTree(place[grains], boxsize=box) for grains in members]
    found = [np.empty((0, 2), np.int32)]
    for k, (tree, grains) in enumerate(zip(trees, members, strict=True)):
        for other, larger in zip(trees[: k + 1], members[: k + 1], strict=True):
            far = float(radius[grains].max() + radius[larger].max()) + reach
            near = tree.sparse_distance_matrix(other, far, output_type="ndarray")
            i, j = grains[near["i"]], larger[near["j"]]
            chosen = near["v"] <= radius[i] + radius[j] + reach
            if other is tree:  # a pair within a level belongs to its first grain
                chosen &= i < j
            found.append(np.column_stack([i, j])[chosen].astype(np.int32))
    pairs = np.concatenate(found)
    return np.asarray(pairs[np.lexsort(pairs.T[::-1])])
