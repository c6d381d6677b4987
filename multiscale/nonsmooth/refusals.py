"""Problems without an answer: out of range, indefinite, or infeasible with a certificate."""

from collections.abc import Callable, Iterable

import numpy as np
from scipy.linalg import eigh_tridiagonal
from scipy.sparse import csr_array

from multiscale.errors import CaseError

__all__ = [
    "FARTHEST",
    "FIRST_LOOK",
    "SMALL",
    "THOROUGH",
    "infeasibility_detail",
    "lanczos",
    "refuse_indefinite",
    "refuse_out_of_range",
]

LARGEST_EXPONENT = 300
"""Power of ten of the unknowns beyond which parts of 1e-8 of them have no digits or overflow."""

FIRST_LOOK, THOROUGH = 40, 200
"""Lanczos steps before a problem is solved, and after no method has solved it."""

SMALL = 100
"""Size up to which Lanczos takes as many steps as there are eigenvalues."""

BREAKDOWN = 1e-12
"""New direction, relative to the largest product, below which the space is invariant."""

FARTHEST = 1e9
"""Sum of the scaled unknowns, relative to the data, beyond which a solution does not count."""

LARGEST_PROGRAM = 2000
"""Number of constraints up to which a linear program looks for the certificate."""


def refuse_out_of_range(vector: np.ndarray, stiffness: np.ndarray) -> None:
    r"""Raise if :math:`-q_i / M_{ii}` under- or overflows in the row where it is largest."""
    rows = (vector < 0.0) & (stiffness > 0.0)
    if not rows.any():
        return
    exponent = float(np.max(np.log10(-vector[rows]) - np.log10(stiffness[rows])))
    if abs(exponent) > LARGEST_EXPONENT:
        raise CaseError(
            f"the unknowns are about 10^{exponent:.0f} in the units of the data, which is outside "
            f"of the floating-point numbers; choose other units"
        )


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
        for _ in range(2):  # orthogonal to all vectors before, twice against rounding
            vector = vector - basis[: k + 1].T @ (basis[: k + 1] @ vector)
        off[k] = off_before = np.linalg.norm(vector)
        if off[k] <= BREAKDOWN * np.abs(diagonal[: k + 1]).max():
            break
    values, weights = eigh_tridiagonal(diagonal[: k + 1], off[:k])
    return values, basis[: k + 1].T @ weights


def infeasibility_detail(
    matrix: csr_array | np.ndarray, vector: np.ndarray, directions: Iterable[np.ndarray]
) -> str:
    r"""Return a sentence on a Farkas certificate of a scaled problem; empty if there is none.

    No :math:`x \ge 0` with :math:`A x + b \ge 0` exists if and only if there is

    .. math:: y \ge 0, \qquad A^T y \le 0, \qquad b^T y < 0.    \tag{1}

    Candidates are directions in which iterates ran away and, for up to 2000 constraints, the
    answer of a linear program. Every admissible x has a sum of at least
    :math:`-b^T y / \max(A^T y)`: a candidate counts if this sum is out of reach.
    """
    from scipy.optimize import linprog

    transposed = matrix.T

    def judge(y: np.ndarray) -> str:
        largest = float(np.max(y, initial=0.0))
        if largest == 0.0:
            return ""
        y = np.maximum(y / largest, 0.0)
        power, reach = float(vector @ y), float(np.max(transposed @ y))
        if power >= 0.0 or -power <= FARTHEST * reach:
            return ""
        return (
            f"constraint {int(np.argmax(y))} carries the largest entry of the Farkas certificate "
            f"(y >= 0, M^T y <= 0, q^T y < 0); relieve that constraint or support the body it "
            f"pushes"
        )

    for y in directions:
        if np.all(np.isfinite(y)) and (detail := judge(y)):
            return detail
    if vector.size > LARGEST_PROGRAM:
        return ""
    answer = linprog(
        vector,
        A_ub=transposed,
        b_ub=np.zeros(vector.size),
        bounds=(0.0, 1.0),
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10},
    )
    return judge(answer.x) if answer.x is not None else ""
