"""Residuals of complementarity problems, and the verifier that alone decides on them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from multiscale.nonsmooth.lcp_problem import data_size, lcp_entries

__all__ = ["Verification", "lcp_verifier", "verify_lcp"]

SMALLEST_ROW = 1e-6
"""No row is measured against less than this part of the data."""

ROUNDING = 32.0 * np.finfo(float).eps
"""Error of a row, relative to its terms, that is put down to rounding."""

LARGEST_ROUNDING = 1e-6
"""Error, relative to the data, above which nothing is put down to rounding."""


@dataclass(frozen=True)
class Verification:
    """What an independent look at a solution finds.

    Attributes
    ----------
    error : float, largest natural-map error relative to the data, dimensionless
    worst : int, constraint with that error; -1 if there are no constraints
    penetration : float, largest negative part of w = M z + q, in the unit of q
    adhesion : float, largest negative part of z, in the unit of z
    """

    error: float
    worst: int
    penetration: float
    adhesion: float

    @property
    def residual(self) -> float:
        """Number to compare with a tolerance, dimensionless."""
        return self.error


def verify_lcp(
    matrix: csr_array | np.ndarray, vector: np.ndarray, value: np.ndarray
) -> Verification:
    r"""Measure how well :math:`z` solves :math:`0 \le M z + q \perp z \ge 0`.

    Parameters
    ----------
    matrix : csr_array or ndarray, shape (n, n), :math:`M`
    vector : ndarray, shape (n,), :math:`q`
    value : ndarray, shape (n,)
        :math:`z` to be judged; nothing but the data is used to judge it.

    Returns
    -------
    Verification, ``residual`` is what a tolerance is compared with

    Raises
    ------
    CaseError
        If the data are not finite or their shapes do not agree.

    Notes
    -----
    With :math:`d_i = |M_{ii}|^{-1/2}`, the pairs :math:`z_i / d_i` and :math:`d_i w_i` have one
    unit, and the error is

    .. math::
        \max_i \frac{|\min(z_i / d_i,\, d_i w_i)| - \rho_i}{s_i}, \qquad
        r_i = d_i \Bigl(|q_i| + \sum_j |M_{ij}| |z_j|\Bigr), \qquad
        \delta = \max_i d_i \max(0, -q_i).    \tag{1}

    :math:`\delta` is the error of :math:`z = 0`, so that a large gap elsewhere does not count
    as data. :math:`s_i` is :math:`r_i`, so that a row is judged by its own terms however large
    another load is, but not below :math:`10^{-6} \delta` and not above :math:`\delta`, so that
    a solution that runs away cannot pass. Where the terms of a row cancel, as with mass ratios
    and contrasts of 1e8, no computer can do better than :math:`\rho_i`: 32 units of rounding of
    :math:`r_i`, at most :math:`10^{-6} \delta`.

    Nothing changes under :math:`(M, q, z) \to (E M E, E q, E^{-1} z)` with a positive diagonal
    :math:`E`, nor under a change of units.

    Examples
    --------
    >>> verify_lcp(np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-2.0, 5.0]), np.array([1.0, 0.0]))
    Verification(error=0.0, worst=0, penetration=0.0, adhesion=0.0)
    """
    return lcp_verifier(matrix, vector)(value)


def lcp_verifier(
    matrix: csr_array | np.ndarray, vector: np.ndarray
) -> Callable[[np.ndarray], Verification]:
    """Prepare :func:`verify_lcp` for many values of one problem."""
    entries, vector = lcp_entries(matrix, vector)
    scale, absolute = entries.scale(), abs(entries.matrix)

    def verify(value: np.ndarray) -> Verification:
        if value.shape != vector.shape:
            raise ValueError(f"value must have shape {vector.shape}, got {value.shape}")
        if value.size == 0:
            return Verification(0.0, -1, 0.0, 0.0)
        slack = entries.matrix @ value + vector
        z, w, q = value / scale, scale * slack, scale * vector
        r = scale * (absolute @ np.abs(value))
        size = data_size(q) or float(np.max(r)) or 1.0  # delta
        row = np.abs(q) + r
        rounding = np.minimum(ROUNDING * row, LARGEST_ROUNDING * size)
        error = np.maximum(0.0, np.abs(np.minimum(z, w)) - rounding)  # (1)
        error /= np.clip(row, SMALLEST_ROW * size, size)
        error = np.where(np.isfinite(z) & np.isfinite(w), error, np.inf)
        worst = int(np.argmax(error))
        return Verification(
            float(error[worst]),
            worst,
            max(0.0, -float(np.min(slack))),
            max(0.0, -float(np.min(value))),
        )

    return verify
