"""Conjugate gradients, and generalised minimal residuals with a changing preconditioner."""

from collections.abc import Callable

import numpy as np
from numpy.linalg import norm

__all__ = ["conjugate_gradients", "minimal_residual"]

Operator = Callable[[np.ndarray], np.ndarray]


def conjugate_gradients(
    apply: Operator,
    right_hand_side: np.ndarray,
    precondition: Operator,
    *,
    goal: float,
    limit: int,
) -> tuple[np.ndarray, int]:
    r"""Solve :math:`A x = b` for a symmetric positive :math:`A` on arrays of any shape."""
    x, r, p = np.zeros_like(right_hand_side), right_hand_side.copy(), np.zeros_like(right_hand_side)
    rz_old = 1.0
    for iteration in range(limit):
        if not norm(r) > goal:
            return x, iteration
        z = precondition(r)
        rz = float(np.vdot(r, z))
        p = z + (rz / rz_old) * p
        q = apply(p)
        alpha = rz / float(np.vdot(p, q))
        x += alpha * p
        r -= alpha * q
        rz_old = rz
    return x, limit


def minimal_residual(
    apply: Operator, right_hand_side: np.ndarray, precondition: Operator, *, goal: float, room: int
) -> tuple[np.ndarray, int]:
    r"""Solve :math:`A x = b` approximately by flexible GMRES without restart.

    References
    ----------
    .. [1] Y. Saad, SIAM J. Sci. Comput. 14 (1993) 461-469, doi:10.1137/0914028.

    Examples
    --------
    >>> matrix = np.diag([1.0, 2.0, 4.0])
    >>> x, _ = minimal_residual(lambda v: matrix @ v, np.ones(3), np.copy, goal=1e-12, room=60)
    >>> x.round(6)
    array([1.  , 0.5 , 0.25])
    """
    from scipy.sparse.linalg import LinearOperator, gcrotmk

    iterations = 0

    def counted(vector: np.ndarray) -> np.ndarray:
        nonlocal iterations
        iterations += 1
        return precondition(vector)

    if not norm(right_hand_side) > goal:
        return np.zeros_like(right_hand_side), 0
    shape = 2 * right_hand_side.shape
    dtype = right_hand_side.dtype
    A, M = (LinearOperator(shape, product, dtype=dtype) for product in (apply, counted))
    x, _ = gcrotmk(A, right_hand_side, M=M, rtol=0.0, atol=goal, maxiter=1, m=room, k=1)
    return x, iterations
