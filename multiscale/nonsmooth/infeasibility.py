"""Certificates that a linear complementarity problem has no admissible point."""

import numpy as np
from scipy.sparse import csr_array

from multiscale.nonsmooth.lcp_problem import ScaledLCP

__all__ = ["infeasibility_detail"]

FARTHEST = 1e9
"""Sum of the scaled unknowns, relative to the data, beyond which no solution is looked for."""

LARGEST_PROGRAM = 2000
"""Number of constraints up to which a linear program looks for the certificate."""


def infeasibility_detail(problem: ScaledLCP, last: list[np.ndarray]) -> str:
    r"""Find a Farkas certificate and say which constraint carries it; empty if there is none.

    No :math:`x \ge 0` with :math:`A x + b \ge 0` exists if and only if there is

    .. math:: y \ge 0, \qquad A^T y \le 0, \qquad b^T y < 0.    \tag{1}

    Tried are the directions in which the last iterates ran away and, for up to 2000 constraints,
    the answer of a linear program.
    """
    from scipy.optimize import linprog

    transposed = problem.entries.matrix.T
    for x in last:
        if np.all(np.isfinite(x)) and (detail := _judge(problem, transposed, x)):
            return detail
    if problem.vector.size > LARGEST_PROGRAM:
        return ""
    answer = linprog(
        problem.vector,
        A_ub=transposed,
        b_ub=np.zeros(problem.vector.size),
        bounds=(0.0, 1.0),
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10},
    )
    return _judge(problem, transposed, answer.x) if answer.x is not None else ""


def _judge(problem: ScaledLCP, transposed: csr_array | np.ndarray, y: np.ndarray) -> str:
    """Sentence for a y that satisfies (1) but for rounding; empty otherwise.

    Every admissible x has a sum of at least -b^T y / max(A^T y); y counts if that is out of reach.
    """
    largest = float(np.max(y, initial=0.0))
    if largest == 0.0:
        return ""
    y = np.maximum(y / largest, 0.0)
    power = float(problem.vector @ y)
    reach = float(np.max(transposed @ y))
    if power >= 0.0 or -power <= FARTHEST * reach:
        return ""
    return (
        f"constraint {int(np.argmax(y))} carries the largest entry of the Farkas certificate "
        f"(y >= 0, M^T y <= 0, q^T y < 0); relieve that constraint or support the body it pushes"
    )
