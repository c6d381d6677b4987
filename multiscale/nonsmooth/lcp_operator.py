"""The matrix of a complementarity problem: its entries, or the bodies and directions behind it."""

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgWarning, lu_factor, lu_solve
from scipy.sparse import block_array, csc_array, csr_array, diags_array, issparse
from scipy.sparse.linalg import splu

from multiscale.errors import CaseError
from multiscale.numerics.factorisation import Solve, factorise, symmetric_lu

__all__ = ["Delassus", "Entries", "lcp_operator"]

DENSE = 0.2
"""Part of the entries that are not zero above which a matrix is factorised as a dense one."""


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

    @cached_property
    def absolute(self) -> csr_array | np.ndarray:
        """Absolute values of the entries."""
        return abs(self.matrix)

    def product(self, z: np.ndarray) -> np.ndarray:
        """Return M z."""
        return np.asarray(self.matrix @ z)

    def apply(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return M z, the sums of the absolute terms, and the error of equilibrium, here none."""
        return self.product(z), np.asarray(self.absolute @ np.abs(z)), 0.0

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
        """Factorise the active block of M + diag(shift).

        Raises
        ------
        RuntimeError
            If the block is exactly singular.
        """
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
        return _sparse_solver(csc_array(block + diags_array(shift)), symmetric)


@dataclass(frozen=True)
class Delassus:
    r"""The operator :math:`W = H^T M^{-1} H` of bodies pushed along directions, never formed.

    Pass it to ``solve_lcp`` in the place of the matrix; :math:`z` are then the impulses (or
    forces) along the directions, and :math:`q = H^T v_0 + b` the free relative velocities (or
    displacements).

    Parameters
    ----------
    mass : csr_array, shape (k, k)
        Symmetric positive definite mass (or stiffness) :math:`M` of the bodies, kg (or N/m).
    directions : csr_array, shape (k, n)
        :math:`H`; column *i* is the generalised force of a unit impulse of constraint *i*.

    Raises
    ------
    CaseError
        If the shapes do not agree, an entry is not finite or a mass is not positive.
    MultiscaleError
        If the mass matrix is singular.
    """

    mass: csr_array
    directions: csr_array

    def __post_init__(self) -> None:
        shape = self.mass.shape
        if shape[0] != shape[1] or self.directions.shape[0] != shape[0]:
            raise CaseError(
                f"mass (k, k) and directions (k, n) must agree, got {shape} and "
                f"{self.directions.shape}"
            )
        for name, entries in (("mass", self.mass), ("directions", self.directions)):
            _refuse_not_finite(entries, name)
        lightest = int(np.argmin(self.mass.diagonal())) if shape[0] else 0
        if shape[0] and not self.mass.diagonal()[lightest] > 0.0:
            raise CaseError(
                f"mass must be positive definite, but its diagonal at unknown {lightest} is "
                f"{self.mass.diagonal()[lightest]:g}; give every body a positive mass"
            )

    @cached_property
    def inverse(self) -> Solve:
        """Solve with the mass matrix."""
        if self.has_diagonal_mass:
            diagonal = self.mass.diagonal()
            return lambda rhs: np.asarray(rhs / diagonal)
        return factorise(self.mass, name="the mass matrix")

    @property
    def has_diagonal_mass(self) -> bool:
        """Whether the bodies are uncoupled, so that W is as sparse as the contacts are."""
        rows, columns = self.mass.nonzero()
        return bool(np.array_equal(rows, columns))

    def entries(self) -> Entries:
        """Form W: sparse for a diagonal mass, dense otherwise."""
        H = csc_array(self.directions)
        if self.has_diagonal_mass:
            return Entries(csr_array(H.T @ (diags_array(1.0 / self.mass.diagonal()) @ H)))
        return Entries(np.asarray(H.T @ self.inverse(H.toarray())))

    def product(self, z: np.ndarray) -> np.ndarray:
        """Return W z."""
        return np.asarray(self.directions.T @ self.inverse(self.directions @ z))

    def apply(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return W z, the sums of the absolute terms, and the error of equilibrium M v = H z."""
        force = self.directions @ z
        velocity = self.inverse(force)
        terms = abs(self.mass) @ np.abs(velocity) + abs(self.directions) @ np.abs(z)
        balance = np.abs(self.mass @ velocity - force) / np.where(terms > 0.0, terms, 1.0)
        slack = self.directions.T @ velocity
        return slack, abs(self.directions).T @ np.abs(velocity), float(np.max(balance, initial=0.0))

    def scaled(self, scale: np.ndarray) -> "Delassus":
        """Return D W D with the masses scaled to one."""
        inverse = diags_array(1.0 / np.sqrt(self.mass.diagonal()))
        return Delassus(
            csr_array(inverse @ self.mass @ inverse),
            csr_array(inverse @ self.directions @ diags_array(scale)),
        )

    def scale(self) -> np.ndarray:
        """Scale d of every unknown that makes the diagonal of H^T diag(M)^-1 H one."""
        squares = self.directions.multiply(self.directions)
        diagonal = np.asarray(squares.T @ (1.0 / self.mass.diagonal()))
        usual = float(np.median(diagonal[diagonal > 0.0])) if diagonal.any() else 1.0
        return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, usual)))

    def solver(self, active: np.ndarray, shift: np.ndarray, symmetric: bool) -> Solve:
        """Factorise the active block of W + diag(shift) through the bodies.

        The block system is one with the quasi-definite matrix [[M, H], [H^T, -shift]].
        """
        H = self.directions[:, active]
        blocks = [[self.mass, H], [H.T, -diags_array(shift)]]
        solve = _sparse_solver(block_array(blocks, format="csc"), symmetric)
        k = self.mass.shape[0]
        return lambda rhs: -solve(np.concatenate([np.zeros(k), rhs]))[k:]


