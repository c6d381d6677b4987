"""Extreme eigenvalues of a symmetric matrix by Lanczos, and the refusal of indefinite ones."""

from collections.abc import Callable

import numpy as np
from scipy.linalg import eigh_tridiagonal
from scipy.sparse import csr_array

from multiscale.errors import CaseError

__all__ = ["FIRST_LOOK", "SMALL", "THOROUGH", "lanczos", "largest_eigenvalue", "refuse_indefinite"]

FIRST_LOOK, THOROUGH = 40, 200
"""Lanczos steps before a problem is solved, and after no method has solved it."""

SMALL = 100
"""Size up to which all eigenvalues are found."""

BREAKDOWN = 1e-12
"""New direction, relative to the largest product, below which the space is invariant."""


def lanczos(
    apply: Callable[[np.ndarray], np.ndarray], size: int, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Ritz values and vectors of a symmetric operator, from a random start.

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


def largest_eigenvalue(matrix: csr_array | np.ndarray) -> float:
    """Bound the largest eigenvalue of a symmetric matrix from above.

    Exact for up to 100 unknowns; an estimate raised by 2 % beyond.

    Examples
    --------
    >>> largest_eigenvalue(np.diag([1.0, 4.0]))
    4.0
    """
    n = matrix.shape[0]
    if n <= SMALL:
        full = matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
        return float(np.linalg.eigvalsh(full)[-1])
    return 1.02 * float(lanczos(lambda v: matrix @ v, n, FIRST_LOOK)[0][-1])


def refuse_indefinite(
    apply: Callable[[np.ndarray], np.ndarray],
    size: int,
    steps: int,
    sentence: str,
    *,
    width: int = 1,
    atol: float = 0.0,
    rtol: float = 0.0,
) -> None:
    """Raise if Lanczos meets a clearly negative eigenvalue of a symmetric operator."""
    values, vectors = lanczos(apply, size, steps)
    if values[0] >= -max(atol, rtol * abs(values[-1])):
        return
    values, vectors = lanczos(apply, size, THOROUGH)  # the few steps of a first look name others
    shares = np.sum(vectors[:, 0].reshape(-1, width) ** 2, axis=1)
    worst = int(np.argmax(shares))
    raise CaseError(sentence.format(value=values[0], worst=worst, share=shares[worst]))
