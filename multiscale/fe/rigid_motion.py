"""Rigid motions of bodies, for coarse spaces and for forces that must balance."""

import numpy as np

__all__ = ["rigid_motions"]


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
