"""Refusal of friction problems whose W is indefinite or cannot move."""

import numpy as np
from scipy.sparse import bsr_array

from multiscale.errors import CaseError
from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.numerics.lanczos import lanczos

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
    matrix = bsr_array((problem.blocks, problem.columns, problem.starts))
    half = 0.5 * matrix
    turned = half.T.tobsr()
    values, vectors = lanczos(lambda v: half @ v + turned @ v, matrix.shape[0], steps)
    if values[0] >= -NEGATIVE * abs(values[-1]):
        return
    share = np.sum(vectors[:, 0].reshape(-1, 3) ** 2, axis=1)
    worst = int(np.argmax(share))
    raise CaseError(
        f"delassus is indefinite: after scaling its diagonal to one it has the eigenvalue "
        f"{values[0]:.2e}, and contact {worst} carries {share[worst]:.0%} of its vector; check "
        f"the masses there, W = H^T M^-1 H has no negative eigenvalue"
    )
