"""Factorisation of linear systems with many right-hand sides, or with matrices of a pattern."""

import warnings
import weakref
from collections.abc import Callable, Iterable
from copy import copy
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.linalg import norm
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import (
    block_diag,
    coo_array,
    csc_array,
    csr_array,
    csr_matrix,
    diags_array,
    issparse,
)
from scipy.sparse.linalg import splu

from multiscale.errors import MultiscaleError

LARGEST_CONDITION = 1e13
"""Above this condition number, after scaling by the diagonal, a matrix counts as singular."""

SMALL_PIVOT = 1e-2
"""Below this share of the largest entry of its column a pivot leaves the diagonal."""

LARGEST_ASYMMETRY = 0.1
"""Part of the entries without a mirrored entry up to which a pattern counts as symmetric."""

LARGEST_BACKWARD_ERROR = 1e-13
"""Above this backward error the pivots were too small, and the usual order is taken."""

Solve = Callable[[np.ndarray], np.ndarray]

Factorise = Callable[[np.ndarray, bool], Solve]

POSITIVE_DEFINITE = 2  # kind of matrix, as PARDISO counts them

SETTINGS = {1: 1, 2: 3, 24: 1, 37: -80}
"""Settings of PARDISO (iparm, from 1) instead of its defaults: nested dissection on all \
threads, factors of two levels, rows gathered into blocks if they differ in less than a fifth. \
The defaults would also refine every solution, which takes four times as long."""

NOT_DEFINITE = "the tangent stiffness is not positive definite"


def factorise(matrix: csr_array | np.ndarray, *, name: str = "the matrix") -> Solve:
    """Factorise a square matrix and return the function that solves with it."""
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"{name} must be square, got shape {matrix.shape}")
    entries = matrix.data if issparse(matrix) else matrix
    if not np.all(np.isfinite(entries)):
        raise MultiscaleError(f"{name} has entries that are NaN or infinite; check the units")
    if matrix.shape[0] == 0:
        return lambda right_hand_side: right_hand_side.copy()

    try:
        solve = _factors(matrix)
        sound = _softest_motion(matrix, solve)[0] < LARGEST_CONDITION
    except RuntimeError:  # SuperLU met a pivot that is exactly zero
        sound = False
    if not sound:
        raise MultiscaleError(
            f"{name} is singular: unknown {_unconstrained_unknown(matrix)} can move without force; "
            f"check the supports and that every body is fixed"
        )
    return solve


def _factors(matrix: csr_array | np.ndarray) -> Solve:
    """LU factors by PARDISO, SuperLU or LAPACK; a singular matrix may pass."""
    if not issparse(matrix):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the condition number is estimated below
            dense = lu_factor(matrix)
        return lambda rhs: np.asarray(lu_solve(dense, rhs, check_finite=False))
    scale = _diagonal_scale(matrix)
    solver = new_pardiso()
    if solver is None:
        return _superlu_factors(matrix, scale)

    # scaled, because PARDISO lifts pivots that are small relative to the whole matrix
    rows = csr_matrix(diags_array(scale) @ matrix @ diags_array(scale), dtype=float)
    rows.sum_duplicates()
    if not np.all(np.diff(rows.indptr)):
        raise RuntimeError("PARDISO cannot take an empty row")
    solver.factorize(rows)

    def solve(rhs: np.ndarray) -> np.ndarray:
        return _scaled_solve(lambda b: solver.solve(rows, b), scale, rhs)

    weakref.finalize(solve, solver.free_memory, everything=True)
    return solve


def new_pardiso(matrix_type: int = 11) -> Any:
    """Return a fresh solver (type 2: positive definite, 11: nonsymmetric), or None without it."""
    if (blank := _blank_pardiso(matrix_type)) is None:
        return None
    solver = copy(blank)
    solver.pt, solver.iparm = blank.pt.copy(), blank.iparm.copy()
    return solver


@cache
def _blank_pardiso(matrix_type: int) -> Any:
    """Load the library once: pypardiso searches the file system for it every time."""
    try:
        return import_module("pypardiso").PyPardisoSolver(mtype=matrix_type)
    except ImportError:
        return None


