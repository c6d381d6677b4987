"""Tangential traction of a point that sticks, or slides at Coulomb's limit."""

import numpy as np

__all__ = ["limit_traction"]

MAX_ITERATIONS, CLOSE = 60, 1e-15
"""Of Newton's method, and the relative change at which it ends."""

NEGLIGIBLE, TINY = 1e-14, 1e-150
"""Limit, relative to the traction without one, that is as good as none; and least divisor."""


def limit_traction(drive: np.ndarray, softness: np.ndarray, limit: np.ndarray) -> np.ndarray:
    r"""Find the tangential traction on a search direction, no larger than a limit.

    Parameters
    ----------
    drive, softness : ndarray, shape (2, ...)
        :math:`d` and :math:`a \ge 0`; only their ratio to each other has a unit, Pa.
    limit : ndarray, shape (...)
        :math:`\ell \ge 0`, Pa.

    Returns
    -------
    ndarray, shape (2, ...)
        Pa.

    Notes
    -----
    With the least :math:`\sigma \ge 0` that allows it,

    .. math:: t_i = \frac{d_i}{\sigma + a_i}, \qquad |t| \le \ell.    \tag{1}

    If :math:`a` is alike in both directions, so is the direction of :math:`t` and :math:`d`.
    Newton's method for :math:`1/|t| = 1/\ell`, which is nearly linear in :math:`\sigma`, climbs
    monotonically [1]_.

    References
    ----------
    .. [1] J. J. Moré, D. C. Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983) 553-572,
       doi:10.1137/0904038.
    """
    sigma = np.zeros(limit.shape)
    for _ in range(MAX_ITERATIONS):
        traction = drive / np.maximum(sigma + softness, TINY)  # (1)
        size = np.sqrt(np.sum(traction**2, axis=0))
        slides = (size > limit) & (limit > NEGLIGIBLE * size)
        along = traction / np.maximum(size, TINY)
        slope = np.sum(along**2 / np.maximum(sigma + softness, TINY), axis=0)
        rise = np.where(slides, size / np.where(slides, limit, 1.0) - 1.0, 0.0)
        step = rise / np.where(slides, slope, 1.0)
        if not np.any(step > CLOSE * sigma):
            break
        sigma = sigma + step
    return np.asarray(along * np.minimum(size, limit))
