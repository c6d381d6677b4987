"""Projected Gauss-Seidel for linear complementarity problems (NLGS without friction)."""

from collections.abc import Iterator

import numpy as np

from multiscale.nonsmooth.lcp_problem import ScaledLCP
from multiscale.numerics.compiled import compiled

__all__ = ["iterate_gauss_seidel"]

SWEEPS = 10
"""Sweeps from one iterate to the next."""


def iterate_gauss_seidel(problem: ScaledLCP, start: np.ndarray) -> Iterator[np.ndarray]:
    r"""Yield x after every ten sweeps, forward and backward in turn, without end.

    One step of a sweep is

    .. math:: x_i \leftarrow \max\bigl(0,\, x_i - (A x + b)_i / A_{ii}\bigr).

    It converges for symmetric positive definite matrices and for H-matrices with a positive
    diagonal; a constraint without a positive diagonal is left where it is.

    References
    ----------
    .. [1] C. W. Cryer, SIAM J. Control 9 (1971) 385-392, doi:10.1137/0309028.
    """
    rows = problem.entries.rows
    diagonal, x = rows.diagonal(), start.copy()
    while True:
        _sweep(rows.data, rows.indices, rows.indptr, diagonal, problem.vector, x)
        yield x.copy()


@compiled
def _sweep(data, indices, indptr, diagonal, vector, x):  # type: ignore[no-untyped-def]
    n = x.size
    for sweep in range(SWEEPS):
        for step in range(n):
            i = step if sweep % 2 == 0 else n - 1 - step
            if diagonal[i] <= 0.0:
                continue
            slack = vector[i]
            for entry in range(indptr[i], indptr[i + 1]):
                slack += data[entry] * x[indices[entry]]
            x[i] = max(0.0, x[i] - slack / diagonal[i])
