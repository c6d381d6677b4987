"""Rigid motions of bodies, and those that neither supports nor stiffness resist."""

import numpy as np
from numpy.linalg import eigh, matrix_rank
from scipy.sparse import csr_array

FREE = 1e-9  # largest energy of a free motion, relative to its energy on the diagonal stiffness


def rigid_motions(position: np.ndarray, component: np.ndarray) -> np.ndarray:
    """Displacement of unknowns in three translations and three rotations about their middle."""
    motions = np.zeros((component.size, 6))
    axes, moves = np.eye(3), component < 3
    x = position - position.mean(axis=0)
    motions[:, :3] = axes[component % 3] * moves[:, None]
    for axis in range(3):
        turning = np.cross(axes[axis], x)[np.arange(component.size), component % 3]
        motions[:, 3 + axis] = np.where(moves, turning, 0.0)
    return motions


def free_motions(stiffness: csr_array, motions: np.ndarray) -> np.ndarray:
    """Return the combinations of motions, shape (n, motions), that a stiffness does not resist."""
    size = np.sqrt(stiffness.diagonal() @ motions**2)
    energy = motions.T @ (stiffness @ motions) / np.outer(size, size)
    value, vector = eigh(0.5 * (energy + energy.T))
    return np.asarray(motions @ (vector[:, np.abs(value) < FREE] / size[:, None]))


def count_free_motions(position: np.ndarray, fixed: np.ndarray) -> int:
    """Return the number of rigid motions of nodes that their supports leave free.

    The components of ``fixed``, shape (nodes, c), are displacements and, if c = 6, rotations.
    """
    n, components = fixed.shape
    size = float(np.abs(position - position.mean(axis=0)).max()) or 1.0
    places = np.repeat(position / size, components, axis=0)
    motion = rigid_motions(places, np.tile(np.arange(components), n)).reshape(n, components, 6)
    motion[:, range(3, components), range(3, components)] = 1.0  # rotations of nodes

    def rank(rows: np.ndarray) -> int:
        tol = 1e-10 * len(rows)
        return int(matrix_rank(rows.T @ rows, tol=tol, hermitian=True)) if len(rows) else 0

    return rank(motion.reshape(-1, 6)) - rank(motion[fixed])
