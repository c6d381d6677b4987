r"""Pairs of neighbouring grains and their contacts: gaps, normals, masses and biases."""

from typing import NamedTuple

import numpy as np

from multiscale.executors import run_ranges
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

LEAST = 1000  # grains for a thread


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

    A pair with gap g and smaller radius R that closes with the speed u requires

        h <= max(g - accuracy R, accuracy R) / u,                                         (1)

    so that the step before the impact is short too: forces that act from the middle of a long step
    on would contribute to the impact. Grains that roll or slide over each other with the speed v,
    or would fall off each other, require

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
    ``CONTACT_DISTANCE`` in a step without impulses. Returns the fields of :class:`Contacts` and
    their number.
    """
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
    """Mark the pairs that overlap too far after the step; return their number.

    A pair without contact becomes ``wanted``; the compliance of a contact, ``used`` by the pair
    ``number``, is multiplied by ``STIFFENING``. ``rate`` are the strain rates of the cell, 1/s.
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
    r"""List all pairs of grains with a gap of at most a reach.

    Notes
    -----
    Grains are sorted into levels by size; each grain searches its level and all coarser levels, so
    that the work is proportional to the number of grains for any ratio of their sizes. Level k has
    the radii in :math:`(R_{\max} 2^{-k-1}, R_{\max} 2^{-k}]` and cells that are wider than
    :math:`2 R_{\max} 2^{-k}` plus the reach, in a hash table. Pairs are counted and listed in two
    parallel passes; the list does not depend on the number of threads.

    References
    ----------
    .. [1] H. Mio, A. Shimosaka, Y. Shirakawa and J. Hidaka, J. Chem. Eng. Japan 38 (2005)
       969-975, for cells of several sizes in granular simulations.
    """
    # levels and their cells
    largest = float(radius.max())
    level = np.floor(np.log2(largest / radius) * (1.0 - 1e-12)).astype(np.int64)
    levels = int(level.max()) + 1
    width = np.empty((levels, 3))
    count = np.zeros((levels, 3), np.int64)  # cells along a period, 0 without a period
    for k in range(levels):
        cell = 2.0 * largest * 0.5**k + reach
        for a in range(3):
            if np.isfinite(period[a]):
                count[k, a] = max(1, int(period[a] / cell))
                width[k, a] = period[a] / count[k, a]
            else:
                width[k, a] = cell

    # count the pairs of each grain, then list them
    table = 1 << max(4, int(2 * radius.size - 1).bit_length())
    grains = (position, radius, reach, period)
    grid = (level, width, count, *_fill_cells(position, level, width, count, table))
    pair_counts = np.empty(radius.size, np.int64)
    run_ranges(_count_pairs, radius.size, grains, grid, pair_counts, least=LEAST)
    starts = np.concatenate([[0], np.cumsum(pair_counts)])
    pairs = np.empty((starts[-1], 2), np.int32)
    run_ranges(_list_pairs, radius.size, grains, grid, starts, pairs, least=LEAST)
    return pairs


@compiled
def _hash(k, a, b, c, table):  # type: ignore[no-untyped-def]
    """Return the slot of a cell in a table; the size of the table is a power of two."""
    return (a * 73856093 ^ b * 19349663 ^ c * 83492791 ^ k * 2654435761) & (table - 1)


@compiled
def _fill_cells(position, level, width, count, table):  # type: ignore[no-untyped-def]
    """Chain the grains of each slot of the table."""
    heads = np.full(table, -1, np.int64)
    following = np.empty(level.size, np.int64)
    cells = np.empty((level.size, 3), np.int64)
    for i in range(level.size - 1, -1, -1):
        k = level[i]
        for a in range(3):
            c = int(np.floor(position[i, a] / width[k, a]))
            cells[i, a] = c % count[k, a] if count[k, a] > 0 else c
        slot = _hash(k, cells[i, 0], cells[i, 1], cells[i, 2], table)
        following[i] = heads[slot]
        heads[slot] = i
    return heads, following, cells


@compiled
def _visit(i, grains, grid, out, first):  # type: ignore[no-untyped-def]
    """Count the pairs of grain i, and list them in ``out`` if it is not empty."""
    position, radius, reach, period = grains
    level, width, count, heads, following, cells = grid
    n_pairs = 0
    home = np.empty(3, np.int64)
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    for k in range(level[i] + 1):
        for a in range(3):
            home[a] = int(np.floor(position[i, a] / width[k, a]))
            low[a], high[a] = -1, 1
            if count[k, a] == 1:
                low[a], high[a] = 0, 0
            elif count[k, a] == 2:
                low[a] = 0
        for da in range(low[0], high[0] + 1):
            ca = home[0] + da
            if count[k, 0] > 0:
                ca %= count[k, 0]
            for db in range(low[1], high[1] + 1):
                cb = home[1] + db
                if count[k, 1] > 0:
                    cb %= count[k, 1]
                for dc in range(low[2], high[2] + 1):
                    cc = home[2] + dc
                    if count[k, 2] > 0:
                        cc %= count[k, 2]
                    j = heads[_hash(k, ca, cb, cc, heads.size)]
                    while j >= 0:
                        here = cells[j, 0] == ca and cells[j, 1] == cb and cells[j, 2] == cc
                        # a pair within a level belongs to its first grain
                        if here and level[j] == k and (k < level[i] or j > i):
                            square = 0.0
                            for a in range(3):
                                d = position[i, a] - position[j, a]
                                if period[a] < np.inf:
                                    d -= period[a] * np.round(d / period[a])
                                square += d * d
                            distance = radius[i] + radius[j] + reach
                            if square <= distance * distance:
                                if out.shape[0] > 0:
                                    out[first + n_pairs, 0] = i
                                    out[first + n_pairs, 1] = j
                                n_pairs += 1
                        j = following[j]
    return n_pairs


@compiled
def _count_pairs(begin, end, grains, grid, pair_counts):  # type: ignore[no-untyped-def]
    empty = np.empty((0, 2), np.int32)
    for i in range(begin, end):
        pair_counts[i] = _visit(i, grains, grid, empty, np.int64(0))


@compiled
def _list_pairs(begin, end, grains, grid, starts, pairs):  # type: ignore[no-untyped-def]
    """List the pairs in the order of the grains to which they belong."""
    for i in range(begin, end):
        if starts[i + 1] > starts[i]:
            _visit(i, grains, grid, pairs, starts[i])
