"""Complementarity problems of contact, and friction problems of rigid bodies, as matrices."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

GRAVITY = 9.81  # m/s²
UP = (0.0, 0.0, 1.0)
TIME_STEP = 1e-2  # time step, s

Touch = tuple[ArrayLike, ArrayLike, int, int]
"""A contact: point, m, normal, body above, body below or -1 for the ground."""


@dataclass(frozen=True)
class RigidBodies:
    r"""Rigid bodies with contacts, :math:`M v = f + H r` and :math:`u = H^T v`."""

    mass: csr_array  # M, diagonal, kg and kg m²
    transfer: csr_array  # H, from impulses to bodies, 1 and m; normal first at every contact
    momentum: np.ndarray  # f, without contact impulses, N s and N m s
    friction: np.ndarray  # (contacts,), friction coefficient, 1

    def condensed(self) -> tuple[csr_array, np.ndarray, np.ndarray]:
        """Return W = H^T M^-1 H, 1/kg, q = H^T M^-1 f, m/s, and the friction coefficients."""
        inverse = diags_array(1.0 / self.mass.diagonal())
        W = csr_array(self.transfer.T @ inverse @ self.transfer)
        return W, self.transfer.T @ (self.momentum / self.mass.diagonal()), self.friction


def rigid_bodies(
    masses: np.ndarray,
    inertias: np.ndarray,
    centres: np.ndarray,
    contacts: Sequence[Touch],
    forces: np.ndarray,
    friction: float | np.ndarray,
) -> RigidBodies:
    """Assemble bodies in space that are at rest."""
    n = len(masses)
    rows, columns, values = list[int](), list[int](), list[float]()
    for c, (point, normal, above, below) in enumerate(contacts):
        frame = _frame(normal)
        for body, sign in ((above, 1.0), (below, -1.0)):
            if body < 0:
                continue
            arm = np.asarray(point) - centres[body]
            for a in range(3):
                rows.extend(range(6 * body, 6 * body + 6))
                columns.extend([3 * c + a] * 6)
                values.extend(sign * np.concatenate([frame[a], np.cross(arm, frame[a])]))
    H = csr_array((values, (rows, columns)), shape=(6 * n, 3 * len(contacts)))
    diagonal = np.column_stack([np.repeat(masses[:, None], 3, axis=1), inertias])
    M = csr_array(diags_array(diagonal.ravel()))
    mu = np.broadcast_to(np.asarray(friction, dtype=float), (len(contacts),)).copy()
    return RigidBodies(M, H, TIME_STEP * forces.ravel(), mu)


def _frame(normal: ArrayLike) -> np.ndarray:
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    other = np.eye(3)[np.argmin(np.abs(n))]
    t = np.cross(n, other)
    t /= np.linalg.norm(t)
    return np.array([n, t, np.cross(n, t)])


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
    """Build a stack of boxes with four corner contacts each, pushed sideways; hyperstatic."""
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
    """Return gravity as forces and moments, N and N m, shape (bodies, 6)."""
    forces = np.zeros((masses.size, 6))
    forces[:, 2] = -GRAVITY * masses
    return forces


def _cuboid(masses: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return the moments of inertia of cuboids, kg m², shape (bodies, 3)."""
    squares = sides**2
    return np.asarray(masses[:, None] / 12.0 * (squares.sum(axis=1)[:, None] - squares))


def sphere_pile(
    spheres: int,
    rng: np.random.Generator,
    *,
    mass_ratio: float = 1.0,
    friction: float = 0.5,
) -> RigidBodies:
    """Build a regular packing of equal spheres above the ground, pushed in all directions."""
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
    pushes = rng.normal(size=(spheres, 3))
    masses *= mass_ratio ** rng.uniform(-0.5, 0.5, spheres)
    forces = _weights(masses)
    forces[:, :3] += 0.5 * GRAVITY * masses[:, None] * pushes
    inertias = np.repeat(0.1 * masses[:, None], 3, axis=1)
    return rigid_bodies(masses, inertias, centres, contacts, forces, friction)


def wedged_block(friction: float, slope: float = 0.1) -> RigidBodies:
    """Build a block between two slanted walls, pressed down: it jams where friction is high."""
    contacts: list[Touch] = [
        ([side * (0.5 + slope * z), y, z], [-side, 0.0, slope], 0, -1)
        for side in (-1.0, 1.0)
        for z in (-0.4, 0.4)
        for y in (-0.5, 0.5)
    ]
    forces = np.array([[3.0, 0.5, -GRAVITY, 0.0, 0.0, 0.0]])
    inertias = np.full((1, 3), 1.0 / 6.0)
    return rigid_bodies(np.ones(1), inertias, np.zeros((1, 3)), contacts, forces, friction)


PLANK = np.array([0.9, 0.3, 0.2])  # m


def block_tower(levels: int, rng: np.random.Generator) -> RigidBodies:
    """Build a tower of three planks a level, crosswise: many redundant contacts."""
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


