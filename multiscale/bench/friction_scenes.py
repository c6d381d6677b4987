"""Friction problems of bodies in contact."""

from collections.abc import Callable

import numpy as np

from multiscale.bench.rigid_bodies import RigidBodies, Touch, rigid_bodies

__all__ = ["GRAVITY", "block_tower", "box_stack", "sphere_pile", "wedged_block"]

GRAVITY = 9.81  # m/s²
UP = (0.0, 0.0, 1.0)


def _push_each(masses: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Push each body in some direction by up to .3 of its weight; N, shape (bodies, 2)."""
    angle = rng.uniform(0.0, 2.0 * np.pi, masses.size)
    size = 0.3 * rng.uniform(0.0, 1.0, masses.size) * (GRAVITY * masses)
    return np.column_stack([size * np.cos(angle), size * np.sin(angle)])


def box_stack(
    boxes: int,
    rng: np.random.Generator,
    *,
    mass_ratio: float = 1.0,
    friction: float = 0.5,
    push: Callable[[np.ndarray, np.random.Generator], np.ndarray] = _push_each,
) -> RigidBodies:
    """Make a stack of boxes with four corner contacts each, pushed sideways; hyperstatic.

    Parameters
    ----------
    boxes : int
    rng : Generator, source of sizes, shifts, masses and pushes
    mass_ratio : float, mass of the heaviest box over the lightest one, the logarithm uniform
    friction : float, friction coefficient, 1
    push : callable
        Lateral forces, N, shape (boxes, 2), of masses, kg. Some stacks stick, some slide, some tip
        over.
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
    forces[:, :2] = push(masses, rng)
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


def sphere_pile(spheres: int, rng: np.random.Generator) -> RigidBodies:
    """Make a regular packing of equal spheres above the ground, pushed in all directions."""
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
    return rigid_bodies(masses, inertias, centres, contacts, forces, 0.5)


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


PLANK = np.array([0.9, 0.3, 0.2])  # m


def block_tower(levels: int, rng: np.random.Generator) -> RigidBodies:
    """Make a tower of three planks a level, crosswise: many redundant contacts."""
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
    return rigid_bodies(masses, _cuboid(masses, sides), centres, contacts, forces, 0.3)
