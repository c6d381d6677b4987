"""Friction problems that are random, in the plane or pushed in many ways."""

from functools import partial

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.bench.nonsmooth_scenes import GRAVITY, TIME_STEP, RigidBodies, box_stack

PUSHES = ("each", "top", "sideways", "one", "squeeze")
"""Ways to push a stack: each box by its weight, only the top box, all in one direction, one
box by the weight of the stack, or some by all the weight that rests on them, which squeezes light
boxes out like pips."""


def push_stack(way, push, masses, rng):
    """Lateral forces of a stack, N, shape (boxes, 2), of a size relative to these weights."""
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
    """Return a stack of 5 to 20 boxes, mass ratio 1 to 1e6, pushed in any of the five ways."""
    rng = np.random.default_rng(seed=seed)
    return box_stack(
        int(rng.integers(5, 21)),
        rng,
        mass_ratio=10.0 ** rng.uniform(0.0, 6.0),
        friction=rng.uniform(0.2, 1.0),
        push=partial(push_stack, PUSHES[seed % len(PUSHES)], rng.uniform(0.0, 1.5)),
    )


def plane_stack(boxes, rng, *, mass_ratio=1.0, friction=0.5, push=0.3):
    """Return a stack in the plane: two contacts a face, two components a contact."""
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
    return RigidBodies(M, csr_array(H), TIME_STEP * forces.ravel(), np.full(2 * n, friction))


def random_problem(contacts, rng, *, rank=None, friction=0.5, dim=3):
    """Return a random W = G G^T, of a rank if given, with a q that impulses can balance."""
    n = dim * contacts
    G = rng.normal(size=(n, rank or n))
    q = G @ rng.normal(size=G.shape[1]) - 0.5 * np.tile(np.eye(dim)[0], contacts)
    if rank is not None:
        q = G @ rng.normal(size=rank)  # within the range of W, so that an answer exists
    return csr_array(G @ G.T), q, np.full(contacts, friction)
