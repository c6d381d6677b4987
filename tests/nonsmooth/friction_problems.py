"""Friction problems for the tests: rigid bodies in contact, and random matrices.

Every generator returns (W, q, mu), or the bodies behind them where the name says so: the mass
matrix M, the transfer matrix H from impulses to bodies, the momentum f without contact impulses.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

STEP, GRAVITY = 1e-2, 9.81  # s, m/s²


@dataclass(frozen=True)
class Bodies:
    """Rigid bodies with contacts: M v = f + H r and u = H^T v."""

    mass: csr_array
    transfer: csr_array
    momentum: np.ndarray
    friction: np.ndarray

    def condensed(self):
        """W = H^T M^-1 H, q = H^T M^-1 f and mu."""
        inverse = diags_array(1.0 / self.mass.diagonal())
        W = csr_array(self.transfer.T @ inverse @ self.transfer)
        return W, self.transfer.T @ (self.momentum / self.mass.diagonal()), self.friction

    def body_velocity(self, reaction):
        return (self.momentum + self.transfer @ reaction) / self.mass.diagonal()


def rigid_bodies(masses, inertias, centres, contacts, forces, friction):
    """Assemble bodies from contacts (point, normal, body above, body below or -1 for the ground).

    ``inertias`` has shape (bodies, 3), kg m²; ``forces`` (bodies, 6), N and N m.
    """
    n = len(masses)
    rows, columns, values = [], [], []
    for c, (point, normal, above, below) in enumerate(contacts):
        frame = frame_of(normal)
        for body, sign in ((above, 1.0), (below, -1.0)):
            if body < 0:
                continue
            arm = np.asarray(point) - centres[body]
            for a in range(3):
                wrench = sign * np.concatenate([frame[a], np.cross(arm, frame[a])])
                rows.extend(range(6 * body, 6 * body + 6))
                columns.extend([3 * c + a] * 6)
                values.extend(wrench)
    H = csr_array((values, (rows, columns)), shape=(6 * n, 3 * len(contacts)))
    diagonal = np.column_stack([np.repeat(np.asarray(masses)[:, None], 3, axis=1), inertias])
    M = csr_array(diags_array(diagonal.ravel()))
    mu = np.broadcast_to(np.asarray(friction, dtype=float), (len(contacts),)).copy()
    return Bodies(M, H, STEP * np.asarray(forces, dtype=float).ravel(), mu)


def frame_of(normal):
    """Rows: normal and two tangents."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    other = np.eye(3)[np.argmin(np.abs(n))]
    t = np.cross(n, other)
    t /= np.linalg.norm(t)
    return np.array([n, t, np.cross(n, t)])


PUSHES = ("each", "top", "sideways", "one", "squeeze")
"""Ways to push a stack; see :func:`lateral_forces`."""


def box_stack(n, rng, *, mass_ratio=1.0, friction=0.5, way="each", push=0.3):
    """n boxes on the ground, four corner contacts each, pushed sideways; hyperstatic."""
    masses = mass_ratio ** rng.uniform(0.0, 1.0, n)
    sides = rng.uniform(0.6, 1.4, (n, 3))
    base = np.concatenate([[0.0], np.cumsum(sides[:-1, 2])])
    shift = np.cumsum(rng.uniform(-0.05, 0.05, (n, 2)), axis=0)
    centres = np.column_stack([shift, base + 0.5 * sides[:, 2]])
    squares = sides**2
    inertias = masses[:, None] / 12.0 * (squares.sum(axis=1)[:, None] - squares)
    contacts = []
    for i in range(n):
        half = 0.5 * (sides[i] if i == 0 else np.minimum(sides[i], sides[i - 1]))
        for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            point = [shift[i, 0] + x * half[0], shift[i, 1] + y * half[1], base[i]]
            contacts.append((point, [0.0, 0.0, 1.0], i, i - 1))
    forces = np.zeros((n, 6))
    forces[:, 2] = -GRAVITY * masses
    forces[:, :2] = lateral_forces(masses, way, push, rng)
    return rigid_bodies(masses, inertias, centres, contacts, forces, friction)


def lateral_forces(masses, way, push, rng):
    """Lateral forces, N, shape (n, 2), so that some stacks stick, some slide, some tip over.

    Relative to ``push``: each box by its own weight, the top box alone, all in one direction,
    one box by the weight of the stack, or some by all the weight that rests on them, which
    squeezes light boxes out like pips.
    """
    n = len(masses)
    weight = GRAVITY * masses
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    size = push * rng.uniform(0.0, 1.0, n)
    if way == "each":
        size = size * weight
    elif way == "top":
        size = np.where(np.arange(n) == n - 1, push * weight, 0.0)
    elif way == "sideways":
        size, angle = size * weight, np.full(n, angle[0])
    elif way == "one":
        size = np.where(np.arange(n) == rng.integers(n), 0.5 * push * weight.sum(), 0.0)
    else:
        above = np.cumsum(weight[::-1])[::-1]
        size = (rng.uniform(size=n) < 0.4) * size * above
    return np.column_stack([size * np.cos(angle), size * np.sin(angle)])


def random_stack(seed):
    """One of the 200 stacks: 5-20 boxes, mass ratio 1 to 1e6, pushed in any of five ways."""
    rng = np.random.default_rng(seed=seed)
    return box_stack(
        int(rng.integers(5, 21)),
        rng,
        mass_ratio=10.0 ** rng.uniform(0.0, 6.0),
        friction=rng.uniform(0.2, 1.0),
        way=PUSHES[seed % len(PUSHES)],
        push=rng.uniform(0.0, 1.5),
    )


