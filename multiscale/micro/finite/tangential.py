"""Stick and slip at the nodes of one iterate."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

__all__ = ["Tangential", "evaluate_friction"]

LARGEST_SHARE = 0.9999  # bound on share, for a finite resistance across the slip


@dataclass(frozen=True, eq=False)
class Tangential:
    """Tangential part of the contact equations.

    Attributes
    ----------
    slip : ndarray, shape (nx, 3, ny), tangential motion past the obstacle in the increment, m
    direction : ndarray, shape (2, nx, 3, ny)
        Unit tangents along and across the trial friction force.
    bound : ndarray, shape (nx, ny), largest friction force, N
    slipping : ndarray of bool, shape (nx, ny), whether a node slips
    share : ndarray, shape (nx, ny)
        Bound over trial friction force where a node slips, 0 elsewhere; dimensionless.
    """

    slip: np.ndarray
    direction: np.ndarray
    bound: np.ndarray
    slipping: np.ndarray
    share: np.ndarray

    @cached_property
    def stretch(self) -> np.ndarray:
        """Resistance of a slipping node across its slip, relative to the weight, dimensionless."""
        share = np.minimum(self.share, LARGEST_SHARE)
        return np.asarray(share / (1.0 - share))

    def along(self, vector: np.ndarray) -> np.ndarray:
        """Components of a vector along and across the trial force, shape (2, nx, ny)."""
        return np.asarray(np.sum(self.direction * vector, axis=2))


def evaluate_friction(
    tangential: np.ndarray,
    slip: np.ndarray,
    normal: np.ndarray,
    active: np.ndarray,
    bound: np.ndarray,
    weight: float,
) -> Tangential:
    r"""Find the nodes that slip, and the directions of their slip."""
    pulled = tangential - weight * slip
    size = np.linalg.norm(pulled, axis=1)
    slipping = active & (size > bound)
    share = np.where(slipping, bound / np.where(size > 0.0, size, 1.0), 0.0)
    sideways = np.zeros_like(pulled)  # an arbitrary tangent where the trial force vanishes
    sideways[:, 0], sideways[:, 2] = normal[:, 2], -normal[:, 0]
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    pulls = (size > 1e-12 * float(size.max()))[:, None]
    along = np.where(pulls, pulled / np.maximum(size, 1e-300)[:, None], sideways)
    direction = np.stack([along, np.cross(normal, along, axis=1)])
    return Tangential(slip, direction, bound, slipping, share)