def _superlu_factors(matrix: csr_array, scale: np.ndarray) -> Solve:
    """LU factors in an order for symmetric patterns, unless digits cancel."""
    scaled = csc_array(diags_array(scale) @ matrix @ diags_array(scale))
    if _has_symmetric_pattern(scaled):
        try:
            # pivots stay on the diagonal, which keeps the fill low, while they are not small
            fast = symmetric_lu(scaled, SMALL_PIVOT)
        except RuntimeError:  # a pivot that is exactly zero
            pass
        else:
            signs = _random_signs(scale.size)
            with np.errstate(all="ignore"):
                x = fast.solve(signs)
                terms = norm(abs(scaled) @ np.abs(x), np.inf) + 1.0
                error = norm(scaled @ x - signs, np.inf) / terms
            if error < LARGEST_BACKWARD_ERROR:
                return lambda rhs: _scaled_solve(fast.solve, scale, rhs)
            del fast  # before the memory is needed again
    safe = splu(csc_array(matrix))
    return lambda rhs: np.asarray(safe.solve(rhs))


def _has_symmetric_pattern(matrix: csc_array) -> bool:
    """Whether nearly every entry has a mirrored entry."""
    entries = (np.ones(matrix.nnz, dtype=np.int8), matrix.indices, matrix.indptr)
    pattern = csc_array(entries, shape=matrix.shape)
    return bool((pattern != pattern.T).nnz <= LARGEST_ASYMMETRY * matrix.nnz)


def symmetric_lu(matrix: csc_array, pivot: float = 0.0) -> Any:
    """SuperLU factors in an order for symmetric patterns, unless a pivot is below its share."""
    return splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=pivot, options={"SymmetricMode": True}
    )


def _scaled_solve(solve: Solve, scale: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solve with the factors of D K D; PARDISO refuses a right-hand side without columns."""
    if not rhs.size:
        return np.zeros_like(rhs)
    columns = scale if rhs.ndim == 1 else scale[:, None]
    return np.asarray(columns * solve(columns * rhs))


def _random_signs(n: int) -> np.ndarray:
    return np.random.default_rng(seed=0).choice([-1.0, 1.0], size=n)


def _softest_motion(matrix: csr_array | np.ndarray, solve: Solve) -> tuple[float, np.ndarray]:
    """Estimated condition number (1) and the motion of the scaled unknowns behind it."""
    # |D K D| |(D K D)^-1 r| in the maximum norm, D = diag |K_ii|^(-1/2), r random signs (1):
    # neither units nor a contrast between two bodies change it
    scale = _diagonal_scale(matrix)
    signs = _random_signs(scale.size)
    with np.errstate(all="ignore"):
        motion = solve(signs / scale) / scale
        size = norm(scale * (abs(matrix) @ scale), np.inf)
        return float(size * norm(motion, np.inf)), np.abs(motion)


def _diagonal_scale(matrix: csr_array | np.ndarray) -> np.ndarray:
    diagonal = np.abs(matrix.diagonal())
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))


def _unconstrained_unknown(matrix: csr_array | np.ndarray) -> int:
    """Return the unknown that moves most in a singular matrix with soft springs on all unknowns."""
    diagonal = np.abs(matrix.diagonal())
    if not diagonal.all():
        return int(np.argmin(diagonal))
    spring = 1e-12 * diagonal
    sparse = issparse(matrix)
    supported = csr_array(matrix + diags_array(spring)) if sparse else matrix + np.diag(spring)
    try:
        motion = _softest_motion(supported, _factors(supported))[1]
    except RuntimeError:
        return int(np.argmin(diagonal))
    return int(np.argmax(np.nan_to_num(motion)))


def on_diagonal(matrices: Iterable[csr_array | np.ndarray]) -> csr_array:
    """Return the sparse matrix with the given matrices as its diagonal blocks."""
    # sparse arrays go in: of other matrices, versions of SciPy make different types
    return csr_array(block_diag([coo_array(matrix) for matrix in matrices], format="csr"))


def compact(matrix: csr_array) -> csr_array:
    """Return the matrix with indices of four bytes, which halves their memory, where they fit."""
    if max(*matrix.shape, matrix.nnz) > np.iinfo(np.int32).max:
        return matrix
    entries = matrix.data, matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    return csr_array(entries, shape=matrix.shape)


def prepare_cholesky(start: np.ndarray, column: np.ndarray) -> Factorise:
    """Return the function that factorises matrices of one pattern, by PARDISO or SuperLU."""
    if start.size == 1:
        return lambda entries, signs: np.copy
    solver = new_pardiso(POSITIVE_DEFINITE)
    return _superlu(start, column) if solver is None else _pardiso(solver, start, column)


def _pardiso(solver: Any, start: np.ndarray, column: np.ndarray) -> Factorise:
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
