"""Extreme eigenvalues of a symmetric matrix by Lanczos, and the refusal of indefinite ones."""

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array

from multiscale.errors import CaseError
from multiscale.numerics.lanczos import lanczos

__all__ = ["FIRST_LOOK", "SMALL", "THOROUGH", "largest_eigenvalue", "refuse_indefinite"]

FIRST_LOOK, THOROUGH = 40, 200
"""Lanczos steps before a problem is solved, and after no method has solved it."""

SMALL = 100
"""Size up to which all eigenvalues are found."""


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
    """Raise if Lanczos meets a clearly negative eigenvalue of a symmetric operator.

    Parameters
    ----------
    apply : callable, product of the operator, dimensionless, with a vector of shape (size,)
    size, steps : int, number of unknowns and of Lanczos steps
    sentence : str
        Message with the fields ``value``, ``worst`` and ``share``: the smallest eigenvalue found,
        the contact or constraint that carries most of its vector, and the share that it carries.
    width : int, number of unknowns of a contact or constraint
    atol, rtol : float
        Negative eigenvalue that round-off explains, and the same relative to the largest one.

    Raises
    ------
    CaseError
        The sentence.
    """
    values, vectors = lanczos(apply, size, steps)
    if values[0] >= -max(atol, rtol * abs(values[-1])):
        return
    values, vectors = lanczos(apply, size, THOROUGH)  # the few steps of a first look name others
    shares = np.sum(vectors[:, 0].reshape(-1, width) ** 2, axis=1)
    worst = int(np.argmax(shares))
    raise CaseError(sentence.format(value=values[0], worst=worst, share=shares[worst]))
