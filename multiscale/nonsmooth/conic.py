"""The conic interior-point solver clarabel as an independent oracle."""

from collections.abc import Iterator
from itertools import islice

import numpy as np
from scipy.sparse import block_diag, csc_array, eye_array, hstack, triu, vstack

from multiscale.nonsmooth.lcp_operator import Delassus
from multiscale.nonsmooth.lcp_problem import ScaledLCP
from multiscale.nonsmooth.newton_min import iterate_newton_min

__all__ = ["iterate_conic"]

TOLERANCE = 1e-12
"""Gap and feasibility asked of clarabel, on scaled data."""

POLISH_STEPS = 3
"""Active sets tried from its answer."""


def iterate_conic(problem: ScaledLCP, start: np.ndarray) -> Iterator[np.ndarray]:
    r"""Yield clarabel's answer to the quadratic problem behind a symmetric one, then polish it.

    .. math::
        \min_{x \ge 0} \tfrac12 x^T A x + b^T x
        \qquad\text{or}\qquad
        \min_{x \ge 0,\, v} \tfrac12 v^T M v + b^T x, \quad M v = H x,

    the second if the problem is given by bodies and directions.

    Parameters
    ----------
    problem : ScaledLCP, symmetric positive semidefinite
    start : ndarray, shape (n,), not used: clarabel takes no start

    Yields
    ------
    ndarray, shape (n,), the answer, then up to three active sets

    References
    ----------
    .. [1] P. J. Goulart and Y. Chen, Clarabel: An interior-point solver for conic programs with
       quadratic objectives, 2024, arXiv:2405.12762.
    """
    import clarabel

    n, operator = start.size, problem.operator
    if isinstance(operator, Delassus):
        k = operator.mass.shape[0]
        quadratic = block_diag([csc_array((n, n)), operator.mass])
        balance = hstack([-operator.directions, operator.mass])
        positive = hstack([-eye_array(n), csc_array((n, k))])
        constraints = vstack([balance, positive])
        cones = [clarabel.ZeroConeT(k), clarabel.NonnegativeConeT(n)]
    else:
        k, quadratic, constraints = 0, operator.rows, -eye_array(n)
        cones = [clarabel.NonnegativeConeT(n)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    answer = clarabel.DefaultSolver(
        csc_array(triu(quadratic)),
        np.concatenate([problem.vector, np.zeros(k)]),
        csc_array(constraints),
        np.zeros(n + k),
        cones,
        settings,
    ).solve()
    x = np.maximum(np.array(answer.x)[:n], 0.0)
    yield x
    multiplier = np.array(answer.z)[k:]
    yield from islice(iterate_newton_min(problem, x, x > multiplier), POLISH_STEPS)
