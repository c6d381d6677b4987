r"""Pairs of neighbouring grains and their contacts: gaps, normals, masses and biases."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from multiscale.macro.granulate.bodies import CYLINDER

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


class Geometry(NamedTuple):
    """Pairs at the start of a step; the normal points to body i, a grain."""

    gap: np.ndarray  # shape (pairs,), m
    normal: np.ndarray  # shape (pairs, 3)
    smaller: np.ndarray  # radius, shape (pairs,), m
    branch: np.ndarray  # from centre j to centre i, shape (pairs, 3), m; zero at walls


class Pairs(NamedTuple):
    """Pairs that may touch in a step; impulses have c = 1 or 3 components."""

    ends: np.ndarray  # bodies, int32, shape (pairs, 2); walls are numbered after the grains
    impulse: np.ndarray  # impulses from which the sweeps start, shape (pairs, c), N s
    anchor: np.ndarray  # impulses at which contact springs are relaxed, shape (pairs, c), N s
    struck: np.ndarray  # impulses of impacts in this step; no rows without restitution, N s
    forced: np.ndarray  # whether a pair is a contact for any gap, shape (pairs,)
    compliance: np.ndarray  # shape (pairs,), dimensionless


class FreeStep(NamedTuple):
    """A step before its contacts are known; arrays as in :class:`Velocities`."""

    length: float  # s
    grains: int  # bodies that are not walls
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


def measure_pairs(ends: np.ndarray, place: Positions) -> Geometry:
    """Return gaps and normals of pairs of a grain and another grain or a wall."""
    position, radius, period, walls = place
    n, (i, j) = radius.size, ends.T
    other, repeats = np.minimum(j, n - 1), np.isfinite(period)
    away = position[i] - position[other]
    away[:, repeats] -= period[repeats] * np.round(away[:, repeats] / period[repeats])
    length = np.linalg.norm(away, axis=1)
    gap, smaller = length - radius[i] - radius[other], np.minimum(radius[i], radius[other])
    normal = away / np.where(length > 0.0, length, 1.0)[:, None]

    at = np.flatnonzero(j >= n)
    grain, wall = i[at], j[at] - n
    out, axis = position[grain] - walls.point[wall], walls.axis[wall]
    height = np.sum(out * axis, axis=1)
    across, pipe = out - height[:, None] * axis, walls.kind[wall] == CYLINDER
    far = np.linalg.norm(across, axis=1)
    inward = np.where((far > 0.0)[:, None], -across, [1.0, 0.0, 0.0])
    inward /= np.where(far > 0.0, far, 1.0)[:, None]
    gap[at] = np.where(pipe, walls.bore[wall] - far, height) - radius[grain]
    normal[at] = np.where(pipe[:, None], inward, axis)
    smaller[at], length[at] = radius[grain], 0.0
    return Geometry(gap, normal, smaller, length[:, None] * normal)


def find_wall_pairs(place: Positions, reach: float) -> np.ndarray:
    """List the pairs (grain, grains + wall) with a gap of at most the reach."""
    n, walls = place.radius.size, place.walls.kind.size
    ends = np.column_stack([np.tile(np.arange(n), walls), n + np.repeat(np.arange(walls), n)])
    return np.asarray(ends[measure_pairs(ends, place).gap <= reach], np.int32)


def _parting(ends: np.ndarray, geometry: Geometry, vector: np.ndarray) -> np.ndarray:
    i, j = ends.T
    return np.asarray(np.sum((vector[i, :3] - vector[j, :3]) * geometry.normal, axis=1))


def allowed_step(
    pairs: Pairs,
    place: Positions,
    velocity: np.ndarray,
    longest: float,
    last: float,
    accuracy: float,
    gravity: float,
) -> float:
    """Longest step, s, after which overlaps by impacts are at most a share of a radius."""
    geometry, (i, j) = measure_pairs(pairs.ends, place), pairs.ends.T
    closing = -_parting(pairs.ends, geometry, velocity)
    touched, room = pairs.impulse.any(axis=1), accuracy * geometry.smaller
    rolls = touched & (j < place.radius.size)
    square = np.sum((velocity[i, :3] - velocity[j, :3]) ** 2, axis=1) - closing**2
    past = np.sqrt(np.maximum(square, gravity * geometry.smaller))
    closing = closing + np.where(touched, 0.0, 0.5 * (last + longest) * gravity)
    # pair with gap g, smaller radius R, closing speed u: h <= max(g - accuracy R, accuracy R) / u,
    # so that the step before the impact is short too; grains that roll or would fall off with the
    # speed v: h <= sqrt(accuracy) R / max(v, sqrt(gravity R))
    limits = (
        (np.maximum(geometry.gap - room, room), closing, closing > 0.0),
        (np.sqrt(accuracy) * geometry.smaller, past, rolls & (past > 0.0)),
    )
    return min(float(np.min(way[c] / speed[c], initial=longest)) for way, speed, c in limits)


def build_contacts(pairs: Pairs, geometry: Geometry, step: FreeStep) -> Contacts:
    """Return the contacts: forced, with an impulse before, or near in a step without impulses."""
    h, strain, smaller = step.length, step.strain, geometry.smaller
    gap, way = geometry.gap + step.slack[0] * smaller + step.slack[1], np.zeros_like(smaller)
    met = np.zeros(len(smaller), bool)
    if len(step.shift):
        way = _parting(pairs.ends, geometry, step.shift)
        met = np.asarray(pairs.struck.any(axis=1))
    ahead = _parting(pairs.ends, geometry, step.velocity)
    ahead += (geometry.branch * geometry.normal) @ strain[0]
    near = gap + way + h * np.minimum(ahead, 0.0) < CONTACT_DISTANCE * smaller
    chosen = np.flatnonzero(pairs.forced | near | met | pairs.impulse.any(axis=1))

    (i, j), branch, mobility = pairs.ends[chosen].T, geometry.branch[chosen], step.mobility
    gap, way = gap[chosen], way[chosen]
    bias = np.where(gap > 0.0, gap / h, gap / step.relaxation) + way / h
    cell = np.sum((strain[1] * branch) ** 2, axis=1)
    # a spring would change a bounce
    compliance, coulomb = np.where(met, 0.0, pairs.compliance)[chosen], None
    if step.friction.size:
        across = mobility[i, 1] + mobility[j, 1] + mobility[i, 2] + mobility[j, 2] + cell
        friction = step.friction[np.maximum(0, j - step.grains + 1)]
        give = np.maximum(step.across, compliance)
        coulomb = np.column_stack([1.0 / across, friction, give])
    return Contacts(
        number=chosen,
        ends=pairs.ends[chosen],
        normal=geometry.normal[chosen],
        gap=gap + way,
        bias=np.maximum(bias, step.least),
        mass=1.0 / (mobility[i, 0] + mobility[j, 0] + cell),
        compliance=compliance,
        coulomb=coulomb,
        branch=branch,
        impulse=pairs.impulse[chosen],
        anchor=pairs.anchor[chosen],
        struck=pairs.struck[chosen] if len(step.shift) else None,
    )


def mark_overlaps(
    pairs: Pairs,
    contacts: Contacts,
    geometry: Geometry,
    step: FreeStep,
    velocity: np.ndarray,
    rate: np.ndarray,
) -> bool:
    """Mark pairs that overlap too far after the step as ``forced``; report whether any do."""
    used = np.full(len(pairs.ends), -1.0)
    used[contacts.number] = contacts.compliance
    gap = geometry.gap + step.slack[1]
    if len(step.shift):
        gap = gap + _parting(pairs.ends, geometry, step.shift)
    u = _parting(pairs.ends, geometry, velocity) + (geometry.branch * geometry.normal) @ rate
    allowed = np.where(used >= 0.0, CONTACT_OVERLAP, APART_OVERLAP) * geometry.smaller
    deep = gap + step.length * u < -allowed
    deep &= np.where(used >= 0.0, used > LEAST_COMPLIANCE, ~pairs.forced)
    pairs.forced[deep] = True
    pairs.compliance[deep & (used >= 0.0)] *= STIFFENING
    return bool(deep.any())


def penetration(ends: np.ndarray, place: Positions) -> tuple[float, int]:
    """Largest overlap of a pair relative to its smaller radius, and the pair, or -1."""
    geometry = measure_pairs(ends, place)
    overlap = -geometry.gap / geometry.smaller
    if not np.any(overlap > 0.0):
        return 0.0, -1
    return float(overlap.max()), int(np.argmax(overlap))


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
    groups = [np.empty((0, 2), np.int32)]
    for k, (tree, grains) in enumerate(zip(trees, members, strict=True)):
        for other, larger in zip(trees[: k + 1], members[: k + 1], strict=True):
            far = float(radius[grains].max() + radius[larger].max()) + reach
            near = tree.sparse_distance_matrix(other, far, output_type="ndarray")
            i, j = grains[near["i"]], larger[near["j"]]
            chosen = near["v"] <= radius[i] + radius[j] + reach
            if other is tree:  # a pair within a level belongs to its first grain
                chosen &= i < j
            groups.append(np.column_stack([i, j])[chosen].astype(np.int32))
    pairs = np.concatenate(groups)

    # by first grains, levels and cells: sweeps pass through space in this order
    i, j = pairs.T
    size = 2.0 * largest * 0.5 ** level[j, None] + reach
    whole = np.where(repeats, period, 1.0)
    count = np.maximum(1.0, np.floor(whole / size))  # cells along a period
    width = np.where(repeats, whole / count, size)
    cells = np.floor(position[j] / width) - np.floor(position[i] / width)
    back = np.where(count > 2.0, 1.0, 0.0)
    cells = np.where(repeats, np.mod(cells + back, count) - back, cells)
    return np.asarray(pairs[np.lexsort((j, *cells.T[::-1], level[j], i))])
