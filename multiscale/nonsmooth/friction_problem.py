"""Friction problems in dimensionless 3x3 blocks: scaling, products, factors, record of a run."""

from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from numpy.linalg import norm
from scipy.linalg.lapack import dgetrf, dgetrs
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.linalg import splu

from multiscale.nonsmooth.coulomb import closing_norm, contact_mass, law_error
from multiscale.numerics.compiled import compiled
from multiscale.numerics.factorisation import Solve

SMALL = 100  # unknowns up to which a matrix is treated as full
DENSE = 0.25  # share of blocks from which on a matrix is treated as full
PIVOT = 0.01  # least diagonal pivot that is accepted, relative to its column: others cost fill-in


@dataclass(frozen=True)
class ScaledFriction:
    r"""Dimensionless friction problem :math:`\hat u = \hat W \hat r + \hat q`."""

    blocks: np.ndarray  # (n, 3, 3), of W row by row; every row has its diagonal block
    columns: np.ndarray  # (n,), contact that each block belongs to, ascending in a row
    starts: np.ndarray  # (contacts + 1,), first block of every row
    diagonal: np.ndarray  # (contacts,), number of the diagonal block of every row
    velocity: np.ndarray  # (contacts, 3), q, scaled to the norm 1
    friction: np.ndarray  # (contacts,), mu > 0
    reaction_unit: np.ndarray  # (contacts, 3), of impulses, N s
    velocity_unit: np.ndarray  # (contacts, 3), of velocities, m/s
    measure: tuple[np.ndarray, np.ndarray, float]  # given friction, contact masses, 1 kg
    size: float  # norm of the given q that errors are relative to, m/s

    def respond(self, reaction: np.ndarray) -> np.ndarray:
        """Velocity W r + q, shape (contacts, 3)."""
        velocity = self.velocity.copy()
        add_product(self.blocks, self.columns, self.starts, reaction, velocity)
        return velocity

    def error(self, reaction: np.ndarray) -> float:
        """Natural-map error of the user's problem as the verifier defines it."""
        velocity, impulse = (
            self.respond(reaction) * self.velocity_unit,
            reaction * self.reaction_unit,
        )
        return law_error(velocity.T, impulse.T, *self.measure) / self.size


def scale_friction(
    delassus: csr_array | np.ndarray,
    velocity: np.ndarray,
    friction: np.ndarray,
    *,
    step: float = 1.0,
) -> ScaledFriction:
    """Scale a friction problem to D W D, D q / s, D^-1 r / s and mu D_N / D_T (1)."""
    contacts = friction.size
    dim = velocity.size // contacts
    full = np.zeros((contacts, 3))
    full[:, :dim] = velocity.reshape(contacts, dim)
    given = bsr_array(delassus, blocksize=(dim, dim))
    given.sum_duplicates()

    # blocks of 3x3 in the order of rows and columns, with a block on every diagonal
    row = np.repeat(np.arange(contacts), np.diff(given.indptr))
    missing = np.setdiff1d(np.arange(contacts), row[row == given.indices])
    row, columns = np.append(row, missing), np.append(given.indices, missing)
    blocks = np.zeros((row.size, 3, 3))
    blocks[: len(given.data), :dim, :dim] = given.data
    order = np.lexsort((columns, row))
    row, columns, blocks = row[order], columns[order], blocks[order]
    starts = np.append(0, np.cumsum(np.bincount(row, minlength=contacts)))
    diagonal = np.flatnonzero(columns == row)

    # D of (1); a direction without mobility takes the mean of the contact
    mobility = np.einsum("iaa->ia", blocks[diagonal])
    size = np.abs(mobility[:, :dim])
    mean = size.mean(axis=1)
    normal, tangent = (
        np.where(mobile > 1e-12 * mean, mobile, mean)
        for mobile in (size[:, 0], size[:, 1:].mean(axis=1))
    )
    both = np.column_stack([normal, tangent, tangent])
    unit = 1.0 / np.sqrt(np.where(both > 0.0, both, size.max(initial=0.0) or 1.0))  # D

    # D W D; components without a force have a unit diagonal only
    carries = np.ones((contacts, 3), dtype=bool)
    carries[:, 1:] = (friction > 0.0)[:, None]
    carries[:, dim:] = False
    blocks *= unit[row][:, :, None] * unit[columns][:, None, :]
    blocks[~(carries[row][:, :, None] & carries[columns][:, None, :])] = 0.0
    contact, component = np.nonzero(~carries)
    blocks[diagonal[contact], component, component] = 1.0
    full = np.where(carries, full * unit, 0.0)
    data_size = float(norm(full)) or 1.0
    return ScaledFriction(
        blocks=blocks,
        columns=columns,
        starts=starts,
        diagonal=diagonal,
        velocity=full / data_size,
        friction=np.where(friction > 0.0, friction, 1.0) * unit[:, 0] / unit[:, 1],  # (1)
        reaction_unit=unit * data_size,
        velocity_unit=data_size / unit,
        measure=(
            np.ascontiguousarray(friction, dtype=float),
            contact_mass(mobility[:, :dim]),
            step,
        ),
        size=closing_norm(velocity.reshape(contacts, dim)),
    )


