"""Linear complementarity problems: one call for all methods."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from scipy.sparse import csr_array

from multiscale.convergence import Solution, Status, check_limits
from multiscale.errors import CaseError
from multiscale.nonsmooth.complementarity import lcp_verifier
from multiscale.nonsmooth.infeasibility import infeasibility_detail
from multiscale.nonsmooth.lcp_interior_point import iterate_interior_point
from multiscale.nonsmooth.lcp_problem import ScaledLCP, scale_lcp
from multiscale.nonsmooth.newton_min import iterate_newton_min
from multiscale.nonsmooth.pivoting import iterate_pivoting
from multiscale.nonsmooth.projected_gradient import iterate_projected_gradient
from multiscale.nonsmooth.spectrum import FIRST_LOOK, SMALL, THOROUGH, refuse_indefinite

__all__ = ["solve_lcp"]

LCP_METHODS: dict[str, Callable[[ScaledLCP, np.ndarray], Iterator[np.ndarray]]] = {
    "projected_gradient": iterate_projected_gradient,
    "newton_min": iterate_newton_min,
    "interior_point": iterate_interior_point,
    "pivoting": iterate_pivoting,
}

PATIENCE = 100
"""Iterates without a residual cut to a half after which a method that is alone gives up."""

INDEFINITE = (
    "matrix is symmetric but indefinite: its smallest eigenvalue, with the diagonal scaled to one, "
    "is {value:.3g}, and constraint {worst} carries {share:.0%} of its vector; check the sign of "
    "that row, or use method='pivoting', which needs no definiteness"
)

NEGATIVE = 1e-6
"""Smallest eigenvalue of the scaled matrix, with its sign changed, that counts as negative."""

LARGEST_PIVOTING = 1000
"""Number of constraints up to which ``auto`` tries pivoting."""


@dataclass(frozen=True)
class _Stage:
    """A method, and the progress that it must make to stay."""

    method: str
    window: int
    factor: float = 0.5


GRADIENTS = _Stage("projected_gradient", window=40, factor=0.3)
ACTIVE_SETS = _Stage("newton_min", window=4)
MONOTONE_SETS = _Stage("newton_min", window=20)
INTERIOR = _Stage("interior_point", window=80)
PIVOTS = _Stage("pivoting", window=1000)


@np.errstate(all="ignore")  # an overflow shows in the residual
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
        ``"auto"`` takes conjugate projected gradients (if M is symmetric), Newton-min (active
        sets), an interior point that ends with active sets, and for up to 1000 constraints
        pivoting, in this order, each for as long as the residual falls.
        ``"projected_gradient"``, ``"newton_min"``, ``"interior_point"`` and ``"pivoting"`` take
        only this method.
    start : ndarray, shape (n,), optional, first z, in the unit of z; zero if not given
    max_iterations : int
        Limit on the number of residuals: one per ten gradient steps, per
        factorisation, or per n / 20 pivots.
    tolerance : float
        Bound on the residual of :func:`verify_lcp`, relative to the data; dimensionless.
    callback : callable, optional, called as ``callback(iteration, residual)``

    Returns
    -------
    Solution
        ``value`` is the z with the smallest residual, shape (n,). ``CONVERGED`` is what the
        verifier says, ``INFEASIBLE`` comes with a certificate in ``detail``.

    Raises
    ------
    CaseError
        If the matrix is not square, the vector does not fit, an entry is not finite, the matrix
        is symmetric but indefinite (``"pivoting"`` takes it), or the method does not exist or
        requires a symmetric matrix.
    ValueError
        If ``start`` does not fit.

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
        residuals.append(verify(z).residual)
        seconds.append(perf_counter() - started)
        if callback is not None:
            callback(len(residuals) - 1, residuals[-1])
        if residuals[-1] < smallest:
            best, smallest = z, residuals[-1]
        if smallest <= tolerance or len(residuals) > max_iterations:
            break

    status, detail = Status.CONVERGED, ""
    if not smallest <= tolerance:
        status = Status.MAX_ITERATIONS if len(residuals) > max_iterations else Status.STALLED
        if detail := infeasibility_detail(problem, list(last.values())):
            status = Status.INFEASIBLE
        elif method != "pivoting":
            _refuse_indefinite(problem, THOROUGH)
        residuals.append(smallest)
        seconds.append(perf_counter() - started)
    return Solution(best, status, tuple(residuals), tuple(seconds), tuple(last), detail)


def _stages(problem: ScaledLCP, method: str) -> list[_Stage]:
    """Methods to take in turn."""
    if method != "auto":
        if method not in LCP_METHODS:
            raise CaseError(f"method {method!r} does not exist; known: {['auto', *LCP_METHODS]}")
        if method == "projected_gradient" and not problem.is_symmetric:
            raise CaseError(
                f"method {method!r} needs a symmetric matrix, but mirrored entries differ; use "
                f"method='interior_point'"
            )
        return [_Stage(method, PATIENCE)]
    gradients = [GRADIENTS] if problem.is_symmetric else []
    sets = MONOTONE_SETS if problem.has_negative_couplings else ACTIVE_SETS
    pivots = [PIVOTS] if problem.vector.size <= LARGEST_PIVOTING else []
    return [*gradients, sets, INTERIOR, *pivots]


def _iterates(
    problem: ScaledLCP, start: np.ndarray, stages: list[_Stage], residuals: list[float]
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield method and iterate; the caller appends its residual, which decides what follows."""
    yield stages[0].method, start
    best, smallest = start, residuals[-1]
    for stage in stages:
        entry, before = len(residuals), smallest
        for x in LCP_METHODS[stage.method](problem, best):
            yield stage.method, x
            if residuals[-1] < smallest:
                best, smallest = x, residuals[-1]
            own = [before, *residuals[entry:]]  # the latest have to fall well below the earlier
            if len(own) > stage.window and not (
                min(own[-stage.window :]) <= stage.factor * min(own[: -stage.window])
            ):
                break


def _refuse_indefinite(problem: ScaledLCP, steps: int) -> None:
    """Refuse a symmetric matrix of given entries with a clearly negative eigenvalue."""
    size = problem.vector.size
    if problem.is_symmetric and size > 0:
        matrix = problem.entries.matrix
        refuse_indefinite(lambda x: matrix @ x, size, steps, INDEFINITE, atol=NEGATIVE)
