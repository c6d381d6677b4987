"""Friction problems of bodies in contact, and of random matrices."""

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.bench.rigid_bodies import STEP, RigidBodies, Touch, rigid_bodies

__all__ = [
    "block_tower",
    "box_stack",
    "plane_stack",
    "random_problem",
    "random_stack",
    "sphere_pile",
    "wedged_block",
]

GRAVITY = 9.81  # m/s²
UP = (0.0, 0.0, 1.0)

PUSHES = ("each", "top", "sideways", "one", "squeeze")
"""Ways to push a stack; see :func:`box_stack`."""


def box_stack(
    boxes: int,
    rng: np.random.Generator,
    *,
    mass_ratio: float = 1.0,
    friction: float = 0.5,
    way: str = "each",
    push: float = 0.3,
) -> RigidBodies:
    """Make a stack of boxes with four corner contacts each, pushed sideways; hyperstatic.

    Parameters
    ----------
    boxes : int
        On top of each other.
    rng : Generator
        Of sizes, shifts, masses and pushes.
    mass_ratio : float
        Of the heaviest box to the lightest; between them the logarithm is uniform.
    friction : float
        Friction coefficient, 1.
    way : str
        One of ``PUSHES``: each box by its own weight, the top box alone, all in one direction, one
        box by the weight of the stack, or some by all the weight that rests on them, which
        squeezes light boxes out like pips. Some stacks stick, some slide, some tip over.
    push : float
        Size of the lateral forces relative to these weights, 1.
    """
    masses = mass_ratio ** rng.uniform(0.0, 1.0, boxes)
    sides = rng.uniform(0.6, 1.4, (boxes, 3))
    base = np.concatenate([[0.0], np.cumsum(sides[:-1, 2])])
    shift = np.cumsum(rng.uniform(-0.05, 0.05, (boxes, 2)), axis=0)
    centres = np.column_stack([shift, base + 0.5 * sides[:, 2]])
    contacts: list[Touch] = []
    for i in range(boxes):
        half = 0.5 * (sides[i] if i == 0 else np.minimum(sides[i], sides[i - 1]))
        for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            point = [shift[i, 0] + x * half[0], shift[i, 1] + y * half[1], base[i]]
            contacts.append((point, UP, i, i - 1))
    forces = _weights(masses)
    forces[:, :2] = _lateral_forces(masses, way, push, rng)
    return rigid_bodies(masses, _cuboid(masses, sides), centres, contacts, forces, friction)


def _weights(masses: np.ndarray) -> np.ndarray:
    """Gravity as forces and moments, N and N m, shape (bodies, 6)."""
    forces = np.zeros((masses.size, 6))
    forces[:, 2] = -GRAVITY * masses
    return forces


