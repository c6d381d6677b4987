"""Generalised minimal residuals with a preconditioner that may change."""

from collections.abc import Callable

import numpy as np

__all__ = ["minimal_residual"]

Operator = Callable[[np.ndarray], np.ndarray]


def minimal_residual(
    apply: Operator,
    right_hand_side: np.ndarray,
    precondition: Operator,
    *,
    goal: float,
    max_iterations: int = 60,
) -> tuple[np.ndarray, int]:
    r"""Solve :math:`A x = b` approximately by flexible GMRES without restart.

    Parameters
    ----------
    apply, precondition : callable
        :math:`A` and a fair inverse of it.
    right_hand_side : ndarray, shape (n,)
        :math:`b`.
    goal : float
        Norm of the residual at which to stop.
    max_iterations : int

    Returns
    -------
    solution : ndarray, shape (n,)
        The best in the space built, whether it meets the goal or not.
    iterations : int

    References
    ----------
    .. [1] Y. Saad, SIAM J. Sci. Comput. 14 (1993) 461-469, doi:10.1137/0914028.

    Examples
    --------
    >>> matrix = np.diag([1.0, 2.0, 4.0])
    >>> x, _ = minimal_residual(lambda v: matrix @ v, np.ones(3), lambda v: v, goal=1e-12)
    >>> x.round(6)
    array([1.  , 0.5 , 0.25])
    """
    norm = float(np.linalg.norm(right_hand_side))
    if not norm > goal:
        return np.zeros_like(right_hand_side), 0
    basis, searched = [right_hand_side / norm], []
    triangle = np.zeros((max_iterations, max_iterations))
    rest = np.zeros(max_iterations + 1)
    rest[0] = norm
    turns: list[tuple[float, float]] = []
    for k in range(max_iterations):
        searched.append(precondition(basis[k]))
        w = apply(searched[k])
        column = np.zeros(k + 2)
        for j in range(k + 1):
            column[j] = np.vdot(basis[j], w)
            w -= column[j] * basis[j]
        column[k + 1] = height = float(np.linalg.norm(w))
        for j, (c, s) in enumerate(turns):  # Givens rotations make the column triangular
            column[j], column[j + 1] = (
                c * column[j] + s * column[j + 1],
                c * column[j + 1] - s * column[j],
            )
        size = float(np.hypot(column[k], column[k + 1])) or 1.0
        c, s = column[k] / size, column[k + 1] / size
        turns.append((c, s))
        triangle[:k, k], triangle[k, k] = column[:k], size
        rest[k], rest[k + 1] = c * rest[k], -s * rest[k]
        if not abs(rest[k + 1]) > goal or not height > 1e-14 * norm:
            break
        basis.append(w / height)
    used = len(searched)
    weights = np.linalg.lstsq(triangle[:used, :used], rest[:used], rcond=None)[0]
    solution = np.zeros_like(right_hand_side)
    for weight, direction in zip(weights, searched, strict=True):
        solution += weight * direction
    return solution, len(searched)