def lcp_operator(
    matrix: csr_array | np.ndarray | Delassus, vector: np.ndarray
) -> tuple[Entries | Delassus, np.ndarray]:
    """Check the data of a problem and wrap its matrix.

    Raises
    ------
    CaseError
        If the matrix is not square, the vector does not fit, or an entry is not finite.
    """
    vector = np.asarray(vector, dtype=float)
    if isinstance(matrix, Delassus):
        operator: Entries | Delassus = matrix
        n = matrix.directions.shape[1]
    else:
        shape = np.shape(matrix)
        if len(shape) != 2 or shape[0] != shape[1]:
            raise CaseError(
                f"matrix must be square, got shape {shape}; give one row and one column per "
                f"constraint"
            )
        n = shape[0]
        entries = csr_array(matrix, dtype=float) if issparse(matrix) else np.asarray(matrix, float)
        _refuse_not_finite(entries, "matrix")
        operator = Entries(entries)
    if vector.shape != (n,):
        raise CaseError(
            f"vector must have shape ({n},) to match the matrix, got {vector.shape}; give one "
            f"entry per constraint"
        )
    if not np.all(np.isfinite(vector)):
        first = int(np.flatnonzero(~np.isfinite(vector))[0])
        raise CaseError(
            f"vector must be finite, but entry {first} is {vector[first]}; check the load and "
            f"the gaps"
        )
    return operator, vector


def _sparse_solver(matrix: csc_array, symmetric: bool) -> Solve:
    """LU factors; of a symmetric definite or quasi-definite matrix without pivoting."""
    factors = symmetric_lu(matrix) if symmetric else splu(matrix)
    return lambda rhs: np.asarray(factors.solve(rhs))


def _refuse_not_finite(matrix: csr_array | np.ndarray, name: str) -> None:
    """Raise with the first entry that is NaN or infinite."""
    entries = matrix.data if issparse(matrix) else matrix
    if np.all(np.isfinite(entries)):
        return
    coordinates = csr_array(matrix).tocoo()
    first = int(np.flatnonzero(~np.isfinite(coordinates.data))[0])
    row, column = (int(index[first]) for index in coordinates.coords)
    raise CaseError(
        f"{name} must be finite, but entry ({row}, {column}) is {coordinates.data[first]}; check "
        f"masses, stiffnesses and units"
    )
