"""Newton's method on min(x, A x + b): primal-dual active sets that cannot cycle for ever."""

from collections.abc import Iterator

import numpy as np

from multiscale.nonsmooth.lcp_problem import ScaledLCP

__all__ = ["iterate_newton_min"]

SHIFT = 1e-13
"""Added to the unit diagonal of an active block, so that redundant constraints share."""

REFINEMENTS = 1
"""Corrections of the active unknowns after the first."""

ROUNDING = 1e-14
"""Negative part of an unknown or slack that does not count as a violation."""

FULL_STEPS = 8
"""Full steps without fewer violations before constraints are exchanged one at a time."""


def iterate_newton_min(
    problem: ScaledLCP, start: np.ndarray, active: np.ndarray | None = None
) -> Iterator[np.ndarray]:
    r"""Yield one x per active set.

    On the active set :math:`\mathcal A` the slack is zero, elsewhere x is:

    .. math::
        A_{\mathcal A \mathcal A}\, x_{\mathcal A} = -b_{\mathcal A}, \qquad
        \mathcal A \leftarrow \{i : x_i > (A x + b)_i\}.

    As long as the number of violated signs falls, all of them change the set at once (that is
    Newton's method). When it does not fall for eight steps, or a set comes back, only the last
    violated constraint changes, until the number falls below the least one met: for a P-matrix
    this ends at the solution. The iterates are without their negative parts; the last one has no
    violation, unless the block was singular: what its active unknowns keep is taken from the start,
    as is the first active set if not given.

    References
    ----------
    .. [1] M. Hintermüller, K. Ito and K. Kunisch, SIAM J. Optim. 13 (2002) 865-888,
       doi:10.1137/S1052623401383558. Newton's method and active sets.
    .. [2] J. J. Júdice and F. M. Pires, Comput. Oper. Res. 21 (1994) 587-596. The exchange of
       single constraints.
    """
    x = start
    if active is None:
        active = x > problem.slack(x)
    fewest, left, met = active.size + 1, FULL_STEPS, set[bytes]()
    while True:
        try:
            x = np.where(active, x, 0.0)
            if active.any():  # corrected until their slack is zero; the others are zero
                shift = np.full(np.count_nonzero(active), SHIFT)
                solve = problem.entries.solver(active, shift, problem.is_symmetric)
                for _ in range(1 + REFINEMENTS):
                    x[active] -= solve(problem.slack(x)[active])
        except RuntimeError:  # SuperLU met a pivot that is exactly zero
            return
        slack = problem.slack(x)
        yield np.maximum(x, 0.0)

        wrong = np.where(active, x, slack) < -ROUNDING
        violations = int(np.count_nonzero(wrong))
        if violations == 0 or not np.all(np.isfinite(x)):
            return
        left = FULL_STEPS if violations < fewest else left - 1
        fewest = min(fewest, violations)
        key = np.packbits(active).tobytes()
        if key in met:
            left = min(left, 0)
        met.add(key)
        if left <= 0:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        active = active ^ wrong
