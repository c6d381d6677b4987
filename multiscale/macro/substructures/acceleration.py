"""Anderson acceleration of a fixed-point iteration, with a way back."""

import numpy as np

from multiscale.macro.substructures.parallel import Team

__all__ = ["Anderson"]

MEMORY, WORSE, DAMPED, RELAXED = 16, 10.0, 0.5, 0.95
"""Kept iterates; residual, relative to the best, above which they are dropped; relaxation of the
step after that, and of all others."""

REGULAR = 1e-10


class Anderson:
    """Combine the last iterates so that their residual becomes least.

    Parameters
    ----------
    team : Team
        Processes that share the vectors.
    alone : int
        Entries from here on are the same in all processes and count once.

    References
    ----------
    .. [1] H. F. Walker, P. Ni, SIAM J. Numer. Anal. 49 (2011) 1715-1735, doi:10.1137/10078356X.
    """

    def __init__(self, team: Team, alone: int) -> None:
        self.team, self.alone = team, alone
        self.forget()

    def forget(self) -> None:
        """Drop the iterates, for a new problem."""
        self.points: list[np.ndarray] = []
        self.residuals: list[np.ndarray] = []
        self.best = np.inf

    def renew(self, where: np.ndarray, x: np.ndarray) -> None:
        """Let some entries of the iterates mean something else: those kept differ there no more.

        Parameters
        ----------
        where : ndarray of bool, shape (n,)
            The entries; if all, nothing is kept.
        x : ndarray, shape (n,)
            The next iterate in its new meaning.
        """
        if where.all():
            self.forget()
        for point, residual in zip(self.points, self.residuals, strict=True):
            point[where] = x[where]
            residual[where] = self.residuals[-1][where]

    def next(
        self, x: np.ndarray, image: np.ndarray, residual: np.ndarray, size: float
    ) -> np.ndarray:
        """Return the next iterate from the last one, its image and their distance."""
        if self.points and size > WORSE * self.best:
            self.forget()
            self.best = size
            return DAMPED * image + (1.0 - DAMPED) * x
        plain = RELAXED * image + (1.0 - RELAXED) * x
        self.points = [*self.points, plain][-MEMORY - 1 :]
        self.residuals = [*self.residuals, residual][-MEMORY - 1 :]
        self.best = min(size, self.best)
        if len(self.points) == 1:
            return plain
        change = residual[:, None] - np.array(self.residuals[:-1]).T
        matrix = self._products(change, change)
        scale = np.sqrt(matrix.diagonal())
        scale[scale == 0.0] = 1.0
        matrix = matrix / np.outer(scale, scale)
        matrix[np.diag_indices_from(matrix)] += REGULAR
        weight = np.linalg.solve(matrix, self._products(change, residual[:, None])[:, 0] / scale)
        step = (plain[:, None] - np.array(self.points[:-1]).T) @ (weight / scale)
        return np.asarray(plain - step)

    def _products(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Inner products of columns over all processes."""
        shared, own = slice(self.alone, None), slice(self.alone)
        return np.asarray(self.team.total(a[own].T @ b[own]) + a[shared].T @ b[shared])
