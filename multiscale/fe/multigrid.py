r"""Smoothed aggregation of elastic bodies on nodal blocks, and minimal residuals with its cycle.

The tangent D of a joint is split into a share :math:`D_c` of at most the stiffness :math:`k` of the
bodies at a point, and the rest :math:`D'` with the unknown forces :math:`s = D' B u`; for
:math:`\gamma` from 1 to 2 the Schur complement of the second row is near the identity for any D:

.. math::
    (K + B^T D_c B)\, u + B^T s = f, \qquad
    (I + D'/\gamma k)^{-1} (s - D' B u) = 0.    \tag{1}
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.linalg import norm, svd
from scipy.sparse import bsr_matrix, csr_array, csr_matrix

from multiscale.errors import MultiscaleError
from multiscale.fe.elasticity import rigid_motions
from multiscale.numerics.factorisation import Solve
from multiscale.numerics.krylov import Operator, minimal_residual

STRENGTH = 0.02  # coupling of two nodes, relative to their blocks, from which they are aggregated
COARSEST = 600  # nodes up to which no coarser level follows: the coarsest is factorised

BETWEEN = 1.4  # gamma of (1)

GOAL, ROOM = 1e-10, 120
"""Residual of a solve relative to its right-hand side, and limit of the iterations."""

ROUNDING, UNSURE = 64.0 * np.finfo(float).eps, 1e-5
"""Residual which is rounding: relative to the terms of the product with the matrix, and at most
relative to the right-hand side: the terms are large where joints of 1e-9 of the stiffness of the
bodies support them."""

FREE = 1e-13
"""Stiffness of a rigid motion, after scaling by the diagonal, below which the motion is free."""

DEPENDENT = 1e-8  # singular value of a motion, relative to the largest, that others span

BLOCKS = ("block_gauss_seidel", {"sweep": "symmetric"})
POLYNOMIAL = ("chebyshev", {"degree": 2})
"""Smoothers: of any contrast of stiffness, and the cheaper of even bodies."""


def nodal_cycle(
    matrix: csr_array,
    place: np.ndarray,
    modes: np.ndarray,
    smoother: tuple[str, dict[str, Any]],
    free: np.ndarray | None = None,
) -> Operator:
    """Set up a symmetric cycle on blocks of three components a node."""
    from pyamg import smoothed_aggregation_solver

    nodes, node = np.unique(place // 3, return_inverse=True)
    at, size, n = (3 * node + place % 3).astype(np.int32), 3 * len(nodes), len(place)
    moving = np.arange(n) if free is None else np.flatnonzero(free)
    padded = _blocks(matrix, at, size)
    mean = float(np.abs(matrix.diagonal()).sum()) / moving.size
    del matrix  # it is as large as the hierarchy
    unit = np.full(size, mean)  # fixed components
    unit[at[moving]] = 0.0
    diagonal = unit.reshape(-1, 3, 1) * np.eye(3), np.arange(size // 3), np.arange(size // 3 + 1)
    padded = padded + bsr_matrix(diagonal, shape=padded.shape)
    candidates = np.zeros((size, modes.shape[1]))
    candidates[at[moving]] = modes[moving]
    levels = smoothed_aggregation_solver(
        padded,
        B=candidates,
        strength=("symmetric", {"theta": STRENGTH}),
        presmoother=smoother,
        postsmoother=smoother,
        max_coarse=COARSEST,
        coarse_solver="splu",
        improve_candidates=None,
    )
    precondition = levels.aspreconditioner(cycle="V")

    def apply(residual: np.ndarray) -> np.ndarray:
        padded_residual = np.zeros(size)
        padded_residual[at] = residual
        moved: np.ndarray = precondition.matvec(padded_residual)[at]
        return moved

    return apply


def _blocks(matrix: csr_array, at: np.ndarray, size: int) -> bsr_matrix:
    """Blocks of a matrix with its unknowns at places among the components of all nodes."""
    if np.any(np.diff(at) < 0):
        order = np.argsort(at)
        rows, row = csr_array(matrix[order]), at[order]
    else:
        rows, row = matrix, at
    start = np.zeros(size + 1, dtype=np.int32)
    start[1 + row] = np.diff(rows.indptr)
    entries = rows.data, at[rows.indices], np.cumsum(start, dtype=np.int32)
    return csr_matrix(entries, shape=(size, size)).tobsr((3, 3))


@dataclass(frozen=True, eq=False)
class Multigrid:
    """Iterative solver of the tangents of bodies with joints."""

    position: np.ndarray  # of the unknowns, (n, 3), m
    component: np.ndarray  # direction of every unknown, (n,)
    motions: np.ndarray  # rigid motions of every body, (n, motions)

    def __call__(self, stiffness: csr_array, jump: csr_array, tangent: np.ndarray) -> Solve:
        """Prepare (1) of bodies, (n, n), with the tangents (d, d, points) of joints, N/m."""
        # shares of the stiffness of the joints that the cycle takes
        n, points = stiffness.shape[0], tangent.shape[2]
        flexible = jump.power(2) @ (1.0 / np.abs(stiffness.diagonal()))
        k = 1.0 / np.maximum(
            flexible.reshape(len(tangent), points).mean(axis=0), np.finfo(float).tiny
        )
        share = np.minimum(1.0, k / np.maximum(np.abs(tangent).max(axis=(0, 1)), 1e-300 * k))
        soft = joint_matrix(share * tangent)

        def balance(u: np.ndarray) -> np.ndarray:
            return np.asarray(stiffness @ u + jump.T @ (soft @ (jump @ u)))

        self._refuse_free_motions(stiffness.diagonal(), balance)
        place, modes = self._nodes()
        try:
            # the matrix is freed by the function, so that no name refers to it
            cycle = nodal_cycle(stiffness + jump.T @ (soft @ jump), place, modes, BLOCKS)
        except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
            raise MultiscaleError(f"multigrid cannot coarsen the bodies: {error}") from error

        # the second row of (1)
        stiff = share < 1.0
        rest = np.moveaxis((1.0 - share[stiff]) * tangent[..., stiff], -1, 0)
        scale = np.linalg.inv(np.eye(len(tangent)) + rest / (BETWEEN * k[stiff, None, None]))
        across = csr_array(jump[np.tile(stiff, len(tangent))])
        unit, pull = (joint_matrix(np.moveaxis(each, 0, -1)) for each in (scale, scale @ rest))

        def apply(x: np.ndarray) -> np.ndarray:
            u, s = x[:n], x[n:]
            return np.concatenate([balance(u) + across.T @ s, unit @ s - pull @ (across @ u)])

        def precondition(residual: np.ndarray) -> np.ndarray:
            force, s = residual[:n], residual[n:]
            return np.concatenate([cycle(force - across.T @ s), s])

        def solve_column(right: np.ndarray) -> np.ndarray:
            b, size = np.append(right, np.zeros(across.shape[0])), float(norm(right))
            try:
                with np.errstate(all="ignore"):  # of a singular matrix: the residual shows it
                    x, count = minimal_residual(apply, b, precondition, goal=GOAL * size, room=ROOM)
                    left = float(norm(b - apply(x)))
                    limit = 1.01 * GOAL * size
                    if not left <= limit:
                        moved, across_joints = np.abs(x[:n]), abs(jump)
                        joints = across_joints.T @ (abs(soft) @ (across_joints @ moved))
                        terms = float(norm(abs(stiffness) @ moved + joints))
                        limit = max(limit, min(ROUNDING * terms, UNSURE * size))
            except RuntimeError as error:  # the coarsest matrix is singular
                raise MultiscaleError(f"the tangent stiffness is singular: {error}") from error
            if not left <= limit:
                raise MultiscaleError(
                    f"multigrid left a residual of {left / (size or 1.0):.1e} of the load in "
                    f"{count} iterations; the tangent stiffness may be singular, check the supports"
                )
            return x[:n]

        # not recursive: the cycle is freed with this function
        return lambda right: np.apply_along_axis(solve_column, 0, right)

    def _refuse_free_motions(self, diagonal: np.ndarray, balance: Operator) -> None:
        """Refuse a tangent that does not resist a combination of the rigid motions of bodies."""
        size = np.sqrt(np.maximum(np.abs(diagonal), np.finfo(float).tiny))[:, None]
        basis, length, _ = svd(size * self.motions, full_matrices=False)
        basis = basis[:, length > DEPENDENT * length.max(initial=0.0)]
        resisted = svd(balance(basis / size) / size, compute_uv=False)
        if resisted.size and not resisted[-1] > FREE:
            raise MultiscaleError(
                "the tangent stiffness is singular: bodies can move without force as rigid bodies; "
                "check the supports and that every body is fixed"
            )

    def _nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Places of the unknowns on nodes, in turn with rising components, and rigid motions."""
        apart = np.any(np.diff(self.position, axis=0) != 0.0, axis=1)
        node = np.append(0, np.cumsum(apart | (np.diff(self.component) <= 0)))
        modes = rigid_motions(self.position, self.component)
        modes /= np.maximum(np.abs(modes).max(axis=0), np.finfo(float).tiny)
        return 3 * node + self.component % 3, modes


def joint_matrix(tangent: np.ndarray) -> csr_array:
    """Matrix of tangents (d, d, points): all normal jumps, then each tangential jump."""
    i, j, at = np.nonzero(tangent)
    points = tangent.shape[2]
    place = (points * i + at).astype(np.int32), (points * j + at).astype(np.int32)
    return csr_array((tangent[i, j, at], place), shape=(len(tangent) * points,) * 2)
