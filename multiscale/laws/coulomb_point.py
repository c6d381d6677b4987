"""Tangential traction of a point that sticks or slides at Coulomb's limit."""

import numpy as np

__all__ = ["limit_traction"]

MAX_ITERATIONS, RELATIVE_CHANGE = 60, 1e-15
"""Iteration limit of Newton's method, and the relative change at which it stops."""

NEGLIGIBLE_LIMIT, LEAST_DIVISOR = 1e-14, 1e-150
"""Limit below which the traction is zero, relative to the unlimited traction; least divisor."""


def limit_traction(drive: np.ndarray, softness: np.ndarray, limit: np.ndarray) -> np.ndarray:
    r"""Find the tangential traction on a search direction, no larger than a limit.

    Parameters
    ----------
    drive, softness : ndarray, shape (2, ...)
        :math:`d` and :math:`a \ge 0`; their ratio is a traction, Pa.
    limit : ndarray, shape (...), limit :math:`\ell \ge 0`, Pa

    Returns
    -------
    ndarray, shape (2, ...), traction :math:`t`, Pa

    Notes
    -----
    With the least :math:`\sigma \ge 0` that satisfies the limit,

    .. math:: t_i = \frac{d_i}{\sigma + a_i}, \qquad |t| \le \ell.    \tag{1}

    If both components of :math:`a` are equal, :math:`t` and :math:`d` are parallel. Newton's method
    for :math:`1/|t| = 1/\ell`, which is nearly linear in :math:`\sigma`, increases monotonically
    [1]_.

    References
    ----------
    .. [1] J. J. Moré, D. C. Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983) 553-572,
       doi:10.1137/0904038.
    """
    sigma = np.zeros(limit.shape)
    for _ in range(MAX_ITERATIONS):
        traction = drive / np.maximum(sigma + softness, LEAST_DIVISOR)  # (1)
        size = np.sqrt(np.sum(traction**2, axis=0))
        slides = (size > limit) & (limit > NEGLIGIBLE_LIMIT * size)
        along = traction / np.maximum(size, LEAST_DIVISOR)
        slope = np.sum(along**2 / np.maximum(sigma + softness, LEAST_DIVISOR), axis=0)
        rise = np.where(slides, size / np.where(slides, limit, 1.0) - 1.0, 0.0)
        step = rise / np.where(slides, slope, 1.0)
        if not np.any(step > RELATIVE_CHANGE * sigma):
            break
        sigma = sigma + step
    return np.asarray(along * np.minimum(size, limit))
