"""The dimensionless form of a linear complementarity problem, on which every method works.

A method takes the problem and a start x, shape (n,), and yields its iterates x, shape (n,), each
worth a look at the residual.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, issparse

from multiscale.nonsmooth.complementarity import data_size
from multiscale.nonsmooth.lcp_operator import Delassus, Entries, lcp_operator
from multiscale.nonsmooth.magnitudes import refuse_out_of_range

__all__ = ["ScaledLCP", "scale_lcp"]

SYMMETRY = 1e-6
"""Difference of mirrored entries of the scaled matrix up to which it counts as symmetric."""

LARGEST_FORMED = 2000
"""Number of constraints up to which a dense W is formed from bodies and directions."""


@dataclass(frozen=True)
class ScaledLCP:
    r"""The problem :math:`0 \le A x + b \perp x \ge 0`, without units.

    Attributes
    ----------
    operator : Entries or Delassus, shape (n, n), :math:`A = D M D` with a diagonal of ones
    vector : ndarray, shape (n,)
        :math:`b = D q / \delta`, where :math:`\delta` is the size of the data.
    unit : ndarray, shape (n,), :math:`\delta D`, so that :math:`z = \delta D x`
    is_symmetric : bool, whether mirrored entries of A agree
    """

    operator: Entries | Delassus
    vector: np.ndarray
    unit: np.ndarray
    is_symmetric: bool

    def slack(self, x: np.ndarray) -> np.ndarray:
        """Return A x + b."""
        return np.asarray(self.operator.product(x) + self.vector)

    @property
    def entries(self) -> Entries:
        """The matrix by its entries, for the methods that need them."""
        if isinstance(self.operator, Delassus):
            raise TypeError("this method needs the entries of the matrix; the operator has none")
        return self.operator

    @property
    def has_negative_couplings(self) -> bool:
        """Whether no entry off the diagonal is positive, as in membranes (a Z-matrix)."""
        if isinstance(self.operator, Delassus):
            return False
        rows = self.operator.rows
        return bool(np.count_nonzero(rows.data > 0.0) <= np.count_nonzero(rows.diagonal()))


def scale_lcp(matrix: csr_array | np.ndarray | Delassus, vector: np.ndarray) -> ScaledLCP:
    """Check the data, form W where that pays, and take the units out.

    Raises
    ------
    CaseError
        If the matrix is not square, the vector does not fit, an entry is not finite, or the
        unknowns are beyond the floating-point numbers.
    """
    operator, vector = lcp_operator(matrix, vector)
    if isinstance(operator, Delassus) and (
        operator.has_diagonal_mass or vector.size <= LARGEST_FORMED
    ):
        operator = operator.entries()
    scale = operator.scale()
    refuse_out_of_range(vector, np.square(1.0 / scale))
    size = data_size(scale * vector) or 1.0
    scaled = operator.scaled(scale)
    largest = 0.0  # difference of mirrored entries
    if not isinstance(scaled, Delassus) and vector.size:
        difference = abs(scaled.matrix - scaled.matrix.T)
        largest = difference.max() if issparse(difference) else np.max(difference)
    return ScaledLCP(scaled, scale * vector / size, size * scale, bool(largest <= SYMMETRY))
