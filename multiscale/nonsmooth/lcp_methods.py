"""Iterations for linear complementarity problems: active sets, interior point, pivoting."""

from collections.abc import Iterator
from itertools import islice

import numpy as np

from multiscale.nonsmooth.lcp_problem import ScaledLCP
from multiscale.numerics.compiled import compiled
from multiscale.numerics.factorisation import Solve

SHIFT = 1e-13  # added to the unit diagonal of an active block, so that redundant constraints share
REFINEMENTS = 1  # corrections of the active unknowns after the first
ROUNDING = 1e-14  # negative part of an unknown or slack that does not count as a violation
FULL_STEPS = 8  # full steps without fewer violations before constraints are exchanged singly

SETTLED = 1e-3
"""Share of the constraints that may change sides in a step if the active set is to be tried."""

NEXT_TRIAL = 1e-2  # factor by which the gap must fall between trials of the active set
POLISH_STEPS = 3  # active sets per trial

SMALLEST_GAP, SHORTEST_STEP = 1e-24, 1e-10
"""Complementarity gap and step length below which the interior point ends."""

CORRECTIONS = 2  # corrections of the centrality per factorisation, each for a further solve
LONGEST = 1e10  # length of a step without a limit

SMALLEST_PIVOT = 1e-10
"""Entry of an entering column, relative to its largest entry, that counts as zero."""

CANCELLED = 1e-12  # part of a number that is left where it cancels
TIE = 1e-12  # relative difference up to which two entries of the ratio test count as equal
FAR = 1e12  # distance along a ray at which its last point lies


def iterate_newton_min(
    problem: ScaledLCP, start: np.ndarray, active: np.ndarray | None = None
) -> Iterator[np.ndarray]:
    r"""Yield an x per active set: Newton's method on :math:`\min(x, A x + b)`."""
    x = start
    if active is None:
        active = x > problem.slack(x)
    fewest, left, met = active.size + 1, FULL_STEPS, set[bytes]()
    while True:
        # active unknowns, corrected until their slack is zero; the others are zero
        try:
            x = np.where(active, x, 0.0)
            if active.any():
                solve = problem.factorise(active, np.full(np.count_nonzero(active), SHIFT))
                for _ in range(1 + REFINEMENTS):
                    x[active] -= solve(problem.slack(x)[active])
        except RuntimeError:  # SuperLU met a pivot that is exactly zero
            return
        slack = problem.slack(x)
        yield np.maximum(x, 0.0)

        # M. Hintermüller, K. Ito, K. Kunisch, SIAM J. Optim. 13 (2002) 865-888,
        # doi:10.1137/S1052623401383558; the single change ends for P-matrices: J. J. Júdice,
        # F. M. Pires, Comput. Oper. Res. 21 (1994) 587-596
        # next set: all violations change sides, or only the last after too many steps
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


