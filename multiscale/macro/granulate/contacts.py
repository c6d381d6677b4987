"""Contacts of neighbouring grains: gaps, normals, masses and biases for the sweeps."""

from dataclasses import dataclass

import numpy as np

from multiscale.macro.granulate.grain_bodies import PLANE
from multiscale.numerics.compiled import compiled

__all__ = [
    "Contacts",
    "allowed_step",
    "build_contacts",
    "find_wall_pairs",
    "mark_overlaps",
    "penetration",
]

STIFFENING, LEAST_COMPLIANCE = 0.1, 5e-5
"""Factor on the compliance of a contact that overlaps too far, and the compliance below which a
contact is not stiffened further; dimensionless."""


@dataclass(frozen=True)
class Contacts:
    """The contacts of a step; columns as in :mod:`multiscale.macro.granulate.contact_solver`.

    Attributes
    ----------
    ends : ndarray of int32, shape (contacts, 2), bodies of each contact
    data : ndarray, shape (contacts, 6)
        Normal, bias (m/s), normal mass (kg) and compliance (dimensionless).
    coulomb : ndarray, shape (contacts, 2), or None
        Tangential mass, kg, and friction coefficient; None if nothing has friction.
    impulse : ndarray, shape (contacts, 3), or (contacts, 1) without friction
        Impulses in global axes, or along the normal, N s.
    anchor : ndarray, same shape as ``impulse``
        Impulses at which the contact springs are relaxed, N s.
    """

    ends: np.ndarray
    data: np.ndarray
    coulomb: np.ndarray | None
    impulse: np.ndarray
    anchor: np.ndarray

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray, np.ndarray]:
        """The fields in the order of the arguments of the kernels."""
        return self.ends, self.data, self.coulomb, self.impulse, self.anchor

    @property
    def normal_impulse(self) -> np.ndarray:
        """Normal impulses, shape (contacts,), N s."""
        if self.coulomb is None:
            return self.impulse[:, 0]
        return np.asarray(np.sum(self.impulse * self.data[:, :3], axis=1))

    @property
    def vectors(self) -> np.ndarray:
        """Impulses in global axes, shape (contacts, 3), N s."""
        return self.impulse * self.data[:, :3] if self.coulomb is None else self.impulse


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
def _had_impulse(k, pair_impulse):  # type: ignore[no-untyped-def]
    """Whether a pair had an impulse in the last step."""
    loaded = False
    for a in range(pair_impulse.shape[1]):
        loaded = loaded or pair_impulse[k, a] != 0.0
    return loaded


@compiled
def find_wall_pairs(position, radius, reach, period, kind, point, axis, bore):  # type: ignore[no-untyped-def]
    """List the grains whose gap to a wall is at most the reach, as pairs (grain, grains + wall)."""
    n, walls = radius.size, kind.size
    pairs = np.empty((n * walls, 2), np.int32)
    found = 0
    for w in range(walls):
        for i in range(n):
            if _gap(i, n + w, position, radius, period, kind, point, axis, bore)[0] <= reach:
                pairs[found, 0], pairs[found, 1] = i, n + w
                found += 1
    return pairs[:found].copy()


