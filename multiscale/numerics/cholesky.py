"""Sparse Cholesky factors of many matrices with one pattern."""

import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.sparse import csc_array, csr_matrix

from multiscale.errors import MultiscaleError
from multiscale.numerics.factorisation import Solve, new_pardiso, symmetric_lu

__all__ = ["Factorise", "prepare_cholesky"]

Factorise = Callable[[np.ndarray, bool], Solve]

POSITIVE_DEFINITE = 2
"""Kind of matrix, as PARDISO counts them."""

SETTINGS = {1: 1, 2: 3, 24: 1, 37: -80}
"""Of PARDISO (iparm, from 1): these and not its defaults; nested dissection on all threads, \
factors of two levels, rows gathered into blocks if they differ in less than a fifth. The \
defaults would also refine every solution, which takes four times as long."""

NOT_DEFINITE = "the tangent stiffness is not positive definite"


def prepare_cholesky(start: np.ndarray, column: np.ndarray) -> Factorise:
    """Return the function that factorises matrices of one pattern.

    PARDISO takes the matrices, if pypardiso is installed; otherwise SuperLU in its symmetric mode.
    """
    if start.size == 1:
        return lambda entries, signs: np.copy
    solver = new_pardiso(POSITIVE_DEFINITE)
    return _superlu(start, column) if solver is None else _pardiso(solver, start, column)


def _pardiso(solver: Any, start: np.ndarray, column: np.ndarray) -> Factorise:
    """Factors by PARDISO, which stores one factorisation."""
    for number, value in SETTINGS.items():
        solver.set_iparm(number, value)
    n = start.size - 1

    def factorise(entries: np.ndarray, signs: bool) -> Solve:
        matrix = csr_matrix((entries, column, start), shape=(n, n))
        try:
            solver.factorize(matrix)
        except Exception as error:  # its class is only known where pypardiso is installed
            raise MultiscaleError(NOT_DEFINITE) from error
        return lambda rhs: np.asarray(solver.solve(matrix, rhs)) if rhs.size else rhs.copy()

    weakref.finalize(factorise, _release, solver)
    return factorise


def _release(solver: Any) -> None:
    """Release the memory of PARDISO, which refuses to where it has no factors."""
    if getattr(solver.factorized_A, "nnz", True):  # of a large matrix it has a checksum only
        solver.free_memory(everything=True)


def _superlu(start: np.ndarray, column: np.ndarray) -> Factorise:
    """Factors by SuperLU without pivoting, so that the signs of the pivots show definiteness."""
    n = start.size - 1
    row = np.repeat(np.arange(n, dtype=np.int32), np.diff(start))
    strict = row != column
    i, j = np.append(row, column[strict]), np.append(column, row[strict])
    order = np.lexsort((i, j))
    source = np.append(np.arange(column.size), np.flatnonzero(strict))[order]
    full_start = np.append(0, np.cumsum(np.bincount(j, minlength=n))).astype(np.int32)
    index = i[order].astype(np.int32)

    def factorise(entries: np.ndarray, signs: bool) -> Solve:
        matrix = csc_array((entries[source], index, full_start), shape=(n, n))
        try:
            factors = symmetric_lu(matrix)
        except RuntimeError as error:
            raise MultiscaleError(NOT_DEFINITE) from error
        if signs and not np.all(factors.U.diagonal() > 0.0):  # copies the factors
            raise MultiscaleError(NOT_DEFINITE)
        return lambda rhs: np.asarray(factors.solve(rhs))

    return factorise
