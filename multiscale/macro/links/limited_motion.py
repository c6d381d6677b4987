"""Balance of momentum of a time step under limits of rates, by Newton's method."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from multiscale.convergence import Solution
from multiscale.nonsmooth import solve_lcp
from multiscale.numerics.factorisation import Solve
from multiscale.numerics.newton import Limits, NewtonRun, step_length

__all__ = ["MomentumBalance", "largest", "limited_motion"]

MAX_ITERATIONS = 50

TOLERANCE = 1e-12
"""Bound on the momentum out of balance, relative to the largest; raised to the rounding error."""

UNDERFLOW_LIMIT = float(np.sqrt(np.finfo(float).tiny))
"""Momentum, N s, or rate, m/s, below which the energy of a motion underflows."""


class MomentumBalance(NamedTuple):
    r"""Momentum of a step without impulses: the gradient of a convex function of the velocity.

    Attributes
    ----------
    momentum : ndarray, shape (n,), :math:`g(y)`, N s
    stiffness : ndarray, shape (rows,)
        Stiffness of the links in the tangent of g, times squared steps, kg.
    largest, rounding : float, largest term of the sum, and its rounding error, N s
    """

    momentum: np.ndarray
    stiffness: np.ndarray
    largest: float
    rounding: float


def limited_motion(
    balance: Callable[[np.ndarray], MomentumBalance],
    factorise: Callable[[np.ndarray], Solve],
    start: np.ndarray,
    limits: tuple[csr_array, np.ndarray, np.ndarray],
) -> Solution:
    r"""Solve the balance of momentum under the limits (A, b, C) of the rates.

    Notes
    -----
    The solution (y, p) of

    .. math:: g(y) + A^T p = 0, \qquad 0 \le p \perp b - A y + C p \ge 0    \tag{1}

    is the minimum of a convex function with the gradient :math:`(g, C p)` under
    :math:`A y - C p \le b`. Newton's method linearises g, condenses y, solves the complementarity
    problem for p and searches along the step.
    """
    A, bound, C = limits
    columns = A.T.toarray()
    n = start.size

    def slope(x: np.ndarray, dx: np.ndarray, share: float) -> float:
        y, p = np.split(x + share * dx, [n])
        return float(dx[:n] @ balance(y).momentum + dx[n:] @ (C @ p))

    p, accuracy = np.zeros_like(bound), 0.0
    x = np.append(start, p)
    now = balance(start)
    run = NewtonRun(Limits(MAX_ITERATIONS, TOLERANCE))
    while True:
        # linearised balance: rates y without and with the impulses p
        solve = factorise(now.stiffness)
        y = x[:n] - solve(now.momentum + columns @ x[n:])
        if bound.size:
            give = solve(columns)
            rates = bound - A @ (y + give @ x[n:])
            rates[np.abs(rates) < UNDERFLOW_LIMIT] = 0.0
            impulses = solve_lcp(A @ give + C, rates, start=x[n:])
            p, accuracy = impulses.value, impulses.residuals[-1]
            y = y - give @ (p - x[n:])
            if not impulses.converged:
                return Solution(np.append(y, p), impulses.status, (*run.residuals, accuracy))

        # residual of (1) at the full step
        new = balance(y)
        size = max(new.largest, largest(p), UNDERFLOW_LIMIT)
        residual = largest(new.momentum + columns @ p) / size
        if not run.goes_on(residual, new.rounding / size):
            last = max(residual, accuracy)
            return Solution(np.append(y, p), run.status, (*run.residuals[:-1], last))

        # line search; a full first step meets the limits, which the start need not
        dx = np.append(y, p) - x
        if run.steps or not bound.size:
            length = step_length(partial(slope, x, dx), slope(x, dx, 0.0))
            dx = (min(length, 1.0) if bound.size else length) * dx
        x = x + dx
        now = balance(x[:n])


def largest(vector: np.ndarray) -> float:
    """Return the largest absolute entry, zero if there are none."""
    return float(np.abs(vector).max(initial=0.0))
