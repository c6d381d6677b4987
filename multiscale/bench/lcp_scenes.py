"""Linear complementarity problems of contact, of any size and contrast."""

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree


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