def granular(
    grains: int, *, mass_ratio: float = 1.0, contacts_per_grain: float = 3.3, seed: int = 0
) -> tuple[csr_array, csr_array, np.ndarray]:
    """Build frictionless contacts between near neighbours in space that approach each other."""
    rng = np.random.default_rng(seed)
    position = rng.random((grains, 3)) * grains ** (1 / 3)
    near = cKDTree(position).query(position, k=8)[1][:, 1:]
    pairs = np.column_stack([np.repeat(np.arange(grains), 7), near.ravel()])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    pairs = rng.permutation(pairs)[: int(contacts_per_grain * grains)]

    normal = position[pairs[:, 1]] - position[pairs[:, 0]]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    directions = _lengthening(pairs, normal, grains)
    mass = np.repeat(mass_ratio ** rng.random(grains), 3)
    velocity = 0.1 * rng.standard_normal(3 * grains)
    velocity -= 0.2 * (position - position.mean(axis=0)).ravel()
    return diags_array(mass, format="csr"), directions, directions.T @ velocity


def _lengthening(ends: np.ndarray, direction: np.ndarray, nodes: int) -> csr_array:
    """Assemble minus the direction of each link at its first end, plus at its second."""
    links, dim = direction.shape
    link = np.repeat(np.arange(links), dim)
    rows = [(dim * ends[:, [side]] + np.arange(dim)).ravel() for side in (0, 1)]
    return csr_array(
        (
            np.concatenate([-direction.ravel(), direction.ravel()]),
            (np.concatenate(rows), np.tile(link, 2)),
        ),
        shape=(dim * nodes, links),
    )


def loaded_column(
    bodies: int, *, mass_ratio: float = 1.0
) -> tuple[csr_array, csr_array, np.ndarray]:
    """Build a column of light bodies under a body of ``mass_ratio``, pulled down for one step."""
    mass = np.ones(bodies)
    mass[-1] = mass_ratio
    directions = csr_array(
        diags_array([np.ones(bodies), -np.ones(bodies - 1)], offsets=[0, 1], shape=(bodies, bodies))
    )
    velocity = np.full(bodies, -9.81e-3)
    return diags_array(mass, format="csr"), directions, directions.T @ velocity


def condensed(mass: csr_array, directions: csr_array) -> csr_array:
    """Return the matrix H^T M^-1 H for a diagonal mass, 1/kg."""
    return csr_array(directions.T @ diags_array(1.0 / mass.diagonal()) @ directions)


def membrane(nodes: int, *, contrast: float = 1.0) -> tuple[csr_array, np.ndarray]:
    """Build a membrane of two stiffnesses on a wavy obstacle, under an even load."""
    n, rng = nodes, np.random.default_rng(seed=0)
    stiffness = np.where(rng.random((n + 1, n + 1)) < 0.5, 1.0, contrast)
    node = np.arange(n * n).reshape(n, n)
    across, along = stiffness[: n - 1, :n].ravel(), stiffness[:n, : n - 1].ravel()
    first = np.concatenate([node[:-1].ravel(), node[:, :-1].ravel()])
    second = np.concatenate([node[1:].ravel(), node[:, 1:].ravel()])
    weight = np.concatenate([across, along])
    bars = np.arange(first.size)
    jump = csr_array(
        (np.repeat([1.0, -1.0], first.size), (np.tile(bars, 2), np.concatenate([first, second]))),
        shape=(first.size, n * n),
    )
    edge = np.zeros((n, n))
    edge[[0, -1]] += 1.0
    edge[:, [0, -1]] += 1.0
    matrix = csr_array(jump.T @ diags_array(weight) @ jump + diags_array(edge.ravel()))
    x = np.arange(1, n + 1) / (n + 1)
    obstacle = -0.02 - 0.03 * np.outer(np.sin(4 * np.pi * x), np.sin(6 * np.pi * x)).ravel()
    return matrix, matrix @ obstacle + 3.0 / (n + 1) ** 2


def tensegrity(nodes: int, *, contrast: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Build the slacks of cables in a lattice with bars, A = k - k B K^-1 B^T k, k = 1 N/m."""
    n, rng = nodes, np.random.default_rng(seed=0)
    node = np.arange(n * n).reshape(n, n)
    position = np.column_stack(np.divmod(np.arange(n * n), n)) + 0.1 * rng.random((n * n, 2))
    neighbours = [
        (node[:-1], node[1:]),
        (node[:, :-1], node[:, 1:]),
        (node[:-1, :-1], node[1:, 1:]),
        (node[1:, :-1], node[:-1, 1:]),
    ]
    ends = np.concatenate([np.column_stack([a.ravel(), b.ravel()]) for a, b in neighbours])
    direction = position[ends[:, 1]] - position[ends[:, 0]]
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    # two opposite edges are fixed
    lengthening = csr_array(_lengthening(ends, direction, n * n).T)[:, 2 * n : -2 * n]
    cable = rng.random(len(ends)) < 0.75
    stiffness = np.where(cable, 1.0, contrast)
    whole = csr_array(lengthening.T @ diags_array(stiffness) @ lengthening)
    solve = splu(whole.tocsc()).solve
    cables = lengthening[np.flatnonzero(cable)]
    matrix = np.eye(cables.shape[0]) - cables @ solve(cables.T.toarray())
    load = 0.3 * rng.standard_normal(whole.shape[0])
    return matrix, cables @ solve(load) + 0.2


def p_matrix(size: int, *, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Build a nonsymmetric P-matrix, positive definite plus skew-symmetric, and a vector."""
    rng = np.random.default_rng(seed)
    root, skew = rng.standard_normal((2, size, size))
    matrix = root @ root.T / size + skew - skew.T + 0.1 * np.eye(size)
    return matrix, rng.standard_normal(size)
