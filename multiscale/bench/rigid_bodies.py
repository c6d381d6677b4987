"""Rigid bodies in contact for one time step, as matrices."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array

__all__ = ["STEP", "RigidBodies", "Touch", "rigid_bodies"]

STEP = 1e-2
"""Time step, s."""

Touch = tuple[ArrayLike, ArrayLike, int, int]
"""A contact: point, m, normal, body above, body below or -1 for the ground."""


@dataclass(frozen=True)
class RigidBodies:
    r"""Rigid bodies with contacts, :math:`M v = f + H r` and :math:`u = H^T v`.

    Attributes
    ----------
    mass : csr_array, :math:`M`, diagonal, kg and kg m²
    transfer : csr_array, :math:`H` from impulses to bodies, 1 and m; normal first at every contact
    momentum : ndarray, :math:`f`, without contact impulses, N s and N m s
    friction : ndarray, shape (contacts,), friction coefficient, 1
    """

    mass: csr_array
    transfer: csr_array
    momentum: np.ndarray
    friction: np.ndarray

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
    """Assemble bodies in space that are at rest.

    Parameters
    ----------
    masses : ndarray, shape (bodies,), kg
    inertias, centres : ndarray, shape (bodies, 3)
        Principal moments about the axes of space, kg m², and centres of mass, m.
    contacts : sequence of Touch
    forces : ndarray, shape (bodies, 6), forces and moments, N and N m, for one :data:`STEP`
    friction : float or ndarray, shape (contacts,), friction coefficient, 1
    """
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
    return RigidBodies(M, H, STEP * forces.ravel(), mu)


def _frame(normal: ArrayLike) -> np.ndarray:
    """Rows: normal and two tangents."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    other = np.eye(3)[np.argmin(np.abs(n))]
    t = np.cross(n, other)
    t /= np.linalg.norm(t)
    return np.array([n, t, np.cross(n, t)])
