"""Many small least-squares problems at once; plain arrays."""

from collections.abc import Callable

import numpy as np

__all__ = ["solve_many"]

DIFFERENCE = 1e-7  # of a coordinate, for the derivative
SMALLEST = 1e-300
SETTLED = 1e-8  # largest step, in the coordinates, of a problem that is settled
MAX_ITERATIONS = 40


def solve_many(
    residual: Callable[[np.ndarray], np.ndarray], shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    r"""Minimise the squares of many residuals of one form by the method of Levenberg and Marquardt.

    Parameters
    ----------
    residual : callable
        From the coordinates, shape (problems, coordinates), to the residuals, shape (problems,
        points); dimensionless, finite.
    shape : tuple of int
        Number of problems and of coordinates. All start at zero, which should be close.

    Returns
    -------
    coordinates : ndarray, shape (problems, coordinates)
    settled : ndarray of bool, shape (problems,)

    Notes
    -----
    With the derivative :math:`J` of the residual :math:`r` by differences, a step :math:`s` solves

    .. math:: (J^T J + \lambda\, \mathrm{diag}\, J^T J)\, s = -J^T r,    \tag{1}

    and each problem has its own :math:`\lambda`, divided by ten after a step that lowers its
    squares and multiplied by ten after one that does not and is taken back.
    """
    n, k = shape
    x, damping, settled = np.zeros(shape), np.full(n, 1e-4), np.zeros(n, dtype=bool)
    r = residual(x)
    for _ in range(MAX_ITERATIONS):
        moved = [residual(x + DIFFERENCE * axis) for axis in np.eye(k)]
        jacobian = (np.stack(moved, axis=-1) - r[..., None]) / DIFFERENCE
        normal = np.einsum("spi,spj->sij", jacobian, jacobian)
        diagonal = np.einsum("sii->si", normal)
        floor = 1e-12 * diagonal.max(axis=1, keepdims=True) + SMALLEST
        damped = normal + np.eye(k) * (damping[:, None] * np.maximum(diagonal, floor))[:, None]
        gradient = np.einsum("spi,sp->si", jacobian, r)
        step = -np.linalg.solve(damped, gradient[..., None])[..., 0]  # (1)
        trial = residual(x + step)
        small = np.max(np.abs(step), axis=1) <= SETTLED
        better = np.sum(trial**2, axis=1) <= np.sum(r**2, axis=1)
        x = np.where((better & ~settled)[:, None], x + step, x)
        r = np.where((better & ~settled)[:, None], trial, r)
        damping *= np.where(better, 0.1, 10.0)
        settled |= small
        if np.all(settled):
            break
    return x, settled
