"""Linear complementarity problems: checked data, and the dimensionless form for every method.

A method takes the problem and a start x, shape (n,), and yields its iterates x, shape (n,), at
which the residual is evaluated.
"""

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgWarning, lu_factor, lu_solve
from scipy.sparse import csc_array, csr_array, diags_array, issparse
from scipy.sparse.linalg import splu

from multiscale.errors import CaseError
from multiscale.nonsmooth.magnitudes import refuse_out_of_range
from multiscale.numerics.factorisation import Solve, symmetric_lu

__all__ = ["Entries", "ScaledLCP", "data_size", "lcp_entries", "scale_lcp"]

DENSE = 0.2
"""Fraction of nonzero entries above which a matrix is factorised as a dense matrix."""

SYMMETRY = 1e-6
"""Difference of mirrored entries of the scaled matrix up to which it counts as symmetric."""


@dataclass(frozen=True)
class Entries:
    """A matrix given entry by entry.

    Attributes
    ----------
    matrix : csr_array or ndarray, shape (n, n), the entries
    """

    matrix: csr_array | np.ndarray

    @cached_property
    def rows(self) -> csr_array:
        """The matrix by rows, without stored zeros; numbered alike, for one kernel."""
        rows = csr_array(self.matrix)
        rows.indices = rows.indices.astype(np.int32, copy=False)
        rows.indptr = rows.indptr.astype(np.int32, copy=False)
        return rows

    def scaled(self, scale: np.ndarray) -> "Entries":
        """Return D M D; kept as a dense array if it has few zeros."""
        if not issparse(self.matrix):
            return Entries(scale[:, None] * self.matrix * scale)
        scaled = csr_array(diags_array(scale) @ self.matrix @ diags_array(scale))
        return Entries(scaled.toarray() if scaled.nnz > DENSE * scale.size**2 else scaled)

    def scale(self) -> np.ndarray:
        """Scale d of every unknown that makes the diagonal one.

        An unknown with a zero on the diagonal takes the scale that makes its largest coupling
        with the others one, and an empty row the median of all.
        """
        diagonal = np.abs(self.matrix.diagonal())
        with np.errstate(divide="ignore"):
            scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(diagonal), 0.0)
        if scale.all():
            return scale
        coupling = abs(self.rows)
        coupling = csr_array(coupling.maximum(coupling.T))
        while not scale.all():
            missing = np.flatnonzero(scale == 0.0)
            reach = (coupling[missing] @ diags_array(scale)).max(axis=1).toarray().ravel()
            if not reach.any():
                largest = coupling[missing][:, missing].max()
                known = scale[scale > 0.0]
                usual = float(np.median(known)) if known.size else 1.0
                scale[missing] = 1.0 / np.sqrt(largest) if largest > 0.0 else usual
            scale[missing[reach > 0.0]] = 1.0 / reach[reach > 0.0]
        return scale

    def solver(self, active: np.ndarray, shift: np.ndarray, symmetric: bool) -> Solve:
        """Factorise the active block of M + diag(shift)."""
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
        block = self.matrix[active][:, active] if not active.all() else self.matrix
        shifted = csc_array(block + diags_array(shift))
        # a definite matrix needs no pivoting
        factors = symmetric_lu(shifted) if symmetric else splu(shifted)
        return lambda rhs: np.asarray(factors.solve(rhs))


def lcp_entries(matrix: csr_array | np.ndarray, vector: np.ndarray) -> tuple[Entries, np.ndarray]:
    """Check the data of a problem and wrap its matrix."""
    vector = np.asarray(vector, dtype=float)
    shape = np.shape(matrix)
    if len(shape) != 2 or shape[0] != shape[1]:
        raise CaseError(
            f"matrix must be square, got shape {shape}; give one row and one column per constraint"
        )
    if vector.shape != shape[:1]:
        raise CaseError(
            f"vector must have shape ({shape[0]},) to match the matrix, got {vector.shape}; give "
            f"one entry per constraint"
        )
    entries = csr_array(matrix, dtype=float) if issparse(matrix) else np.asarray(matrix, float)
    if not np.all(np.isfinite(entries.data if issparse(entries) else entries)):
        coordinates = csr_array(entries).tocoo()
        first = int(np.flatnonzero(~np.isfinite(coordinates.data))[0])
        row, column = (int(index[first]) for index in coordinates.coords)
        raise CaseError(
            f"matrix must be finite, but entry ({row}, {column}) is {coordinates.data[first]}; "
            f"check masses, stiffnesses and units"
        )
    if not np.all(np.isfinite(vector)):
        first = int(np.flatnonzero(~np.isfinite(vector))[0])
        raise CaseError(
            f"vector must be finite, but entry {first} is {vector[first]}; check the load and "
            f"the gaps"
        )
    return Entries(entries), vector


@dataclass(frozen=True)
class ScaledLCP:
    r"""The problem :math:`0 \le A x + b \perp x \ge 0`, without units.

    Attributes
    ----------
    entries : Entries, shape (n, n), :math:`A = D M D` with a diagonal of ones
    vector : ndarray, shape (n,)
        :math:`b = D q / \delta`, where :math:`\delta` is the size of the data.
    unit : ndarray, shape (n,), :math:`\delta D`, so that :math:`z = \delta D x`
    is_symmetric : bool, whether mirrored entries of A agree
    """

    entries: Entries
    vector: np.ndarray
    unit: np.ndarray
    is_symmetric: bool

    def slack(self, x: np.ndarray) -> np.ndarray:
        """Return A x + b."""
        return np.asarray(self.entries.matrix @ x + self.vector)

    @property
    def has_negative_couplings(self) -> bool:
        """Whether no entry off the diagonal is positive, as in membranes (a Z-matrix)."""
        rows = self.entries.rows
        return bool(np.count_nonzero(rows.data > 0.0) <= np.count_nonzero(rows.diagonal()))


def scale_lcp(matrix: csr_array | np.ndarray, vector: np.ndarray) -> ScaledLCP:
    """Check the data and remove the units."""
    entries, vector = lcp_entries(matrix, vector)
    scale = entries.scale()
    refuse_out_of_range(vector, np.square(1.0 / scale))
    size = data_size(scale * vector) or 1.0
    scaled = entries.scaled(scale)
    largest = 0.0  # difference of mirrored entries
    if vector.size:
        difference = abs(scaled.matrix - scaled.matrix.T)
        largest = difference.max() if issparse(difference) else np.max(difference)
    return ScaledLCP(scaled, scale * vector / size, size * scale, bool(largest <= SYMMETRY))


def data_size(vector: np.ndarray) -> float:
    """Size of a scaled q: the error of z = 0, or its largest entry where z = 0 is the solution."""
    return float(np.max(-vector, initial=0.0)) or float(np.max(vector, initial=0.0))
