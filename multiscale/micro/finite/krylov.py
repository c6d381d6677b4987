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
    hessenberg = np.zeros((max_iterations + 1, max_iterations))
    weights: np.ndarray = np.zeros(0)
    for k in range(max_iterations):
        searched.append(precondition(basis[k]))
        w = apply(searched[k])
        for j in range(k + 1):
            hessenberg[j, k] = np.vdot(basis[j], w)
            w -= hessenberg[j, k] * basis[j]
        hessenberg[k + 1, k] = np.linalg.norm(w)
        small = hessenberg[: k + 2, : k + 1]
        target = np.zeros(k + 2)
        target[0] = norm
        weights = np.linalg.lstsq(small, target, rcond=None)[0]
        residual = float(np.linalg.norm(small @ weights - target))
        if not residual > goal or not hessenberg[k + 1, k] > 1e-14 * norm:
            break
        basis.append(w / hessenberg[k + 1, k])
    solution = np.zeros_like(right_hand_side)
    for weight, direction in zip(weights, searched, strict=True):
        solution += weight * direction
    return solution, len(searched)
