r"""Certificates that impulses cannot open contacts, where a friction problem stays unsolved."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import bsr_array, csc_array, diags_array, eye_array, vstack

from multiscale.convergence import Status
from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.nonsmooth.refusals import FARTHEST

__all__ = ["jamming", "solve_conic"]

LARGEST_PROGRAM = 20_000
"""Number of blocks of W up to which a conic program looks for the certificate."""

TOLERANCE = 1e-12
"""Gap and feasibility asked of clarabel, on scaled data."""


def jamming(problem: ScaledFriction) -> tuple[Status, str] | None:
    r"""Return why a problem has, or may have, no solution; None without a certificate.

    Notes
    -----
    Let :math:`y \in K_\mu` be impulses that move nothing although their contacts close,

    .. math:: W y = 0, \qquad q^T y < 0.    \tag{1}

    A solution has :math:`\tilde u = W r + q + \mu \|u_T\| n \in K_\mu^*`, so that

    .. math:: 0 \le y^T \tilde u = q^T y + \sum_i \mu_i \|u_{T,i}\|\, y_{N,i}.    \tag{2}

    If y is normal, no solution exists: :math:`u_N = (W r + q)_N \ge 0` fails by (1). (By Farkas'
    lemma such a y exists if and only if no impulses open the contacts: :math:`-W y` in the dual
    cone, together with :math:`y^T W y \ge 0`, is :math:`W y = 0`.) If y has friction, (2) bounds
    the sliding from below, and existence is open: the condition of [1]_ for it fails.

    Both are conic programs, :math:`\min q^T y` under :math:`W y = 0` and :math:`\sum y_N \le 1`.
    An answer y counts if the impulses that could undo (1), at least
    :math:`-q^T y / \max_i (g_N + \mu \|g_T\|)_i` with :math:`g = W y`, are out of reach.

    References
    ----------
    .. [1] V. Acary, F. Cadoux, C. Lemaréchal and J. Malick, Z. Angew. Math. Mech. 91 (2011)
       155-175, doi:10.1002/zamm.201000073.
    """
    if problem.columns.size > LARGEST_PROGRAM:
        return None
    response = replace(problem, velocity=np.zeros_like(problem.velocity))
    for rubs, status, impulses, remedy in (
        (False, Status.INFEASIBLE, "normal impulses", "let a body between them give"),
        (True, Status.JAMMED, "impulses with friction", "let a body give, or lower the friction"),
    ):
        y = _least_work(problem, rubs)
        g = response.respond(y)
        undone = float(np.max(g[:, 0] + problem.friction * np.hypot(g[:, 1], g[:, 2])))
        work = float(np.sum(problem.velocity * y))
        rounding = float(np.sum(np.abs(problem.velocity * y))) / FARTHEST
        if -work > max(FARTHEST * undone, rounding):
            carrying = np.flatnonzero(y[:, 0] > 0.1 * np.max(y[:, 0]))
            return status, (
                f"{impulses} at {carrying.size} contacts, contact {carrying[0]} among them, "
                f"balance each other and move nothing, while these contacts close; {remedy}"
            )
    return None


def _least_work(problem: ScaledFriction, rubs: bool) -> np.ndarray:
    """Minimum of q^T y under W y = 0 and sum y_N <= 1 in the cone or on its axis."""
    n = problem.friction.size
    W = csc_array(bsr_array((problem.blocks, problem.columns, problem.starts)))
    carries = np.arange(3 * n) % 3 == 0
    total = csc_array(carries[None].astype(float))
    cone = diags_array(-np.where(carries, np.repeat(problem.friction, 3), 1.0))
    if not rubs:
        W, total, cone = W[:, carries], total[:, carries], -eye_array(n)
    constraints = csc_array(vstack([W, total, cone]))
    limits = np.zeros(constraints.shape[0])
    limits[3 * n] = 1.0
    size = constraints.shape[1]
    velocity = problem.velocity.ravel() if rubs else problem.velocity[:, 0]
    answer = solve_conic(
        csc_array((size, size)),
        velocity,
        constraints,
        limits,
        zero=3 * n,
        positive=1 if rubs else n + 1,
        friction=n if rubs else 0,
    )
    y = np.zeros((n, 3))
    y.reshape(-1)[slice(None) if rubs else carries] = answer.x
    y[:, 0] = np.maximum(y[:, 0], 0.0)
    return y / (np.max(y[:, 0]) or 1.0)


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