@compiled
def allowed_step(  # type: ignore[no-untyped-def]
    pairs, pair_impulse, position, radius, period, walls, velocity, longest, last, accuracy, gravity
):
    r"""Longest step, s, in which no impact is missed by more than a share of a radius.

    A pair with gap g and smaller radius R that closes with the speed u requires

        h <= max(g - accuracy R, accuracy R) / u,                                         (1)

    so that the step before the impact is short too: forces that act from the middle of a long step
    on would take part in the impact. Grains that roll or slide over each other with the speed v, or
    would fall off each other, require

        h <= sqrt(accuracy) R / max(v, sqrt(gravity R)).                                  (2)

    The closing speed of pairs that do not touch includes gravity, since one grain may be supported.
    """
    kind, point, axis, bore = walls
    h, turn = longest, np.sqrt(accuracy)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        gap, nx, ny, nz = _gap(i, j, position, radius, period, kind, point, axis, bore)
        smaller = min(radius[i], radius[j]) if j < radius.size else radius[i]
        touched = _had_impulse(k, pair_impulse)
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
def build_contacts(  # type: ignore[no-untyped-def]
    pairs,
    pair_impulse,
    spring_impulse,
    approach,
    hits,
    wanted,
    compliance,
    position,
    radius,
    period,
    walls,
    old,
    velocity,
    mobility,
    law,
    friction,
    h,
    near,
    cell,
):
    """Build the arrays of the sweeps from the pairs that may touch within a step.

    ``law`` holds the restitution, the relaxation time (s), the speed below which impacts do not
    bounce (m/s), and the shares of the velocity increment of a step before and after an impact;
    ``friction`` the coefficients of the grains and of each wall, none without friction;
    ``compliance`` (pairs,) the compliance of each pair. A pair becomes a contact if it is wanted,
    had an impulse, or comes nearer than ``near`` times its smaller radius in a step without
    impulses. ``cell`` (2, 3) holds the strain rates of the cell and one over the root of its
    inertia; the third return value is ``cell`` of the sweeps.

    An impact in the first half of a step bounces in this step. An impact in the second half, or
    one caused within the step, whose normal velocity is in ``hits`` (pairs,), ends the step in
    contact and bounces in the next step. The fourth return value is therefore the normal velocity
    before such an impact, and ``approach`` (pairs,) is this array of the last step, m/s.
    """
    kind, point, axis, bore = walls
    restitution, relaxation, rest, first, last = law
    n, m = radius.size, 0
    size, width = pair_impulse.shape
    ends, data = np.empty((size, 2), np.int32), np.empty((size, 6))
    frictional = friction.size > 0
    coulomb = np.empty((size if frictional else 0, 2))
    stretch, delayed_velocity = np.empty((size + 2, 3)), np.zeros(size)
    for a in range(3):  # a slice would have the compiler write its error message
        stretch[0, a], stretch[1, a] = cell[0, a], cell[1, a]
    impulse, anchor = np.empty((size, width)), np.empty((size, width))
    index = np.empty(size, np.int64)
    for k in range(size):
        i, j = pairs[k, 0], pairs[k, 1]
        gap, nx, ny, nz = _gap(i, j, position, radius, period, kind, point, axis, bore)
        if j < n:
            smaller, length = min(radius[i], radius[j]), gap + radius[i] + radius[j]
        else:
            smaller, length = radius[i], 0.0
        affine = length * (cell[0, 0] * nx * nx + cell[0, 1] * ny * ny + cell[0, 2] * nz * nz)
        ahead = affine  # normal velocity without impulses, and before the step
        ahead += (velocity[i, 0] - velocity[j, 0]) * nx + (velocity[i, 1] - velocity[j, 1]) * ny
        ahead += (velocity[i, 2] - velocity[j, 2]) * nz
        if not (
            wanted[k] or _had_impulse(k, pair_impulse) or gap + h * min(ahead, 0.0) < near * smaller
        ):
            continue
        before = (old[i, 0] - old[j, 0]) * nx + (old[i, 1] - old[j, 1]) * ny
        before += (old[i, 2] - old[j, 2]) * nz
        gained = ahead - affine - before
        fastest = min(before + first * gained, approach[k], hits[k])
        impact = restitution > 0.0 and fastest < -rest
        delayed = impact and approach[k] == 0.0 and gap + 0.5 * h * before > 0.0
        bias = gap / h if gap > 0.0 else gap / relaxation
        if impact and not delayed:
            bias = restitution * fastest - last * gained
        delayed_velocity[k] = fastest if delayed else 0.0
        bx, by, bz = length * nx, length * ny, length * nz
        stretch[m + 2, 0], stretch[m + 2, 1], stretch[m + 2, 2] = bx, by, bz
        give = (cell[1, 0] * bx) ** 2 + (cell[1, 1] * by) ** 2 + (cell[1, 2] * bz) ** 2
        masses = mobility[i, 0] + mobility[j, 0] + give
        ends[m, 0], ends[m, 1], index[m] = i, j, k
        data[m, 0], data[m, 1], data[m, 2] = nx, ny, nz
        data[m, 3] = bias
        data[m, 4] = 1.0 / masses
        data[m, 5] = 0.0 if impact else compliance[k]  # a spring would reduce the bounce
        if frictional:
            masses = mobility[i, 1] + mobility[j, 1] + mobility[i, 2] + mobility[j, 2]
            coulomb[m, 0], coulomb[m, 1] = 1.0 / (masses + give), friction[max(0, 1 + j - n)]
        for a in range(width):
            impulse[m, a] = pair_impulse[k, a]
            anchor[m, a] = spring_impulse[k, a]
        m += 1
    across = coulomb[:m] if frictional else None
    contacts = ends[:m], data[:m], across, impulse[:m], anchor[:m]
    return contacts, index[:m], stretch[: m + 2], delayed_velocity


@compiled
def mark_overlaps(  # type: ignore[no-untyped-def]
    pairs,
    index,
    data,
    hits,
    wanted,
    compliance,
    position,
    radius,
    period,
    walls,
    velocity,
    h,
    rate,
    allowed,
):
    """Find the pairs that overlap too far after the step; return their number.

    A pair that is no contact is marked in ``wanted``, with its normal velocity in ``hits``; the
    compliance of a contact is multiplied by ``STIFFENING``. ``allowed`` holds the allowed overlap
    of pairs without and with contact, relative to the smaller radius.
    """
    kind, point, axis, bore = walls
    new, m = 0, 0
    for k in range(pairs.shape[0]):
        touches = m < index.size and index[m] == k
        if touches:
            m += 1
            if data[m - 1, 5] <= LEAST_COMPLIANCE:
                continue
        elif wanted[k]:
            continue
        i, j = pairs[k, 0], pairs[k, 1]
        gap, nx, ny, nz = _gap(i, j, position, radius, period, kind, point, axis, bore)
        u = (velocity[i, 0] - velocity[j, 0]) * nx + (velocity[i, 1] - velocity[j, 1]) * ny
        u += (velocity[i, 2] - velocity[j, 2]) * nz
        smaller = radius[i]
        if j < radius.size:
            smaller = min(smaller, radius[j])
            affine = rate[0] * nx * nx + rate[1] * ny * ny + rate[2] * nz * nz
            u += affine * (gap + radius[i] + radius[j])
        if gap + h * u < -allowed[int(touches)] * smaller:
            wanted[k] = True
            if touches:
                compliance[k] *= STIFFENING
            else:
                hits[k] = u
            new += 1
    return new


@compiled
def penetration(pairs, position, radius, period, walls):  # type: ignore[no-untyped-def]
    """Largest overlap of a pair relative to its smaller radius, and the pair (-1 if none)."""
    kind, point, axis, bore = walls
    worst, which = 0.0, -1
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        gap = _gap(i, j, position, radius, period, kind, point, axis, bore)[0]
        smaller = min(radius[i], radius[j]) if j < radius.size else radius[i]
        if -gap > worst * smaller:
            worst, which = -gap / smaller, k
    return worst, which
