r"""Bodies of a dense stiffness, condensed onto jumps and rigid motions in a Newton step.

With the free rigid motions N, :math:`u = v + N a`, :math:`N^T v = 0`,
:math:`\hat K = K + k N N^T` and the compliance :math:`C = B \hat K^{-1} B^T`,

.. math::
    j + C w D j - B N a = B \hat K^{-1} r, \qquad (B N)^T w D j = N^T r, \qquad
    v = \hat K^{-1} (r - B^T w D j). \tag{1}
"""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import norm, qr, svd
from scipy.sparse import block_diag, csr_array, hstack

from multiscale.errors import MultiscaleError
from multiscale.fe.elasticity import compliances
from multiscale.fe.multigrid import DEPENDENT
from multiscale.numerics.factorisation import Solve, factorise

SOFT = 0.25
"""Stiffness of the bodies along a jump over their mean diagonal stiffness: the sides are in series,
and the material around a node deforms. With the full stiffness, iterations on metal with plastic
flow and slip cycle."""

RIGID = 1e4
"""Largest stiffness of the bodies at a point, relative to the mean: supports may hold a point."""

FREE, EXACT = 1e-9, 1e-12
"""Largest force of a free rigid motion, relative to the stiffness, before and after its rounding is
removed."""


@dataclass(frozen=True, eq=False)
class FlexibleBodies:
    """Bodies condensed onto their jumps and rigid motions; (1) of this module."""

    stiffness: np.ndarray  # of v and a, zero for a, (n + m, n + m), N/m
    jump: csr_array  # (d * points, n + m)
    weight: np.ndarray  # (points,), m²
    motions: np.ndarray  # N, (n, m)
    solve: Solve  # with K + k N N^T
    compliance: np.ndarray  # C, (d * points, d * points), m/N

    @cached_property
    def resistance(self) -> np.ndarray:
        """Stiffness of the bodies against a traction at a single point, (d, points), Pa/m."""
        flexibility = self.compliance.diagonal().reshape(-1, self.weight.size) * self.weight
        return np.asarray(SOFT / np.maximum(flexibility, flexibility.mean() / RIGID))

    def direction(self, tangent: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Newton direction (1), m, of v and a, from the tangent, (d, d, points), N/m."""
        n, points = len(self.motions), self.compliance.shape[0]
        B, m = self.jump[:, :n], self.motions.shape[1]
        size = 1.0 + np.abs(tangent).max(axis=0) / (self.resistance * self.weight)  # stiff laws
        change = tangent / size
        # C w D and (B N)^T w D
        rows = np.concatenate([self.compliance, self.jump[:, n:].toarray().T])
        blocks = rows.reshape(points + m, *size.shape)
        product = np.einsum("rip,ijp->rjp", blocks, change).reshape(points + m, points)

        # (1), with scaled jumps and rows of the motions
        matrix = np.zeros((points + m, points + m))
        matrix[:, :points] = product
        matrix[np.arange(points), np.arange(points)] += 1.0 / size.ravel()
        matrix[:points, points:] = -rows[points:].T
        right = np.append(B @ self.solve(force[:n]), force[n:])
        scale = np.abs(matrix[points:]).max(axis=1)
        if not np.all(scale > 0.0):
            raise MultiscaleError("the law does not resist a rigid motion")
        matrix[points:] /= scale[:, None]
        right[points:] /= scale
        opened, motion = np.split(factorise(matrix, name="the tangent compliance")(right), [points])
        moved = np.einsum("ijp,jp->ip", change, opened.reshape(size.shape)).ravel()
        return np.append(self.solve(force[:n] - B.T @ moved), motion)

    def split(self, value: np.ndarray, *, motions: bool = True) -> np.ndarray:
        """Displacement without motions, and the motions; or forces, and the forces on motions."""
        amount = self.motions.T @ value
        return np.append(value - self.motions @ amount if motions else value, amount)

    def join(self, value: np.ndarray) -> np.ndarray:
        """Displacement, m."""
        n = len(self.motions)
        return np.asarray(value[:n] + self.motions @ value[n:])


def prepare_flexible(
    stiffness: np.ndarray, jump: csr_array, weight: np.ndarray, motions: np.ndarray
) -> FlexibleBodies | None:
    """Condense bodies of dense matrices onto their jumps; None if singular beyond motions."""
    mean = np.abs(stiffness.diagonal()).mean()
    # free rigid motions: orthonormal, with forces up to rounding, then refined
    basis, length, _ = svd(motions, full_matrices=False)
    basis = basis[:, length > DEPENDENT * length.max(initial=0.0)]
    force = abs(stiffness) @ abs(basis)
    _, resisted, turn = svd(stiffness @ basis, full_matrices=False)
    N = basis @ turn[resisted <= FREE * norm(force)].T
    with suppress(MultiscaleError):
        if N.shape[1]:
            N = qr(N - factorise(stiffness + mean * (N @ N.T))(stiffness @ N))[0]
            N = N[:, np.abs(stiffness @ N).max(axis=0) <= EXACT * mean]
        regular = stiffness + mean * (N @ N.T)
        solve = factorise(regular, name="the supported bodies")
        zero = np.zeros((N.shape[1],) * 2)
        return FlexibleBodies(
            block_diag([regular, zero]).toarray(),
            csr_array(hstack([jump, csr_array(jump @ N)])),
            weight,
            N,
            solve,
            compliances(solve, jump)[0],
        )
    return None