def plane_stack(n, rng, *, mass_ratio=1.0, friction=0.5, push=0.3):
    """The same in the plane: two contacts per face, two components per contact."""
    masses = mass_ratio ** rng.uniform(0.0, 1.0, n)
    H = np.zeros((3 * n, 4 * n))
    for i in range(n):
        for k, x in enumerate((-0.5, 0.5)):
            column = 4 * i + 2 * k
            for body, sign, y in ((i, 1.0, -0.5), (i - 1, -1.0, 0.5)):
                if body >= 0:
                    H[3 * body : 3 * body + 3, column] = sign * np.array([0.0, 1.0, x])
                    H[3 * body : 3 * body + 3, column + 1] = sign * np.array([1.0, 0.0, -y])
    diagonal = np.column_stack([masses, masses, masses / 6.0]).ravel()
    forces = np.zeros((n, 3))
    forces[:, 1] = -GRAVITY * masses
    forces[:, 0] = push * rng.uniform(-1.0, 1.0, n) * GRAVITY * masses
    M = csr_array(diags_array(diagonal))
    return Bodies(M, csr_array(H), STEP * forces.ravel(), np.full(2 * n, friction))


def sphere_pile(n, rng, *, friction=0.5):
    """Spheres of one size in touch in a random packing above the ground; moderately redundant."""
    layers = int(np.ceil(n ** (1.0 / 3.0)))
    centres = []
    for k in range(4 * layers):
        offset = 0.5 * (k % 2)
        for i in range(layers):
            for j in range(layers):
                centres.append([i + offset, j + offset, 0.5 + k * np.sqrt(0.5)])
    centres = np.array(centres[:n])
    contacts = [([x, y, 0.0], [0, 0, 1.0], i, -1) for i, (x, y, z) in enumerate(centres) if z < 0.6]
    for i in range(n):
        for j in range(i):
            apart = centres[i] - centres[j]
            if np.linalg.norm(apart) < 1.01:
                contacts.append((0.5 * (centres[i] + centres[j]), apart, i, j))
    masses = rng.uniform(0.5, 2.0, n)
    forces = np.zeros((n, 6))
    forces[:, :3] = 0.5 * GRAVITY * masses[:, None] * rng.normal(size=(n, 3))
    forces[:, 2] -= GRAVITY * masses
    inertias = np.repeat(0.1 * masses[:, None], 3, axis=1)
    return rigid_bodies(masses, inertias, centres, contacts, forces, friction)


def wedged_block(friction):
    """A block between two slanted walls, pressed down: it jams where friction is high."""
    contacts = []
    for side in (-1.0, 1.0):
        for z in (-0.4, 0.4):
            for y in (-0.5, 0.5):
                contacts.append(([side * (0.5 + 0.1 * z), y, z], [-side, 0.0, 0.1], 0, -1))
    forces = np.zeros((1, 6))
    forces[0, :3] = 3.0, 0.5, -GRAVITY
    return rigid_bodies(
        [1.0], np.full((1, 3), 1.0 / 6.0), np.zeros((1, 3)), contacts, forces, friction
    )


def random_problem(contacts, rng, *, rank=None, friction=0.5, dim=3):
    """W = G G^T of the given rank with a q that impulses can balance."""
    n = dim * contacts
    G = rng.normal(size=(n, rank or n))
    q = G @ rng.normal(size=G.shape[1]) - 0.5 * np.tile(np.eye(dim)[0], contacts)
    if rank is not None:
        q = G @ rng.normal(size=rank)  # within the range of W, so that an answer exists
    return csr_array(G @ G.T), q, np.full(contacts, friction)


def block_tower(levels, rng, *, friction=0.3):
    """Three planks a level, crosswise, like a tower of wooden blocks: many redundant contacts."""
    size = np.array([0.9, 0.3, 0.2])
    centres, along = [], []
    for level in range(levels):
        for k in range(3):
            across = (k - 1) * 0.3
            xy = (0.0, across) if level % 2 == 0 else (across, 0.0)
            centres.append([*xy, (level + 0.5) * size[2]])
            along.append(level % 2)
    centres = np.array(centres)
    n = len(centres)
    contacts = []
    for i in range(n):
        level, z = i // 3, (i // 3) * size[2]
        supports = [-1] if level == 0 else range(3 * level - 3, 3 * level)
        for below in supports:
            first, last = footprint(centres[i], along[i], size)
            if below >= 0:
                low, high = footprint(centres[below], along[below], size)
                first, last = np.maximum(first, low), np.minimum(last, high)
            for x in (first[0], last[0]):
                for y in (first[1], last[1]):
                    contacts.append(([x, y, z], [0.0, 0.0, 1.0], i, below))
    masses = rng.uniform(0.9, 1.1, n)
    length = np.where(np.array(along)[:, None] == 0, size[[0, 1, 2]], size[[1, 0, 2]])
    inertias = masses[:, None] / 12.0 * ((length**2).sum(axis=1)[:, None] - length**2)
    forces = np.zeros((n, 6))
    forces[:, :3] = 0.1 * GRAVITY * rng.normal(size=(n, 3)) * masses[:, None]
    forces[:, 2] -= GRAVITY * masses
    return rigid_bodies(masses, inertias, centres, contacts, forces, friction)


def footprint(centre, along, size):
    """Lower and upper corner of a plank in the plane."""
    half = 0.5 * (size[:2] if along == 0 else size[[1, 0]])
    return centre[:2] - half, centre[:2] + half
