"""The conic interior-point solver clarabel as an independent oracle."""

from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np
from scipy.sparse import block_diag, csc_array, eye_array, hstack, triu, vstack

from multiscale.nonsmooth.lcp_operator import Delassus
from multiscale.nonsmooth.lcp_problem import ScaledLCP
from multiscale.nonsmooth.newton_min import iterate_newton_min

__all__ = ["iterate_conic", "solve_conic"]

TOLERANCE = 1e-12
"""Gap and feasibility asked of clarabel, on scaled data."""

POLISH_STEPS = 3
"""Active sets tried from its answer."""


def solve_conic(
    quadratic: csc_array,
    linear: np.ndarray,
    constraints: csc_array,
    limits: np.ndarray,
    *,
    zero: int = 0,
    positive: int = 0,
    friction: int = 0,
    tolerance: float = TOLERANCE,
) -> Any:
    r"""Return clarabel's answer to a conic program.

    .. math:: \min_x \tfrac12 x^T P x + q^T x, \qquad b - A x \in \{0\} \times R_+ \times K,

    P given by its upper triangle; the first ``zero`` rows are equations, the next ``positive`` ones
    inequalities, and the rest ``friction`` second-order cones of three rows each.
    """
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    cones = [clarabel.ZeroConeT(zero)] if zero else []
    cones += [clarabel.NonnegativeConeT(positive)] if positive else []
    cones += [clarabel.SecondOrderConeT(3)] * friction
    return clarabel.DefaultSolver(
        csc_array(quadratic), linear, csc_array(constraints), limits, cones, settings
    ).solve()


def iterate_conic(problem: ScaledLCP, start: np.ndarray) -> Iterator[np.ndarray]:
    r"""Yield clarabel's answer to the quadratic problem behind a symmetric one, then polish it.

    .. math::
        \min_{x \ge 0} \tfrac12 x^T A x + b^T x
        \qquad\text{or}\qquad
        \min_{x \ge 0,\, v} \tfrac12 v^T M v + b^T x, \quad M v = H x,

    the second if the problem is given by bodies and directions. Clarabel takes no start; up to
    three active sets follow its answer.

    References
    ----------
    .. [1] P. J. Goulart and Y. Chen, Clarabel: An interior-point solver for conic programs with
       quadratic objectives, 2024, arXiv:2405.12762.
    """
    n, operator = start.size, problem.operator
    if isinstance(operator, Delassus):
        k = operator.mass.shape[0]
        quadratic = block_diag([csc_array((n, n)), operator.mass])
        balance = hstack([-operator.directions, operator.mass])
        positive = hstack([-eye_array(n), csc_array((n, k))])
        constraints = vstack([balance, positive])
    else:
        k, quadratic, constraints = 0, operator.rows, -eye_array(n)
    linear = np.append(problem.vector, np.zeros(k))
    limits = np.zeros(n + k)
    answer = solve_conic(triu(quadratic), linear, constraints, limits, zero=k, positive=n)
    x = np.maximum(np.array(answer.x)[:n], 0.0)
    yield x
    multiplier = np.array(answer.z)[k:]
    yield from islice(iterate_newton_min(problem, x, x > multiplier), POLISH_STEPS)
