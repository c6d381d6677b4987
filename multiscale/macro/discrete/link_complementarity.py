"""Linear complementarity problem of the links that may go slack, (10) of the source."""

from dataclasses import replace

import numpy as np

from multiscale.convergence import Solution
from multiscale.errors import CaseError
from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.link_tangent import Tangent
from multiscale.nonsmooth import solve_lcp

__all__ = ["MAX_DENSE_LINKS", "complementarity_problem", "solve_complementarity"]

MAX_DENSE_LINKS = 5000
"""Largest number of links that may go slack: the matrix is dense."""


def complementarity_problem(
    model: LinkEquations, tangent: Tangent, load_factor: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Condense the structure onto the links that may go slack.

    .. math::
        A_c \lambda_c - \tau_c = -k_c B_c K^{-1} F^d - \tau_c^0, \quad
        0 \le \lambda_c \perp \tau_c \ge 0, \quad
        A_c = k_c - k_c B_c K^{-1} B_c^T k_c,    \tag{10}

    with the stiffness :math:`K` of the structure without slack. Struts have the opposite sign.

    Parameters
    ----------
    load_factor : float, dimensionless

    Returns
    -------
    tuple of ndarray
        :math:`A_c` (N/m), the tensions :math:`\tau_c` without slack (N), and the displacement
        :math:`K^{-1} B_c^T k_c` of unit slacks, shape (n, links).

    Raises
    ------
    CaseError
        If too many links may go slack.
    MultiscaleError
        If the structure is a mechanism.
    """
    one_sided = np.flatnonzero(np.isfinite(model.lower) | np.isfinite(model.upper))
    if one_sided.size > MAX_DENSE_LINKS:
        raise CaseError(
            f"method 'lcp' forms a dense matrix of the {one_sided.size} links that may go slack, "
            f"at most {MAX_DENSE_LINKS}; use method='auto'"
        )
    k = model.stiffness[one_sided]
    sign = np.where(np.isfinite(model.lower[one_sided]), 1.0, -1.0)
    pull = np.zeros((model.n, one_sided.size))
    for p in range(model.unknown.shape[1]):
        row = model.unknown[one_sided, p]
        held = row < 0
        column = np.flatnonzero(~held)
        pull[row[~held], column] += (sign * k * model.coefficient[one_sided, p])[~held]
    solve = tangent.factorise(tangent.entries(model.stiffness))
    motion = solve(pull)
    matrix = np.diag(k) - pull.T @ motion
    free = solve(load_factor * model.load - model.gather(model.prestress))
    taut = sign * model.prestress[one_sided] + pull.T @ free
    return 0.5 * (matrix + matrix.T), taut, motion


def solve_complementarity(
    model: LinkEquations, tangent: Tangent, load_factor: float, *, tolerance: float = 1e-10
) -> Solution:
    """Solve (10) by :func:`multiscale.nonsmooth.solve_lcp`.

    Parameters
    ----------
    model, tangent, load_factor
        As for :func:`complementarity_problem`.
    tolerance : float
        Bound on the residual of :func:`multiscale.nonsmooth.solve_lcp`, dimensionless.

    Returns
    -------
    Solution, ``value`` is the displacement, shape (n,), m; residuals belong to (10)
    """
    matrix, taut, motion = complementarity_problem(model, tangent, load_factor)
    answer = solve_lcp(matrix, taut, tolerance=tolerance)
    solve = tangent.factorise(tangent.entries(model.stiffness))
    free = solve(load_factor * model.load - model.gather(model.prestress))
    return replace(answer, value=free - motion @ answer.value)
