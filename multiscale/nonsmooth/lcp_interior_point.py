"""Mehrotra's primal-dual interior point for monotone linear complementarity problems."""

from collections.abc import Iterator
from itertools import islice

import numpy as np

from multiscale.nonsmooth.lcp_problem import ScaledLCP
from multiscale.nonsmooth.lorentz import longest_positive
from multiscale.nonsmooth.newton_min import iterate_newton_min
from multiscale.numerics.factorisation import Solve

__all__ = ["iterate_interior_point"]

SETTLED = 1e-3
"""Part of the constraints that may change sides in a step if the active set is to be tried."""

NEXT_TRIAL = 1e-2
"""Factor by which the gap must fall from one trial of the active set to the next."""

POLISH_STEPS = 3
"""Active sets that one trial may take."""

SMALLEST_GAP = 1e-24
"""Gap below which the iteration has nothing left to gain."""

SHORTEST_STEP = 1e-10
"""Step length below which the iteration has stopped."""

CORRECTIONS = 2
"""Corrections of the centrality per factorisation, each for one more solve."""


def iterate_interior_point(problem: ScaledLCP, start: np.ndarray) -> Iterator[np.ndarray]:
    r"""Yield the x of every interior iterate, and of the active sets that it suggests.

    A Newton step towards :math:`w = A x + b,\ x_i w_i = t_i` is, with
    :math:`T = \mathrm{diag}(w_i / x_i)` and the complementarity :math:`c` that the step leaves,

    .. math::
        (A + T)\, \Delta x = c / x - w - (A x + b - w), \qquad
        \Delta w = c / x - w - T \Delta x.    \tag{1}

    The predictor has :math:`c = 0`; its step gives :math:`\sigma = (\mu^a / \mu)^3` and the
    corrector :math:`c = \sigma\mu - \Delta x^a \Delta w^a`; then products that a longer step
    would leave far from :math:`\sigma\mu` are drawn back. All share one factorisation, and both
    unknowns one step length, because the matrix couples them. The iteration ends where the gap
    :math:`\mu = x^T w / n` or the step vanishes. The problem is monotone: the symmetric part of the
    matrix has no negative eigenvalue. The start is not used: an iterate near the boundary is a bad
    start for an interior method.

    References
    ----------
    .. [1] S. Mehrotra, SIAM J. Optim. 2 (1992) 575-601, doi:10.1137/0802028.
    .. [2] J. Gondzio, Comput. Optim. Appl. 6 (1996) 137-156, doi:10.1007/BF00249643. The
       corrections of centrality.
    """
    n, everywhere = start.size, np.ones(start.size, dtype=bool)
    x, w = np.ones(n), np.ones(n)
    active, gap, next_trial = x > w, 1.0, np.inf
    while gap > SMALLEST_GAP:
        yield x
        changed = np.count_nonzero(active != (x > w))
        active = x > w
        if active.any() and changed <= SETTLED * n and gap < next_trial:
            next_trial = NEXT_TRIAL * gap
            yield from islice(iterate_newton_min(problem, x, active), POLISH_STEPS)

        try:
            solve = problem.entries.solver(everywhere, w / x, problem.is_symmetric)
        except RuntimeError:  # SuperLU met a pivot that is exactly zero
            return
        dx, dw = _step(problem, x, w, gap, solve)
        step = min(1.0, max(0.9, 1.0 - gap) * _longest(x, w, dx, dw))
        if not step > SHORTEST_STEP:
            return
        x, w = x + step * dx, w + step * dw
        gap = float(x @ w) / n


def _step(
    problem: ScaledLCP, x: np.ndarray, w: np.ndarray, gap: float, solve: Solve
) -> tuple[np.ndarray, np.ndarray]:
    """Predictor, corrector and corrections of centrality with one factorisation."""
    mismatch = problem.slack(x) - w

    def newton(complementarity: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        wanted = complementarity / x - w
        change = solve(wanted - mismatch)
        return change, wanted - w / x * change  # (1)

    dx, dw = newton(0.0)
    step = min(1.0, _longest(x, w, dx, dw))
    target = ((x + step * dx) @ (w + step * dw) / (x.size * gap)) ** 3 * gap

    complementarity = target - dx * dw
    dx, dw = newton(complementarity)
    step = min(1.0, _longest(x, w, dx, dw))
    for _ in range(CORRECTIONS):
        trial = min(1.0, 1.08 * step + 0.08)  # the step length that is aimed at
        products = (x + trial * dx) * (w + trial * dw)
        drawn = np.clip(products, 0.1 * target, 10.0 * target) - products
        corrected = complementarity + np.maximum(drawn, -10.0 * target)
        dx_new, dw_new = newton(corrected)
        step_new = min(1.0, _longest(x, w, dx_new, dw_new))
        if step_new < step + 0.01:
            break
        dx, dw, step, complementarity = dx_new, dw_new, step_new, corrected
    return dx, dw


def _longest(x: np.ndarray, w: np.ndarray, dx: np.ndarray, dw: np.ndarray) -> float:
    """Longest step that keeps x and w positive."""
    return min(longest_positive(x, dx), longest_positive(w, dw))