def iterate_interior_point(problem: ScaledLCP, start: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the x of Mehrotra's interior iterates, and of the active sets that they suggest."""
    n, everywhere = start.size, np.ones(start.size, dtype=bool)
    x, w = np.ones(n), np.ones(n)
    active, gap, next_trial = x > w, 1.0, np.inf
    while gap > SMALLEST_GAP:
        yield x
        # try the active set once few constraints change sides
        changed = np.count_nonzero(active != (x > w))
        active = x > w
        if active.any() and changed <= SETTLED * n and gap < next_trial:
            next_trial = NEXT_TRIAL * gap
            yield from islice(iterate_newton_min(problem, x, active), POLISH_STEPS)

        # S. Mehrotra, SIAM J. Optim. 2 (1992) 575-601; J. Gondzio, Comput. Optim. Appl. 6 (1996)
        # 137-156
        # Newton step that stops short of the boundary
        try:
            solve = problem.factorise(everywhere, w / x)
        except RuntimeError:  # SuperLU met a pivot that is exactly zero
            return
        dx, dw = _mehrotra_direction(problem, x, w, gap, solve)
        step = min(1.0, max(0.9, 1.0 - gap) * _longest(x, w, dx, dw))
        if not step > SHORTEST_STEP:
            return
        x, w = x + step * dx, w + step * dw
        gap = float(x @ w) / n


def _mehrotra_direction(
    problem: ScaledLCP, x: np.ndarray, w: np.ndarray, gap: float, solve: Solve
) -> tuple[np.ndarray, np.ndarray]:
    """Predictor, corrector and corrections of centrality with a single factorisation."""
    mismatch = problem.slack(x) - w

    def newton(complementarity: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        target_w = complementarity / x - w
        change = solve(target_w - mismatch)
        return change, target_w - w / x * change  # (1)

    # predictor
    dx, dw = newton(0.0)
    step = min(1.0, _longest(x, w, dx, dw))
    target = ((x + step * dx) @ (w + step * dw) / (x.size * gap)) ** 3 * gap

    # corrector
    complementarity = target - dx * dw
    dx, dw = newton(complementarity)
    step = min(1.0, _longest(x, w, dx, dw))

    # corrections of centrality, as long as they lengthen the step
    for _ in range(CORRECTIONS):
        trial = min(1.0, 1.08 * step + 0.08)  # intended step length
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
    return min(longest_positive(x, dx), longest_positive(w, dw))


def longest_positive(x: np.ndarray, direction: np.ndarray) -> float:
    """Longest step along a direction for which positive numbers stay positive."""
    falling = direction < 0.0
    return float(np.min(-x[falling] / direction[falling], initial=LONGEST))


def iterate_pivoting(problem: ScaledLCP, start: np.ndarray) -> Iterator[np.ndarray]:
    """Yield x along Lemke's path with the lexicographic rule."""
    n = start.size
    yield np.zeros(n)
    if np.all(problem.vector >= 0.0):
        return
    # the path of 0 <= A x + b + x_0 perp x >= 0 ends at x_0 = 0 for P-matrices, and for positive
    # semidefinite or copositive matrices if there is an admissible x: Cottle, Pang, Stone, The
    # Linear Complementarity Problem, SIAM 2009, 4.4, 4.9, doi:10.1137/1.9780898719000
    # columns: w, x, the artificial variable, the right-hand side
    matrix = problem.matrix
    tableau = np.empty((n, 2 * n + 2))
    tableau[:, :n] = np.eye(n)
    tableau[:, n : 2 * n] = -(matrix if isinstance(matrix, np.ndarray) else matrix.toarray())
    tableau[:, 2 * n] = -1.0
    tableau[:, 2 * n + 1] = problem.vector
    basis = np.arange(n)
    # lexicographic rule: the last of equal entries
    leaving = n - 1 - int(np.argmin(problem.vector[::-1]))
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
    """Return x from the values of the basic variables, without rounding below zero."""
    x = np.zeros(n)
    chosen = (basis >= n) & (basis < 2 * n)
    x[basis[chosen] - n] = np.maximum(values[chosen], 0.0)
    return x


@compiled
def _follow(tableau, basis, entering, pivots):  # type: ignore[no-untyped-def]
    """Pivot some times; return the entering variable, or -1 minus it on a ray."""
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
            ratio = tableau[i, column] / tableau[i, entering]
            other = tableau[best, column] / tableau[best, entering]
            if abs(ratio - other) <= TIE * (abs(ratio) + abs(other)):
                # a tie with the artificial variable ends the path
                if step < 0 and basis[i] == 2 * n:
                    best = i
                    break
                if step < 0 and basis[best] == 2 * n:
                    break
                continue
            if ratio < other:
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
                before = tableau[i, k]
                after = before - factor * tableau[row, k]
                # the rounding error of a difference would hide a tie
                tableau[i, k] = after if abs(after) > CANCELLED * abs(before) else 0.0
            tableau[i, entering] = 0.0
    left = basis[row]
    basis[row] = entering
    return left + n if left < n else left - n
