"""Sparse matrices of blocks."""

from collections.abc import Iterable

import numpy as np
from scipy.sparse import block_diag, coo_array, csr_array

__all__ = ["on_diagonal"]


def on_diagonal(matrices: Iterable[csr_array | np.ndarray]) -> csr_array:
    """Return the sparse matrix with the given matrices as its diagonal blocks."""
    # sparse arrays go in: of other matrices, versions of SciPy make different types
    return csr_array(block_diag([coo_array(matrix) for matrix in matrices], format="csr"))