def _cuboid(masses: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Moments of inertia of cuboids, kg m², shape (bodies, 3)."""
    squares = sides**2
    return np.asarray(masses[:, None] / 12.0 * (squares.sum(axis=1)[:, None] - squares))


def _lateral_forces(
    masses: np.ndarray, way: str, push: float, rng: np.random.Generator
) -> np.ndarray:
    """Lateral forces of a stack, N, shape (boxes, 2)."""
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


def random_stack(seed: int) -> RigidBodies:
    """Make a stack of 5 to 20 boxes, mass ratio 1 to 1e6, pushed in any of the five ways."""
    rng = np.random.default_rng(seed=seed)
    return box_stack(
        int(rng.integers(5, 21)),
        rng,
        mass_ratio=10.0 ** rng.uniform(0.0, 6.0),
        friction=rng.uniform(0.2, 1.0),
        way=PUSHES[seed % len(PUSHES)],
        push=rng.uniform(0.0, 1.5),
    )


def plane_stack(
    boxes: int,
    rng: np.random.Generator,
    *,
    mass_ratio: float = 1.0,
    friction: float = 0.5,
    push: float = 0.3,
) -> RigidBodies:
    """Make a stack in the plane: two contacts a face, two components a contact.

    The parameters are those of :func:`box_stack`.
    """
    n = boxes
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
    return RigidBodies(M, csr_array(H), STEP * forces.ravel(), np.full(2 * n, friction))


def sphere_pile(spheres: int, rng: np.random.Generator, *, friction: float = 0.5) -> RigidBodies:
    """Make a regular packing of equal spheres above the ground, pushed in all directions.

    The parameters are those of :func:`box_stack`. The contacts are moderately redundant.
    """
    layers = int(np.ceil(spheres ** (1.0 / 3.0)))
    lattice = [
        [i + 0.5 * (k % 2), j + 0.5 * (k % 2), 0.5 + k * np.sqrt(0.5)]
        for k in range(4 * layers)
        for i in range(layers)
        for j in range(layers)
    ]
    centres = np.array(lattice[:spheres])
    contacts: list[Touch] = [
        ([x, y, 0.0], UP, i, -1) for i, (x, y, z) in enumerate(centres) if z < 0.6
    ]
    for i in range(spheres):
        for j in range(i):
            apart = centres[i] - centres[j]
            if np.linalg.norm(apart) < 1.01:
                contacts.append((0.5 * (centres[i] + centres[j]), apart, i, j))
    masses = rng.uniform(0.5, 2.0, spheres)
    forces = _weights(masses)
    forces[:, :3] += 0.5 * GRAVITY * masses[:, None] * rng.normal(size=(spheres, 3))
    inertias = np.repeat(0.1 * masses[:, None], 3, axis=1)
    return rigid_bodies(masses, inertias, centres, contacts, forces, friction)


def wedged_block(friction: float) -> RigidBodies:
    """Make a block between two slanted walls, pressed down: it jams where friction is high."""
    contacts: list[Touch] = [
        ([side * (0.5 + 0.1 * z), y, z], [-side, 0.0, 0.1], 0, -1)
        for side in (-1.0, 1.0)
        for z in (-0.4, 0.4)
        for y in (-0.5, 0.5)
    ]
    forces = np.array([[3.0, 0.5, -GRAVITY, 0.0, 0.0, 0.0]])
    inertias = np.full((1, 3), 1.0 / 6.0)
    return rigid_bodies(np.ones(1), inertias, np.zeros((1, 3)), contacts, forces, friction)


def random_problem(
    contacts: int,
    rng: np.random.Generator,
    *,
    rank: int | None = None,
    friction: float = 0.5,
    dim: int = 3,
) -> tuple[csr_array, np.ndarray, np.ndarray]:
    """Make a random W = G G^T with a q that impulses can balance.

    Parameters
    ----------
    contacts : int
        Number of contacts.
    rng : Generator
        Of the entries.
    rank : int, optional
        Of W; full if not given.
    friction : float
        Friction coefficient, 1.
    dim : {2, 3}
        Components of a contact.

    Returns
    -------
    delassus, velocity, friction
        As :func:`multiscale.nonsmooth.solve_friction` takes them.
    """
    n = dim * contacts
    G = rng.normal(size=(n, rank or n))
    q = G @ rng.normal(size=G.shape[1]) - 0.5 * np.tile(np.eye(dim)[0], contacts)
    if rank is not None:
        q = G @ rng.normal(size=rank)  # within the range of W, so that an answer exists
    return csr_array(G @ G.T), q, np.full(contacts, friction)


PLANK = np.array([0.9, 0.3, 0.2])  # m


def block_tower(levels: int, rng: np.random.Generator, *, friction: float = 0.3) -> RigidBodies:
    """Make a tower of three planks a level, crosswise: many redundant contacts.

    The parameters are those of :func:`box_stack`.
    """
    n = 3 * levels
    level = np.arange(n) // 3
    turned = level % 2 == 1
    across = (np.arange(n) % 3 - 1) * PLANK[1]
    centres = np.column_stack(
        [np.where(turned, across, 0.0), np.where(turned, 0.0, across), (level + 0.5) * PLANK[2]]
    )
    sides = np.where(turned[:, None], PLANK[[1, 0, 2]], PLANK)
    low, high = centres - 0.5 * sides, centres + 0.5 * sides
    contacts: list[Touch] = []
    for i in range(n):
        for below in [-1] if i < 3 else range(3 * level[i] - 3, 3 * level[i]):
            first, last = low[i], high[i]
            if below >= 0:
                first, last = np.maximum(first, low[below]), np.minimum(last, high[below])
            for x in (first[0], last[0]):
                for y in (first[1], last[1]):
                    contacts.append(([x, y, low[i, 2]], UP, i, below))
    masses = rng.uniform(0.9, 1.1, n)
    forces = _weights(masses)
    forces[:, :3] += 0.1 * GRAVITY * rng.normal(size=(n, 3)) * masses[:, None]
    return rigid_bodies(masses, _cuboid(masses, sides), centres, contacts, forces, friction)
