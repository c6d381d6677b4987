"""Conjugate gradients, flexible minimal residuals, and Anderson acceleration of fixed points."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.linalg import norm
from scipy.linalg import eigvalsh_tridiagonal

from multiscale.errors import MultiscaleError

WORSE, DAMPED = 10.0, 0.5
"""Residual, relative to the best, above which the iterates are dropped; relaxation after that."""

REGULAR = 1e-10  # added to the diagonal of the scaled inner products of the changes

Operator = Callable[[np.ndarray], np.ndarray]


def conjugate_gradients(
    apply: Operator,
    right_hand_side: np.ndarray,
    precondition: Operator,
    *,
    goal: float,
    limit: int,
    note: Callable[[float, float], object] = lambda length, share: None,
) -> tuple[np.ndarray, int]:
    """Solve :math:`A x = b` for a symmetric positive :math:`A` on arrays of any shape."""
    x, r, p = np.zeros_like(right_hand_side), right_hand_side.copy(), np.zeros_like(right_hand_side)
    rz_old = 1.0
    for iteration in range(limit):
        if not norm(r) > goal:
            return x, iteration
        z = precondition(r)
        rz = float(np.vdot(r, z))
        p = z + (rz / rz_old) * p
        q = apply(p)
        curvature = float(np.vdot(p, q))
        if curvature == 0.0:
            raise MultiscaleError(
                "conjugate gradients met a direction with a stiffness of 0, so that the matrix is "
                "singular; support all parts"
            )
        alpha = rz / curvature
        note(alpha, rz / rz_old)
        x += alpha * p
        r -= alpha * q
        rz_old = rz
    return x, limit


def ritz_values(steps: Sequence[tuple[float, float]]) -> np.ndarray:
    """Return the eigenvalues, rising, of the tridiagonal matrix of conjugate gradients."""
    if not steps:
        return np.zeros(0)
    length, share = np.array(steps).T
    if length.min() <= 0.0:  # the matrix is not positive
        return np.full(2, np.nan)
    diagonal = 1.0 / length
    diagonal[1:] += share[1:] / length[:-1]
    return np.asarray(eigvalsh_tridiagonal(diagonal, np.sqrt(share[1:]) / length[:-1]))


def minimal_residual(
    apply: Operator, right_hand_side: np.ndarray, precondition: Operator, *, goal: float, room: int
) -> tuple[np.ndarray, int]:
    """Solve A x = b by flexible GMRES."""
    # Y. Saad, SIAM J. Sci. Comput. 14 (1993) 461-469, doi:10.1137/0914028
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


class Anderson:
    """Combine the last ``memory`` iterates to the least residual, with a restart."""

    def __init__(
        self,
        memory: int,
        *,
        relaxation: float = 1.0,
        products: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda a, b: a.T @ b,
    ) -> None:
        self.memory, self.relaxation, self.products = memory, relaxation, products
        self.forget()

    def forget(self) -> None:
        """Drop the iterates, for a new problem."""
        self.points: list[np.ndarray] = []
        self.residuals: list[np.ndarray] = []
        self.best = np.inf

    def renew(self, where: np.ndarray, x: np.ndarray) -> None:
        """Set some entries of all iterates to a new value, where their meaning has changed."""
        if where.all():
            self.forget()
        for point, residual in zip(self.points, self.residuals, strict=True):
            point[where] = x[where]
            residual[where] = self.residuals[-1][where]

    def next(
        self, x: np.ndarray, image: np.ndarray, residual: np.ndarray, size: float
    ) -> np.ndarray:
        """Return the next iterate from the last iterate, its image and their distance."""
        # a much larger residual: restart with a damped step
        if self.points and size > WORSE * self.best:
            self.forget()
            self.best = size
            return DAMPED * image + (1.0 - DAMPED) * x
        # H. F. Walker, P. Ni, SIAM J. Numer. Anal. 49 (2011) 1715-1735,
        # doi:10.1137/10078356X
        plain = self.relaxation * image + (1.0 - self.relaxation) * x
        self.points = [*self.points, plain][-self.memory - 1 :]
        self.residuals = [*self.residuals, residual][-self.memory - 1 :]
        self.best = min(size, self.best)
        if len(self.points) == 1:
            return plain
        # least squares in the changes, scaled and regularised
        change = residual[:, None] - np.array(self.residuals[:-1]).T
        matrix = self.products(change, change)
        scale = np.sqrt(matrix.diagonal())
        scale[scale == 0.0] = 1.0
        matrix = matrix / np.outer(scale, scale)
        matrix[np.diag_indices_from(matrix)] += REGULAR
        weight = np.linalg.solve(matrix, self.products(change, residual[:, None])[:, 0] / scale)
        step = (plain[:, None] - np.array(self.points[:-1]).T) @ (weight / scale)
        return np.asarray(plain - step)