@dataclass
class Progress:
    """Record of a run, updated by the methods through :meth:`note`."""

    problem: ScaledFriction  # measures the errors
    target: float  # error at which the run may stop, dimensionless
    callback: Callable[[int, float], None] | None = None  # called as callback(iteration, residual)
    started: float = field(default_factory=perf_counter)  # on the clock, s
    residuals: list[float] = field(default_factory=list)  # of every noted iterate
    seconds: list[float] = field(default_factory=list)  # since the start
    trail: list[str] = field(default_factory=list)  # methods in their order
    best: np.ndarray | None = None  # iterate, (contacts, 3), dimensionless
    smallest: float = np.inf

    def note(self, reaction: np.ndarray) -> bool:
        """Record the error of impulses, shape (contacts, 3); return whether the target is met."""
        error = self.problem.error(reaction)
        if self.callback is not None:
            self.callback(len(self.residuals), error)
        self.residuals.append(error)
        self.seconds.append(perf_counter() - self.started)
        if error < self.smallest:
            self.smallest, self.best = error, reaction.copy()
        return self.smallest <= self.target


def factorise_blocks(
    problem: ScaledFriction, added: np.ndarray, left: np.ndarray | None = None
) -> Solve | None:
    """Factorise :math:`A W + B`, ``left`` W + ``added``; None at a pivot of exactly zero."""
    contacts = problem.friction.size
    shape, n = (contacts, 3), 3 * contacts
    row = np.repeat(np.arange(contacts), np.diff(problem.starts))
    blocks = problem.blocks.copy()
    if left is not None:  # many small products: faster than a matrix product
        A, W = left[row], problem.blocks
        blocks = A[:, :, :1] * W[:, :1] + A[:, :, 1:2] * W[:, 1:2] + A[:, :, 2:] * W[:, 2:]
    blocks[problem.diagonal] += added

    if n <= SMALL or problem.columns.size > DENSE * contacts**2:
        full = np.zeros((contacts, 3, contacts, 3))
        full[row, :, problem.columns] = blocks
        factors, pivots, info = dgetrf(full.reshape(n, n).T, overwrite_a=True)
        if info != 0:
            return None
        return lambda b: np.asarray(dgetrs(factors, pivots, b.ravel(), trans=1)[0]).reshape(shape)
    rows = bsr_array((blocks, problem.columns, problem.starts), shape=(n, n)).tocsr()
    try:  # compressed rows of A W + B are compressed columns of its transpose
        sparse = splu(rows.T, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=PIVOT)
    except RuntimeError:
        return None
    return lambda b: np.asarray(sparse.solve(b.ravel(), "T")).reshape(shape)


@compiled
def add_product(blocks, columns, starts, reaction, velocity):  # type: ignore[no-untyped-def]
    """Add W r to a velocity of shape (contacts, 3) in place."""
    for i in range(starts.size - 1):
        a0, a1, a2 = velocity[i, 0], velocity[i, 1], velocity[i, 2]
        for k in range(starts[i], starts[i + 1]):
            j = columns[k]
            x, y, z = reaction[j, 0], reaction[j, 1], reaction[j, 2]
            a0 += blocks[k, 0, 0] * x + blocks[k, 0, 1] * y + blocks[k, 0, 2] * z
            a1 += blocks[k, 1, 0] * x + blocks[k, 1, 1] * y + blocks[k, 1, 2] * z
            a2 += blocks[k, 2, 0] * x + blocks[k, 2, 1] * y + blocks[k, 2, 2] * z
        velocity[i, 0], velocity[i, 1], velocity[i, 2] = a0, a1, a2
