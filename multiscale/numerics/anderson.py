"""Anderson acceleration of a fixed-point iteration, with a restart."""

from collections.abc import Callable

import numpy as np

__all__ = ["Anderson"]

WORSE, DAMPED = 10.0, 0.5
"""Residual, relative to the best, above which the iterates are dropped; relaxation after that."""

REGULAR = 1e-10
"""Added to the diagonal of the scaled inner products of the changes."""


class Anderson:
    """Combine the last iterates to the least residual.

    Parameters
    ----------
    memory : int, number of iterates before the last one
    relaxation : float, share of an image in the next iterate; the rest is the last iterate
    products : callable, inner products of the columns of two arrays (n, k) and (n, m), shape (k, m)

    References
    ----------
    .. [1] H. F. Walker, P. Ni, SIAM J. Numer. Anal. 49 (2011) 1715-1735, doi:10.1137/10078356X.
    """

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
        """Return the next iterate from the last one, its image and their distance."""
        # a much larger residual: restart with a damped step
        if self.points and size > WORSE * self.best:
            self.forget()
            self.best = size
            return DAMPED * image + (1.0 - DAMPED) * x
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
