"""Refusal of friction problems whose W is indefinite or cannot move."""

import numba
import numpy as np
from scipy.linalg import eigh_tridiagonal

from multiscale.errors import CaseError
from multiscale.nonsmooth.friction_problem import ScaledFriction

__all__ = ["refuse_indefinite"]

STEPS = 20
"""Lanczos steps of the first look."""

NEGATIVE = 1e-4
"""Negative eigenvalue, relative to the largest, that round-off in the data does not explain."""


def refuse_indefinite(problem: ScaledFriction, steps: int = STEPS) -> None:
    """Raise if Lanczos meets a clearly negative eigenvalue of the symmetric part of W.

    Parameters
    ----------
    problem : ScaledFriction
        The problem, dimensionless.
    steps : int
        Lanczos steps; the few of the first look find only what is plain.

    Raises
    ------
    CaseError
        Names the eigenvalue and the contact that carries most of its vector.
    """
    n = 3 * problem.friction.size
    basis = np.zeros((min(steps, n) + 1, n))
    basis[0] = np.random.default_rng(seed=0).standard_normal(n)
    diagonal, off = _lanczos(problem.blocks, problem.columns, problem.starts, basis)
    values, vectors = eigh_tridiagonal(diagonal, off[:-1])
    if values[0] >= -NEGATIVE * abs(values[-1]):
        return
    vector = vectors[:, 0] @ basis[: diagonal.size]
    share = np.sum(vector.reshape(-1, 3) ** 2, axis=1) / float(vector @ vector)
    worst = int(np.argmax(share))
    raise CaseError(
        f"delassus is indefinite: after scaling its diagonal to one it has the eigenvalue "
        f"{values[0]:.2e}, and contact {worst} carries {share[worst]:.0%} of its vector; check "
        f"the masses there, W = H^T M^-1 H has no negative eigenvalue"
    )


@numba.njit(cache=True)
def _lanczos(blocks, columns, starts, basis):  # type: ignore[no-untyped-def]
    """Lanczos with full orthogonalisation; returns diagonal and off-diagonal, fills the basis."""
    steps = basis.shape[0] - 1
    diagonal, off = np.zeros(steps), np.zeros(steps)
    basis[0] /= np.sqrt(np.sum(basis[0] ** 2))
    for step in range(steps):
        image = np.zeros(basis.shape[1])
        vector = basis[step]
        for i in range(starts.size - 1):
            for k in range(starts[i], starts[i + 1]):
                j = columns[k]
                for a in range(3):
                    for b in range(3):
                        half = 0.5 * blocks[k, a, b]
                        image[3 * i + a] += half * vector[3 * j + b]
                        image[3 * j + b] += half * vector[3 * i + a]
        diagonal[step] = np.sum(vector * image)
        for _ in range(2):
            for earlier in range(step + 1):
                image -= np.sum(basis[earlier] * image) * basis[earlier]
        off[step] = np.sqrt(np.sum(image**2))
        if off[step] <= 1e-12 * np.max(np.abs(diagonal)):
            return diagonal[: step + 1], off[: step + 1]
        basis[step + 1] = image / off[step]
    return diagonal, off
