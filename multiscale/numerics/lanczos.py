"""Extreme eigenvalues of symmetric operators by Lanczos."""

from collections.abc import Callable

import numpy as np
from scipy.linalg import eigh_tridiagonal

__all__ = ["lanczos"]

BREAKDOWN = 1e-12
"""New direction, relative to the largest product, below which the space is invariant."""


def lanczos(
    apply: Callable[[np.ndarray], np.ndarray], size: int, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Ritz values and vectors of a symmetric operator, from a random start.

    Parameters
    ----------
    apply : callable, product of the operator with a vector of shape (size,)
    size, steps : int, unknowns, and products to take at most

    Returns
    -------
    values : ndarray, shape (k,)
        Rising; all lie within the spectrum, and the extreme ones are found first.
    vectors : ndarray, shape (size, k), of unit length

    References
    ----------
    .. [1] C. Lanczos, J. Res. Natl. Bur. Stand. 45 (1950) 255-282, doi:10.6028/jres.045.026; with
       full orthogonalisation.

    Examples
    --------
    >>> lanczos(lambda v: np.array([1.0, 2.0, 4.0]) * v, 3, 3)[0].round(9)
    array([1., 2., 4.])
    """
    steps = min(steps, size)
    basis = np.empty((steps, size))
    diagonal, off = np.empty(steps), np.empty(steps)
    vector = np.random.default_rng(seed=0).standard_normal(size)
    off_before = np.linalg.norm(vector)
    for k in range(steps):
        basis[k] = vector / off_before
        vector = apply(basis[k])
        diagonal[k] = basis[k] @ vector
        for _ in range(2):
            vector = vector - basis[: k + 1].T @ (basis[: k + 1] @ vector)
        off[k] = off_before = np.linalg.norm(vector)
        if off[k] <= BREAKDOWN * np.abs(diagonal[: k + 1]).max():
            break
    values, weights = eigh_tridiagonal(diagonal[: k + 1], off[:k])
    return values, basis[: k + 1].T @ weights
