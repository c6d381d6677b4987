"""Lemke's complementary pivoting with the lexicographic rule: the oracle for small problems."""

from collections.abc import Iterator
from itertools import islice

import numpy as np

from multiscale.nonsmooth.lcp_problem import ScaledLCP
from multiscale.nonsmooth.newton_min import iterate_newton_min
from multiscale.numerics.compiled import compiled

__all__ = ["iterate_pivoting"]

SMALLEST_PIVOT = 1e-10
"""Entry of an entering column, relative to its largest one, that counts as zero."""

TIE = 1e-12
"""Relative difference up to which two entries of the ratio test count as equal."""

FAR = 1e12
"""Length at which a ray is handed out."""


def iterate_pivoting(problem: ScaledLCP, start: np.ndarray) -> Iterator[np.ndarray]:
    r"""Yield x along the path of almost complementary bases.

    The path starts on the ray of a large :math:`x_0` in

    .. math:: w = A x + b + x_0 e \ge 0, \qquad x \ge 0, \qquad w^T x = 0,

    with :math:`e = 1`, and ends where :math:`x_0 = 0` or on a second ray. Ties of the ratio
    test, which a degenerate problem has, are broken by the rows of the inverse basis
    (lexicographically), so that no basis can come back. It ends at a solution for P-matrices,
    positive semidefinite and copositive matrices, whenever there is an admissible x.

    The path has a start of its own and yields x after every n / 20 pivots; in the end the solution,
    solved afresh from its active set, or a point far out on the second ray. Work and memory grow
    with the cube and the square of n.

    References
    ----------
    .. [1] C. E. Lemke, Manage. Sci. 11 (1965) 681-689, doi:10.1287/mnsc.11.7.681.
    .. [2] R. W. Cottle, J.-S. Pang and R. E. Stone, The Linear Complementarity Problem, SIAM
       2009, doi:10.1137/1.9780898719000. Sections 4.4 and 4.9.
    """
    n = start.size
    yield np.zeros(n)
    if np.all(problem.vector >= 0.0):
        return
    # columns: w, x, the artificial variable, the right-hand side
    tableau = np.empty((n, 2 * n + 2))
    tableau[:, :n] = np.eye(n)
    tableau[:, n : 2 * n] = -problem.entries.rows.toarray()
    tableau[:, 2 * n] = -1.0
    tableau[:, 2 * n + 1] = problem.vector
    basis = np.arange(n)
    leaving = n - 1 - int(np.argmin(problem.vector[::-1]))  # the last of equal ones: lexicographic
    entering = _exchange(tableau, basis, leaving, 2 * n)
    while entering >= 0 and 2 * n in basis:
        entering = _follow(tableau, basis, entering, max(1, n // 20))
        yield _point(tableau[:, -1], basis, n)
    if entering >= 0:
        active = np.isin(np.arange(n, 2 * n), basis)
        yield from islice(iterate_newton_min(problem, _point(tableau[:, -1], basis, n), active), 3)
    else:
        column = -1 - entering
        change = np.append(-tableau[:, column], 1.0)  # of the basic and the entering variable
        yield FAR * _point(change, np.append(basis, column), n)


def _point(values: np.ndarray, basis: np.ndarray, n: int) -> np.ndarray:
    """Put the values of the basic variables into x, without rounding below zero."""
    x = np.zeros(n)
    chosen = (basis >= n) & (basis < 2 * n)
    x[basis[chosen] - n] = np.maximum(values[chosen], 0.0)
    return x


@compiled
def _follow(tableau, basis, entering, pivots):  # type: ignore[no-untyped-def]
    """Change tableau and basis by some pivots; return what enters next, or -1 - it on a ray."""
    artificial = 2 * basis.size
    for _ in range(pivots):
        row = _leaving_row(tableau, basis, entering)
        if row < 0:
            return -1 - entering
        last = basis[row] == artificial
        entering = _exchange(tableau, basis, row, entering)
        if last:
            break
    return entering


@compiled
def _leaving_row(tableau, basis, entering):  # type: ignore[no-untyped-def]
    """Row of the lexicographically smallest ratio; -1 if the entering variable is unbounded."""
    n = basis.size
    largest = 0.0
    for i in range(n):
        largest = max(largest, abs(tableau[i, entering]))
    best = -1
    for i in range(n):
        if tableau[i, entering] <= SMALLEST_PIVOT * largest:
            continue
        if best < 0:
            best = i
            continue
        for step in range(-1, n):  # the right-hand side first, then the inverse basis
            column = step if step >= 0 else 2 * n + 1
            mine = tableau[i, column] / tableau[i, entering]
            other = tableau[best, column] / tableau[best, entering]
            if abs(mine - other) <= TIE * (abs(mine) + abs(other)):
                if step < 0 and basis[i] == 2 * n:  # a tie with the artificial one ends the path
                    best = i
                    break
                if step < 0 and basis[best] == 2 * n:
                    break
                continue
            if mine < other:
                best = i
            break
    return best


@compiled
def _exchange(tableau, basis, row, entering):  # type: ignore[no-untyped-def]
    """Pivot and return the complement of the variable that left."""
    n = basis.size
    columns, pivot = tableau.shape[1], tableau[row, entering]
    for k in range(columns):  # a slice would have the compiler write its error message
        tableau[row, k] /= pivot
    for i in range(n):
        factor = tableau[i, entering]
        if i != row and factor != 0.0:
            for k in range(columns):
                tableau[i, k] -= factor * tableau[row, k]
            tableau[i, entering] = 0.0
    left = basis[row]
    basis[row] = entering
    return left + n if left < n else left - n
