r"""The flat elastic cell as a preconditioner under constraints on the surface.

On the surface, some motions are prescribed and others are supported by springs. With rows :math:`E`
of unit directions, compliances :math:`\epsilon` of the springs and the flat cell :math:`K_0`,

.. math::
    K_0 z + E^t l = r, \qquad E z + e_z \zeta - \epsilon\, l = d, \qquad
    -e_z^t l = \rho, \tag{1}

where :math:`\zeta` is a change of the approach, unknown if the load is prescribed (last equation)
and 0 otherwise. Conjugate gradients solve the remaining problem on the surface alone.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.micro.finite.pair_reference import JoinedReference
from multiscale.micro.flat_reference import Field, Reference
from multiscale.numerics.krylov import conjugate_gradients

__all__ = ["Constraint", "Support"]

_INNER = 1e-3  # relative tolerance on the surface; the flexible Krylov method allows for it
_LIMIT = 200  # iterations on the surface


Support = Reference | JoinedReference


@dataclass(frozen=True, eq=False)
class Constraint:
    """Rows of (1), one for each direction of each surface node.

    Attributes
    ----------
    reference : Support, the flat cell, or two joined flat cells
    direction : ndarray, shape (rows, nx, 3, ny), unit directions
    held : ndarray of bool, shape (rows, nx, ny), whether a motion is prescribed
    spring : ndarray, shape (rows, nx, ny)
        Stiffness of the spring that supports a motion, N/m; 0 without a spring.
    carries_load : bool, whether the approach is unknown
    """

    reference: Support
    direction: np.ndarray
    held: np.ndarray
    spring: np.ndarray
    carries_load: bool

    @cached_property
    def touched(self) -> np.ndarray:
        """Rows that take part in the surface problem."""
        return np.asarray(self.held | (self.spring > 0.0))

    @cached_property
    def _give(self) -> np.ndarray:
        return np.where(self.spring > 0.0, 1.0 / np.where(self.spring > 0.0, self.spring, 1.0), 0.0)

    @property
    def closing(self) -> np.ndarray:
        """Share of the approach in each row."""
        return np.asarray(self.direction[:, :, 2] * self.touched)

    @cached_property
    def _vertical(self) -> bool:
        one = len(self.direction) == 1 and self.reference.convolves
        return one and bool(np.all(self.direction[0, :, 2] == 1.0))

    def along(self, moved: Field) -> Field:
        """Project a motion, m, on the rows, shape (rows, nx, ny)."""
        return np.asarray(np.sum(self.direction * moved, axis=2) * self.touched)

    def push(self, force: Field) -> Field:
        """Sum the forces along the rows, N, to vectors, shape (nx, 3, ny)."""
        return np.asarray(np.sum(self.direction * (force * self.touched)[:, :, None], axis=0))

    def _respond(self, force: Field) -> Field:
        if self._vertical:
            found = self.reference.vertical[0](force[0])
            return np.where(self.held, found, 0.0)
        moved = self.along(self.reference.compliance(self.push(force)))
        return np.asarray(moved + self._give * force)

    def _resist(self, moved: Field) -> Field:
        if self._vertical:
            found = self.reference.vertical[1](moved[0])
            return np.where(self.held, found, 0.0)
        return self.along(self.reference.stiffness(self.push(moved)))

    def surface_solve(self, right_hand_side: Field) -> Field:
        """Find the forces along the rows, N, for given motions, m, by conjugate gradients.

        Both have the shape (rows, nx, ny).
        """
        r = right_hand_side * self.touched
        goal = _INNER * float(np.linalg.norm(r))
        return conjugate_gradients(self._respond, r, self._resist, goal=goal, limit=_LIMIT)[0]

    @cached_property
    def _unit(self) -> Field:
        """Forces under a unit approach, N/m."""
        return self.surface_solve(self.closing)

    def solve(
        self, residual: Field, missing: float, distance: np.ndarray | None = None
    ) -> tuple[Field, float]:
        r"""Solve (1)."""
        shift = 0.0

        def correct(moved: Field) -> Field:
            nonlocal shift
            wanted = self.along(moved)
            if distance is not None:
                wanted = wanted - distance
            force = self.surface_solve(wanted)
            if self.carries_load:
                balance = float(np.vdot(self.closing, force))
                shift = -(missing + balance) / float(np.vdot(self.closing, self._unit))
                force = force + shift * self._unit
            return -self.push(force)

        z = self.reference.solve(residual, correct)
        target = -self.closing * shift if distance is None else distance - self.closing * shift
        moved = self.reference.relative(z)
        off = np.where(self.held, target - np.sum(self.direction * moved, axis=2), 0.0)
        # prescribed motions are exact despite rounding and the inner tolerance
        self.reference.surface(z)[:] += self.push(off)
        return z, shift
