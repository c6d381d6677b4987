"""Extreme eigenvalues of a symmetric matrix by Lanczos, and the refusal of indefinite ones."""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import ArpackNoConvergence, eigsh

from multiscale.errors import CaseError
from multiscale.nonsmooth.lcp_operator import Entries
from multiscale.nonsmooth.lcp_problem import ScaledLCP
from multiscale.numerics.lanczos import lanczos

__all__ = ["extreme_eigenvalues", "refuse_indefinite"]

STEPS = 40
"""Lanczos steps of the estimate."""

RESTARTS = 20
"""Restarts of the Lanczos iteration that looks for the smallest eigenvalue in earnest."""

SMALL = 100
"""Size up to which all eigenvalues are computed."""

INDEFINITE = 1e-6
"""Smallest eigenvalue of the scaled matrix, with its sign changed, that counts as negative."""


def extreme_eigenvalues(matrix: csr_array | np.ndarray) -> tuple[float, float]:
    """Estimate the smallest and the largest eigenvalue of a symmetric matrix, from inside.

    Exact for up to 100 unknowns; the largest is raised by 2 % beyond, so that it is safe as a
    bound on the step of a gradient method.

    Examples
    --------
    >>> extreme_eigenvalues(np.diag([1.0, 4.0]))
    (1.0, 4.0)
    """
    n = matrix.shape[0]
    if n <= SMALL:
        full = matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
        values = np.linalg.eigvalsh(full)
        return float(values[0]), float(values[-1])
    values = lanczos(lambda v: matrix @ v, n, STEPS)[0]
    return float(values[0]), 1.02 * float(values[-1])


def refuse_indefinite(problem: ScaledLCP, *, thorough: bool = False) -> None:
    """Raise if a symmetric matrix has an eigenvalue that is clearly negative.

    Parameters
    ----------
    problem : ScaledLCP
        Given by its entries; a nonsymmetric one always passes.
    thorough : bool
        Look on until the smallest eigenvalue has converged, if it does soon.

    Raises
    ------
    CaseError
        Names the smallest eigenvalue of the scaled matrix and the constraint that carries most
        of its vector.
    """
    operator = problem.operator
    if not problem.is_symmetric or not isinstance(operator, Entries) or problem.vector.size == 0:
        return
    if not thorough and extreme_eigenvalues(operator.matrix)[0] > -INDEFINITE:
        return
    if problem.vector.size <= SMALL:
        values, vectors = np.linalg.eigh(operator.rows.toarray())
    else:
        try:
            values, vectors = eigsh(
                operator.matrix, k=1, which="SA", tol=1e-3, ncv=40, maxiter=RESTARTS
            )
        except ArpackNoConvergence:
            return
    if values[0] > -INDEFINITE:
        return
    worst = int(np.argmax(np.abs(vectors[:, 0])))
    raise CaseError(
        f"matrix is symmetric but indefinite: its smallest eigenvalue, with the diagonal scaled to "
        f"one, is {values[0]:.3g}, and constraint {worst} carries {vectors[worst, 0] ** 2:.0%} of "
        f"its vector; check the sign of that row, or use method='pivoting', which needs no "
        f"definiteness"
    )
