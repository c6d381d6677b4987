r"""The flat elastic cell as a preconditioner under constraints on the surface.

On the surface, some motions are prescribed and some are held by springs. With rows :math:`E` of
unit directions, compliances :math:`\epsilon` of the springs and the flat cell :math:`K_0`,

.. math::
    K_0 z + E^t l = r, \qquad E z + e_z \zeta - \epsilon\, l = d, \qquad
    -e_z^t l = \rho, \tag{1}

where :math:`\zeta` is a change of the approach, unknown if the load is prescribed (last equation)
and 0 otherwise. What remains is solved on the surface alone, by conjugate gradients.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from multiscale.micro.flat_reference import Field
from multiscale.micro.lateral_fft import filter_surface

__all__ = ["Constraint", "Support"]

_INNER = 1e-4  # the Krylov method allows for it
_LIMIT = 200


class Support(Protocol):
    """What :class:`Constraint` needs of one flat cell, or of two that are joined."""

    @property
    def convolves(self) -> bool:
        """Whether the vertical compliance is a product for each wave."""

    @property
    def vertical(self) -> tuple[Field, Field]:
        """Symbols of the vertical compliance and of an approximate inverse."""

    def surface(self, vector: Field) -> Field:
        """Part of a field at the surface of the first body, as a view."""

    def relative(self, vector: Field) -> Field:
        """Motion of the surface against what is opposite."""

    def solve(self, force: Field, correct: Callable[[Field], Field]) -> Field:
        """Solve for nodal forces; ``correct`` adds surface forces for the surface's motion."""

    def compliance(self, force: Field) -> Field:
        """Motion of the surface under forces on it, shapes (nx, 3, ny)."""

    def stiffness(self, moved: Field) -> Field:
        """Find the forces on the surface that move it so, at least nearly."""


@dataclass(frozen=True, eq=False)
class Constraint:
    """Rows of (1), as many for each surface node as there are directions.

    Parameters
    ----------
    reference : Support
    direction : ndarray, shape (rows, nx, 3, ny)
        Unit directions.
    held : ndarray of bool, shape (rows, nx, ny)
        Which motions are prescribed.
    spring : ndarray, shape (rows, nx, ny)
        Stiffness, N/m, where a motion is held by a spring; 0 elsewhere.
    carries_load : bool
        Whether the approach is unknown.
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
        """Motion along the rows, shape (rows, nx, ny)."""
        return np.asarray(np.sum(self.direction * moved, axis=2) * self.touched)

    def push(self, force: Field) -> Field:
        """Add up forces along the rows as vectors, shape (nx, 3, ny)."""
        return np.asarray(np.sum(self.direction * (force * self.touched)[:, :, None], axis=0))

    def _respond(self, force: Field) -> Field:
        if self._vertical:
            found = filter_surface(force[0], self.reference.vertical[0])
            return np.where(self.held, found, 0.0)
        moved = self.along(self.reference.compliance(self.push(force)))
        return np.asarray(moved + self._give * force)

    def _resist(self, moved: Field) -> Field:
        if self._vertical:
            found = filter_surface(moved[0], self.reference.vertical[1])
            return np.where(self.held, found, 0.0)
        return self.along(self.reference.stiffness(self.push(moved)))

    def surface_solve(self, right_hand_side: Field) -> Field:
        """Find the forces along the rows that move them as given, by conjugate gradients."""
        force, r = np.zeros_like(right_hand_side), right_hand_side * self.touched
        goal = _INNER * float(np.linalg.norm(r))
        p, rz_old = np.zeros_like(r), 1.0
        for _ in range(_LIMIT):
            if float(np.linalg.norm(r)) <= goal:
                break
            z = self._resist(r)
            rz = float(np.vdot(r, z))
            p = z + (rz / rz_old) * p
            q = self._respond(p)
            alpha = rz / float(np.vdot(p, q))
            force += alpha * p
            r -= alpha * q
            rz_old = rz
        return force

    @cached_property
    def _unit(self) -> Field:
        """Forces under a unit approach, N/m."""
        return self.surface_solve(self.closing)

    def solve(
        self, residual: Field, missing: float, distance: np.ndarray | None = None
    ) -> tuple[Field, float]:
        """Solve (1) for r, rho and d; return z and zeta."""
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
        self.reference.surface(z)[:] += self.push(
            off
        )  # neither rounding nor the inner tolerance moves what is held
        return z, shift
