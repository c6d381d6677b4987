"""Linear complementarity problems: checked data, the form without units, and the verifier."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgWarning, lu_factor, lu_solve
from scipy.sparse import csc_array, csr_array, diags_array, issparse
from scipy.sparse.linalg import splu

from multiscale.errors import CaseError
from multiscale.nonsmooth.refusals import refuse_out_of_range
from multiscale.numerics.factorisation import Solve, symmetric_lu

DENSE = 0.2  # fraction of nonzero entries above which a matrix is factorised as a dense matrix

SYMMETRY = 1e-6
"""Difference of mirrored entries of the scaled matrix up to which it counts as symmetric."""

SMALLEST_ROW = 1e-6  # smallest reference for the error of a row, relative to the data

ROUNDING = 32.0 * np.finfo(float).eps
"""Error of a row, relative to its terms, that is attributed to rounding."""

LARGEST_ROUNDING = 1e-6
"""Error, relative to the data, above which nothing is attributed to rounding."""


@dataclass(frozen=True)
class ScaledLCP:
    r"""The problem :math:`0 \le A x + b \perp x \ge 0`, without units."""

    matrix: csr_array | np.ndarray  # (n, n), A = D M D with a diagonal of ones
    vector: np.ndarray  # (n,), b = D q / delta with the size delta of the data
    unit: np.ndarray  # (n,), delta D, so that z = delta D x
    is_symmetric: bool  # whether mirrored entries of A agree

    def slack(self, x: np.ndarray) -> np.ndarray:
        """Return A x + b."""
        return np.asarray(self.matrix @ x + self.vector)

    @property
    def has_negative_couplings(self) -> bool:
        """Whether no entry off the diagonal is positive, as in membranes (a Z-matrix)."""
        rows = csr_array(self.matrix)
        return bool(np.count_nonzero(rows.data > 0.0) <= np.count_nonzero(rows.diagonal()))

    def factorise(self, active: np.ndarray, shift: np.ndarray) -> Solve:
        """Factorise the active block of A + diag(shift); a RuntimeError if it is singular."""
        if not issparse(self.matrix):
            block = self.matrix[np.ix_(active, active)]
            block[np.diag_indices_from(block)] += shift
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                try:
                    dense = lu_factor(block, overwrite_a=True, check_finite=False)
                except LinAlgWarning as warning:
                    raise RuntimeError("the block is singular") from warning
            return lambda rhs: np.asarray(lu_solve(dense, rhs, check_finite=False))
        block = self.matrix if active.all() else self.matrix[active][:, active]
        shifted = csc_array(block + diags_array(shift))
        # a definite matrix needs no pivoting
        factors = symmetric_lu(shifted) if self.is_symmetric else splu(shifted)
        return lambda rhs: np.asarray(factors.solve(rhs))


def scale_lcp(matrix: csr_array | np.ndarray, vector: np.ndarray) -> ScaledLCP:
    """Check the data and remove the units."""
    matrix, vector = _checked(matrix, vector)
    scale = _unit_diagonal(matrix)
    refuse_out_of_range(vector, np.square(1.0 / scale))
    size = _data_size(scale * vector) or 1.0
    if issparse(matrix):
        scaled = csr_array(diags_array(scale) @ matrix @ diags_array(scale))
        if scaled.nnz > DENSE * scale.size**2:
            scaled = scaled.toarray()
    else:
        scaled = scale[:, None] * matrix * scale
    asymmetry = 0.0
    if vector.size:
        difference = abs(scaled - scaled.T)
        asymmetry = difference.max() if issparse(difference) else np.max(difference)
    return ScaledLCP(scaled, scale * vector / size, size * scale, bool(asymmetry <= SYMMETRY))


def verify_lcp(matrix: csr_array | np.ndarray, vector: np.ndarray, value: np.ndarray) -> float:
    r"""Measure how well :math:`z` solves :math:`0 \le M z + q \perp z \ge 0`.

    Parameters
    ----------
    matrix : csr_array or ndarray, shape (n, n), :math:`M`
    vector : ndarray, shape (n,), :math:`q`
    value : ndarray, shape (n,), :math:`z`

    Returns
    -------
    float, largest error of a row relative to the data, dimensionless, which a tolerance bounds

    Notes
    -----
    With :math:`d_i = |M_{ii}|^{-1/2}`, the pairs :math:`z_i / d_i` and :math:`d_i w_i` have the
    same unit, and the error is

    .. math::
        \max_i \frac{|\min(z_i / d_i,\, d_i w_i)| - \rho_i}{s_i}, \qquad
        r_i = d_i \Bigl(|q_i| + \sum_j |M_{ij}| |z_j|\Bigr), \qquad
        \delta = \max_i d_i \max(0, -q_i).    \tag{1}

    :math:`\delta` is the error of :math:`z = 0`, so that a large gap elsewhere does not count
    as data. :math:`s_i` is :math:`r_i`, so that a row is judged by its terms however large
    another load is, but not below :math:`10^{-6} \delta` and not above :math:`\delta`, so that
    a solution that runs away cannot pass. Where the terms of a row cancel, as with mass ratios
    and contrasts of 1e8, no computer can do better than :math:`\rho_i`: 32 units of rounding of
    :math:`r_i`, at most :math:`10^{-6} \delta`.

    Nothing changes under :math:`(M, q, z) \to (E M E, E q, E^{-1} z)` with a positive diagonal
    :math:`E`, nor under a change of units.

    Examples
    --------
    >>> verify_lcp(np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-2.0, 5.0]), np.array([1.0, 0.0]))
    0.0
    """
    return lcp_verifier(matrix, vector)(value)


def lcp_verifier(
    matrix: csr_array | np.ndarray, vector: np.ndarray
) -> Callable[[np.ndarray], float]:
    """Prepare :func:`verify_lcp` for many values of a problem."""
    matrix, vector = _checked(matrix, vector)
    scale, absolute = _unit_diagonal(matrix), abs(matrix)

    def verify(value: np.ndarray) -> float:
        if value.shape != vector.shape:
            raise ValueError(f"value must have shape {vector.shape}, got {value.shape}")
        if value.size == 0:
            return 0.0
        z, w, q = value / scale, scale * (matrix @ value + vector), scale * vector
        r = scale * (absolute @ np.abs(value))
        size = _data_size(q) or float(np.max(r)) or 1.0  # delta
        row = np.abs(q) + r
        rounding = np.minimum(ROUNDING * row, LARGEST_ROUNDING * size)
        error = np.maximum(0.0, np.abs(np.minimum(z, w)) - rounding)  # (1)
        error /= np.clip(row, SMALLEST_ROW * size, size)
        return float(np.max(np.where(np.isfinite(z) & np.isfinite(w), error, np.inf)))

    return verify


def _checked(
    matrix: csr_array | np.ndarray, vector: np.ndarray
) -> tuple[csr_array | np.ndarray, np.ndarray]:
    vector = np.asarray(vector, dtype=float)
    shape = np.shape(matrix)
    if len(shape) != 2 or shape[0] != shape[1]:
        raise CaseError(
            f"matrix must be square, got shape {shape}; give a row and a column per constraint"
        )
    if vector.shape != shape[:1]:
        raise CaseError(
            f"vector must have shape ({shape[0]},) to match the matrix, got {vector.shape}; give "
            f"an entry per constraint"
        )
    matrix = csr_array(matrix, dtype=float) if issparse(matrix) else np.asarray(matrix, float)
    if not np.all(np.isfinite(matrix.data if issparse(matrix) else matrix)):
        entries = csr_array(matrix).tocoo()
        first = int(np.flatnonzero(~np.isfinite(entries.data))[0])
        row, column = (int(index[first]) for index in entries.coords)
        raise CaseError(
            f"matrix must be finite, but entry ({row}, {column}) is {entries.data[first]}; "
            f"check masses, stiffnesses and units"
        )
    if not np.all(np.isfinite(vector)):
        first = int(np.flatnonzero(~np.isfinite(vector))[0])
        raise CaseError(
            f"vector must be finite, but entry {first} is {vector[first]}; check the load and "
            f"the gaps"
        )
    return matrix, vector


def _data_size(vector: np.ndarray) -> float:
    """Size of a scaled q: the error of z = 0, or its largest entry where z = 0 is the solution."""
    return float(np.max(-vector, initial=0.0)) or float(np.max(vector, initial=0.0))


def _unit_diagonal(matrix: csr_array | np.ndarray) -> np.ndarray:
    """Scale d of every unknown that makes the diagonal equal to 1."""
    diagonal = np.abs(matrix.diagonal())
    with np.errstate(divide="ignore"):
        scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(diagonal), 0.0)
    if scale.all():
        return scale
    coupling = abs(csr_array(matrix))
    coupling = csr_array(coupling.maximum(coupling.T))
    while not scale.all():
        missing = np.flatnonzero(scale == 0.0)
        reach = (coupling[missing] @ diags_array(scale)).max(axis=1).toarray().ravel()
        if not reach.any():
            # no unknown with a scale is coupled to the missing unknowns
            largest = coupling[missing][:, missing].max()
            known = scale[scale > 0.0]
            usual = float(np.median(known)) if known.size else 1.0
            scale[missing] = 1.0 / np.sqrt(largest) if largest > 0.0 else usual
        scale[missing[reach > 0.0]] = 1.0 / reach[reach > 0.0]
    return scale
