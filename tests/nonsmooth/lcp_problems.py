"""Linear complementarity problems of contact, of any size and contrast."""

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree


def granular(grains, *, mass_ratio=1.0, contacts_per_grain=3.3, seed=0):
    """Delassus operator of frictionless contacts between near neighbours in space."""
    rng = np.random.default_rng(seed)
    position = rng.random((grains, 3)) * grains ** (1 / 3)
    near = cKDTree(position).query(position, k=8)[1][:, 1:]
    pairs = np.column_stack([np.repeat(np.arange(grains), 7), near.ravel()])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    pairs = rng.permutation(pairs)[: int(contacts_per_grain * grains)]

    normal = position[pairs[:, 1]] - position[pairs[:, 0]]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    contact = np.repeat(np.arange(len(pairs)), 3)
    rows = [(3 * pairs[:, [side]] + np.arange(3)).ravel() for side in (0, 1)]
    directions = csr_array(
        (
            np.concatenate([-normal.ravel(), normal.ravel()]),
            (np.concatenate(rows), np.concatenate([contact, contact])),
        ),
        shape=(3 * grains, len(pairs)),
    )
    mass = np.repeat(mass_ratio ** rng.random(grains), 3)
    velocity = 0.1 * rng.standard_normal(3 * grains)
    velocity -= 0.2 * (position - position.mean(axis=0)).ravel()
    return diags_array(mass, format="csr"), directions, directions.T @ velocity


def stack(bodies, *, mass_ratio=1.0):
    """A heavy body on top of a column of light ones, pulled down for one step."""
    mass = np.ones(bodies)
    mass[-1] = mass_ratio
    directions = csr_array(
        diags_array([np.ones(bodies), -np.ones(bodies - 1)], offsets=[0, 1], shape=(bodies, bodies))
    )
    velocity = np.full(bodies, -9.81e-3)
    return diags_array(mass, format="csr"), directions, directions.T @ velocity


def condensed(mass, directions):
    """The matrix H^T M^-1 H for a diagonal mass."""
    return csr_array(directions.T @ diags_array(1.0 / mass.diagonal()) @ directions)


def membrane(n, *, contrast=1.0, seed=0):
    """A membrane on a wavy obstacle, n x n nodes; its stiffness jumps at random between cells."""
    rng = np.random.default_rng(seed)
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


def tensegrity(n, *, contrast=1.0, seed=0):
    """Slacks of the cables in a braced lattice of n x n nodes, A = k - k B K^-1 B^T k."""
    rng = np.random.default_rng(seed)
    node = np.arange(n * n).reshape(n, n)
    position = np.column_stack(np.divmod(np.arange(n * n), n)) + 0.1 * rng.random((n * n, 2))
    ends = np.concatenate(
        [
            np.column_stack([a.ravel(), b.ravel()])
            for a, b in [
                (node[:-1], node[1:]),
                (node[:, :-1], node[:, 1:]),
                (node[:-1, :-1], node[1:, 1:]),
                (node[1:, :-1], node[:-1, 1:]),
            ]
        ]
    )
    direction = position[ends[:, 1]] - position[ends[:, 0]]
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    links = np.repeat(np.arange(len(ends)), 2)
    columns = [(2 * ends[:, [side]] + np.arange(2)).ravel() for side in (0, 1)]
    lengthening = csr_array(
        (
            np.concatenate([-direction.ravel(), direction.ravel()]),
            (np.tile(links, 2), np.concatenate(columns)),
        ),
        shape=(len(ends), 2 * n * n),
    )[:, 2 * n : -2 * n]
    cable = rng.random(len(ends)) < 0.75
    stiffness = np.where(cable, 1.0, contrast)
    whole = csr_array(lengthening.T @ diags_array(stiffness) @ lengthening)
    solve = splu(whole.tocsc()).solve
    cables = lengthening[np.flatnonzero(cable)]
    matrix = np.eye(cables.shape[0]) - cables @ solve(cables.T.toarray())
    load = 0.3 * rng.standard_normal(whole.shape[0])
    return matrix, cables @ solve(load) + 0.2


def p_matrix(n, *, seed=0):
    """A random nonsymmetric P-matrix: positive definite symmetric part, strong skew part."""
    rng = np.random.default_rng(seed)
    root, skew = rng.standard_normal((2, n, n))
    return root @ root.T / n + skew - skew.T + 0.1 * np.eye(n), rng.standard_normal(n)
