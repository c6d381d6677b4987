"""Linear complementarity problems: a single function for all methods."""

from collections.abc import Callable, Iterator
from time import perf_counter

import numpy as np
from scipy.sparse import csr_array

from multiscale.convergence import Solution, Status, check_limits
from multiscale.errors import CaseError
from multiscale.nonsmooth.lcp_methods import (
    iterate_interior_point,
    iterate_newton_min,
    iterate_pivoting,
)
from multiscale.nonsmooth.lcp_problem import ScaledLCP, lcp_verifier, scale_lcp
from multiscale.nonsmooth.refusals import (
    FIRST_LOOK,
    SMALL,
    THOROUGH,
    infeasibility_detail,
    refuse_indefinite,
)

LCP_METHODS: dict[str, Callable[[ScaledLCP, np.ndarray], Iterator[np.ndarray]]] = {
    "newton_min": iterate_newton_min,
    "interior_point": iterate_interior_point,
    "pivoting": iterate_pivoting,
}
"""Names of methods; ``"auto"`` uses all of them."""

INDEFINITE = (
    "matrix is symmetric but indefinite: its smallest eigenvalue, with the diagonal scaled to 1, "
    "is {value:.3g}, and constraint {worst} carries {share:.0%} of its vector; check the sign of "
    "that row, or use method='pivoting', which needs no definiteness"
)

NEGATIVE = 1e-6
"""Smallest eigenvalue of the scaled matrix, with its sign changed, that counts as negative."""

LARGEST_PIVOTING = 1000  # number of constraints up to which ``auto`` tries pivoting

PATIENCE = 100
"""Iterates without a halved residual after which a method that the caller names ends."""


@np.errstate(all="ignore")  # overflow makes the residual infinite
def solve_lcp(
    matrix: csr_array | np.ndarray,
    vector: np.ndarray,
    *,
    method: str = "auto",
    start: np.ndarray | None = None,
    max_iterations: int = 10_000,
    tolerance: float = 1e-10,
    callback: Callable[[int, float], None] | None = None,
) -> Solution:
    r"""Solve a linear complementarity problem.

    Find :math:`z` such that

    .. math:: w = M z + q, \qquad 0 \le w \perp z \ge 0.    \tag{1}

    Parameters
    ----------
    matrix : csr_array or ndarray, shape (n, n)
        :math:`M`, in any unit. A symmetric matrix must be positive semidefinite, and may be
        singular (redundant constraints, hyperstatic stacks).
    vector : ndarray, shape (n,), :math:`q`, in the unit of w
    method : str
        ``"auto"`` takes Newton-min (active sets), an interior point that ends with active sets,
        and for up to 1000 constraints pivoting, in this order, each for as long as the residual
        falls. ``"newton_min"``, ``"interior_point"`` and ``"pivoting"`` take only this method.
    start : ndarray, shape (n,), optional, first z, in the unit of z; zero if not given
    max_iterations : int
        Limit on the number of residuals, computed per factorisation or per n / 20 pivots.
    tolerance : float, bound on the error of :func:`verify_lcp`, dimensionless
    callback : callable, optional, called as ``callback(iteration, residual)``

    Returns
    -------
    Solution
        ``value`` is the z with the smallest residual, shape (n,). ``CONVERGED`` follows the
        verifier, ``INFEASIBLE`` comes with a certificate in ``detail``.

    Raises
    ------
    CaseError
        If data do not fit or are not finite, or M is symmetric but indefinite (``"pivoting"``
        takes it).

    Examples
    --------
    >>> solve_lcp(np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-2.0, 5.0])).unwrap()
    array([1., 0.])
    """
    check_limits(tolerance, max_iterations)
    started = perf_counter()
    verify = lcp_verifier(matrix, vector)
    problem = scale_lcp(matrix, vector)
    stages = _stages(problem, method)
    first = np.zeros(problem.vector.size) if start is None else np.asarray(start, dtype=float)
    if first.shape != problem.vector.shape:
        raise ValueError(f"start must have shape {problem.vector.shape}, got {first.shape}")
    if method != "pivoting":
        _refuse_indefinite(problem, SMALL if problem.vector.size <= SMALL else FIRST_LOOK)

    residuals, seconds, last = list[float](), list[float](), dict[str, np.ndarray]()
    best, smallest = first, np.inf
    for name, x in _iterates(problem, first / problem.unit, stages, residuals):
        last[name] = x
        z = problem.unit * x
        residuals.append(verify(z))
        seconds.append(perf_counter() - started)
        if callback is not None:
            callback(len(residuals) - 1, residuals[-1])
        if residuals[-1] < smallest:
            best, smallest = z, residuals[-1]
        if smallest <= tolerance or len(residuals) > max_iterations:
            break

    status, detail = Status.CONVERGED, ""
    if not smallest <= tolerance:
        # reason of the failure: no admissible point, an indefinite matrix, or neither
        status = Status.MAX_ITERATIONS if len(residuals) > max_iterations else Status.STALLED
        if detail := infeasibility_detail(problem.matrix, problem.vector, last.values()):
            status = Status.INFEASIBLE
        elif method != "pivoting":
            _refuse_indefinite(problem, THOROUGH)
        residuals.append(smallest)
        seconds.append(perf_counter() - started)
    return Solution(best, status, tuple(residuals), tuple(seconds), tuple(last), detail)


def _stages(problem: ScaledLCP, method: str) -> list[tuple[str, int]]:
    """Methods in turn, each until no iterate of a window halves the residual before it."""
    if method != "auto":
        if method not in LCP_METHODS:
            raise CaseError(f"method {method!r} does not exist; known: {['auto', *LCP_METHODS]}")
        return [(method, PATIENCE)]
    # active sets converge from anywhere where all couplings are negative
    stages = [
        ("newton_min", 20 if problem.has_negative_couplings else 4),
        ("interior_point", 80),
        ("pivoting", 1000),
    ]
    return stages if problem.vector.size <= LARGEST_PIVOTING else stages[:-1]


def _iterates(
    problem: ScaledLCP, start: np.ndarray, stages: list[tuple[str, int]], residuals: list[float]
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield method and iterate; the caller appends its residual, which selects the next method."""
    yield stages[0][0], start
    best, smallest = start, residuals[-1]
    for method, window in stages:
        entry, before = len(residuals), smallest
        for x in LCP_METHODS[method](problem, best):
            yield method, x
            if residuals[-1] < smallest:
                best, smallest = x, residuals[-1]
            history = [before, *residuals[entry:]]
            if len(history) > window and not (
                min(history[-window:]) <= 0.5 * min(history[:-window])
            ):
                break


def _refuse_indefinite(problem: ScaledLCP, steps: int) -> None:
    size = problem.vector.size
    if problem.is_symmetric and size > 0:
        refuse_indefinite(lambda x: problem.matrix @ x, size, steps, INDEFINITE, atol=NEGATIVE)
