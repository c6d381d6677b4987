"""Linear complementarity problem of the links that may go slack, (10) of the source."""

from dataclasses import replace

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.link_state import LinkState, state_of
from multiscale.macro.discrete.link_tangent import Tangent
from multiscale.nonsmooth import solve_lcp

__all__ = ["solve_complementarity"]

MAX_DENSE_LINKS = 5000
"""Largest number of links that may go slack: the matrix is dense."""


def solve_complementarity(
    model: LinkEquations, tangent: Tangent, load_factor: float, *, tolerance: float = 1e-10
) -> LinkState:
    r"""Condense the structure onto the links that may go slack, and find their slacks.

    .. math::
        A_c \lambda_c - \tau_c = -k_c B_c K^{-1} F^d - \tau_c^0, \quad
        0 \le \lambda_c \perp \tau_c \ge 0, \quad
        A_c = k_c - k_c B_c K^{-1} B_c^T k_c,    \tag{10}

    with the stiffness :math:`K` of the structure without slack. Struts have the opposite sign.
    """
    one_sided = np.flatnonzero(np.isfinite(model.lower) | np.isfinite(model.upper))
    if one_sided.size > MAX_DENSE_LINKS:
        raise CaseError(
            f"method 'lcp' forms a dense matrix of the {one_sided.size} links that may go slack, "
            f"at most {MAX_DENSE_LINKS}; use method='auto'"
        )
    k = model.stiffness[one_sided]
    sign = np.where(np.isfinite(model.lower[one_sided]), 1.0, -1.0)
    pull = (model.operator[one_sided].T * (sign * k)).toarray()  # B_c^T k_c
    solve = tangent.factorise(tangent.entries(model.stiffness))
    motion = solve(pull)
    matrix = np.diag(k) - pull.T @ motion
    free = solve(load_factor * model.load - model.gather(model.prestress))
    taut = sign * model.prestress[one_sided] + pull.T @ free
    answer = solve_lcp(0.5 * (matrix + matrix.T), taut, tolerance=tolerance)
    return state_of(model, replace(answer, value=free - motion @ answer.value))
