r"""Friction problems in dimensionless 3x3 blocks: scaling, products, factors, record of a run.

A friction method takes a dimensionless problem, impulses to start from, shape (contacts, 3), a
:class:`Progress` that measures the error every few iterations and returns whether to stop, and the
limit of its iterations; it returns its last impulses.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from numpy.linalg import norm
from scipy.linalg.lapack import dgetrf, dgetrs
from scipy.sparse import bsr_array, csc_matrix, csr_array
from scipy.sparse.linalg import splu

from multiscale.nonsmooth.coulomb import ROUND_OFF, closing_norm, contact_mass
from multiscale.numerics.compiled import compiled
from multiscale.numerics.factorisation import Solve

__all__ = ["Progress", "ScaledFriction", "factorise_blocks", "scale_friction"]

SMALL = 100
"""Unknowns up to which a matrix is treated as full."""

DENSE = 0.25
"""Share of blocks from which on a matrix is treated as full."""

PIVOT = 0.01
"""Least diagonal pivot that is accepted, relative to its column: others cost fill-in."""


@dataclass(frozen=True)
class ScaledFriction:
    r"""Dimensionless friction problem :math:`\hat u = \hat W \hat r + \hat q`.

    Attributes
    ----------
    blocks : ndarray, shape (n, 3, 3)
        Blocks of :math:`\hat W` row by row; every row has its diagonal block.
    columns, starts : ndarray, shapes (n,) and (contacts + 1,)
        Contact that each block belongs to, ascending in a row, and first block of every row.
    diagonal : ndarray, shape (contacts,), which block is the diagonal one
    velocity : ndarray, shape (contacts, 3), :math:`\hat q`, norm one
    friction : ndarray, shape (contacts,), :math:`\hat\mu > 0`
    reaction_unit, velocity_unit : ndarray, shape (contacts, 3)
        :math:`r = \hat r` times the first, N s, and :math:`u = \hat u` times the second, m/s.
    measure : tuple (friction, mass, step)
        Friction coefficients and contact masses of the given problem, and its step of 1 kg.
    size : float, norm of the given :math:`q` that errors are relative to, m/s
    """

    blocks: np.ndarray
    columns: np.ndarray
    starts: np.ndarray
    diagonal: np.ndarray
    velocity: np.ndarray
    friction: np.ndarray
    reaction_unit: np.ndarray
    velocity_unit: np.ndarray
    measure: tuple[np.ndarray, np.ndarray, float]
    size: float

    def respond(self, reaction: np.ndarray) -> np.ndarray:
        """Velocity W r + q, shape (contacts, 3)."""
        velocity = self.velocity.copy()
        add_product(self.blocks, self.columns, self.starts, reaction, velocity)
        return velocity

    def error(self, reaction: np.ndarray) -> float:
        """Natural-map error of the user's problem as the verifier defines it."""
        weighted, plain = natural_map_norms(
            self.respond(reaction) * self.velocity_unit,
            reaction * self.reaction_unit,
            *self.measure,
        )
        rounding = ROUND_OFF * float(norm(reaction * self.reaction_unit)) / self.measure[2]
        return max(float(weighted), float(plain) - rounding) / self.size


def scale_friction(
    delassus: csr_array | np.ndarray,
    velocity: np.ndarray,
    friction: np.ndarray,
    *,
    step: float = 1.0,
) -> ScaledFriction:
    r"""Bring a friction problem into dimensionless form.

    Notes
    -----
    With :math:`D = \mathrm{diag}(D_N, D_T, D_T)` for every contact and a number :math:`s`,

    .. math::
        \hat W = D W D, \quad \hat q = D q / s, \quad \hat r = D^{-1} r / s, \quad
        \hat\mu = \mu D_N / D_T,    \tag{1}

    :math:`D_N = W_{NN}^{-1/2}` and :math:`D_T` from the mean of the tangential diagonal: the
    diagonal of :math:`\hat W` is about one, whatever the units and the masses. A tangential
    component that cannot carry a force (:math:`\mu = 0`, or the third one of a plane problem)
    is cut off from the rest: it stays zero, and every method sees a contact with friction.
    """
    contacts = friction.size
    dim = velocity.size // contacts
    full = np.zeros((contacts, 3))
    full[:, :dim] = velocity.reshape(contacts, dim)
    rows = bsr_array(delassus, blocksize=(dim, dim))
    rows.sum_duplicates()
    columns, starts, diagonal, data = _with_diagonal(
        rows.data, rows.indices.astype(np.int64), rows.indptr.astype(np.int64)
    )
    carries = np.ones((contacts, 3), dtype=bool)
    carries[:, 1:] = (friction > 0.0)[:, None]
    carries[:, dim:] = False

    mobility = np.einsum("iaa->ia", data[diagonal])
    size = np.abs(mobility[:, :dim])
    mean = size.mean(axis=1)
    # a direction without mobility takes the mean of the contact
    normal, tangent = (
        np.where(part > 1e-12 * mean, part, mean) for part in (size[:, 0], size[:, 1:].mean(axis=1))
    )
    both = np.column_stack([normal, tangent, tangent])
    unit = 1.0 / np.sqrt(np.where(both > 0.0, both, size.max(initial=0.0) or 1.0))  # D
    _rescale(data, columns, starts, diagonal, unit, carries)
    full = np.where(carries, full * unit, 0.0)
    data_size = float(norm(full)) or 1.0
    return ScaledFriction(
        blocks=data,
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
    """Record of a run, updated by the methods through :meth:`note`.

    Attributes
    ----------
    problem : ScaledFriction, which measures the errors
    target : float, error at which the run may stop; dimensionless
    callback : callable, optional, called as ``callback(iteration, residual)``
    started : float, start on the clock, s
    residuals, seconds : list of float, error and time, s, of every noted iterate
    trail : list of str, methods in their order
    best : ndarray, shape (contacts, 3), or None, best iterate so far, dimensionless
    smallest : float, error of it
    """

    problem: ScaledFriction
    target: float
    callback: Callable[[int, float], None] | None = None
    started: float = field(default_factory=perf_counter)
    residuals: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    trail: list[str] = field(default_factory=list)
    best: np.ndarray | None = None
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
    r"""Factorise :math:`A W + B`, ``left`` W + ``added``, with block-diagonal A and B.

    The matrix may be singular up to round-off where the impulses are not unique: the methods judge
    the solution, and a pivot of exactly zero returns None.
    """
    contacts = problem.friction.size
    n = 3 * contacts
    shape = (contacts, 3)
    blocks = problem.blocks
    if left is not None:
        blocks = _times_left(blocks, problem.starts, left)
    system = (problem.columns, problem.starts, problem.diagonal, blocks, added)
    if n <= SMALL or problem.columns.size > DENSE * contacts**2:
        full = np.zeros((n, n))
        _fill_full(*system, full)
        factors, pivots, info = dgetrf(full.T, overwrite_a=True)
        if info != 0:
            return None
        return lambda b: np.asarray(dgetrs(factors, pivots, b.ravel(), trans=1)[0]).reshape(shape)

    values, indices, pointers = _scalar_rows(*system)
    try:  # compressed rows of A W + B are compressed columns of its transpose
        sparse = splu(
            csc_matrix((values, indices, pointers), shape=(n, n)),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=PIVOT,
        )
    except RuntimeError:
        return None
    return lambda b: np.asarray(sparse.solve(b.ravel(), "T")).reshape(shape)


@compiled
def _with_diagonal(data, indices, indptr):  # type: ignore[no-untyped-def]
    """Copy block rows into 3x3 blocks, adding diagonal blocks that are missing."""
    contacts, dim = indptr.size - 1, data.shape[1]
    starts = np.zeros(contacts + 1, np.int64)
    for i in range(contacts):
        missing = 1
        for k in range(indptr[i], indptr[i + 1]):
            if indices[k] == i:
                missing = 0
        starts[i + 1] = starts[i] + indptr[i + 1] - indptr[i] + missing
    columns = np.empty(starts[-1], np.int64)
    diagonal = np.full(contacts, -1, np.int64)
    blocks = np.zeros((starts[-1], 3, 3))
    for i in range(contacts):
        place = starts[i]
        for k in range(indptr[i], indptr[i + 1]):
            if diagonal[i] < 0 and indices[k] >= i:
                diagonal[i] = place
                columns[place] = i
                if indices[k] > i:
                    place += 1
            columns[place] = indices[k]
            for a in range(dim):  # a slice would have the compiler write its error message
                for b in range(dim):
                    blocks[place, a, b] = data[k, a, b]
            place += 1
        if diagonal[i] < 0:
            diagonal[i] = place
            columns[place] = i
    return columns, starts, diagonal, blocks


@compiled
def _rescale(blocks, columns, starts, diagonal, unit, carries):  # type: ignore[no-untyped-def]
    """D W D in place; components that carry nothing keep only a one on the diagonal."""
    for i in range(starts.size - 1):
        for k in range(starts[i], starts[i + 1]):
            j = columns[k]
            for a in range(3):
                for b in range(3):
                    if carries[i, a] and carries[j, b]:
                        blocks[k, a, b] *= unit[i, a] * unit[j, b]
                    else:
                        blocks[k, a, b] = 0.0
        for a in range(3):
            if not carries[i, a]:
                blocks[diagonal[i], a, a] = 1.0


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


@compiled
def natural_map_norms(velocity, reaction, friction, mass, unit):  # type: ignore[no-untyped-def]
    """Norms of the natural map over its step, m/s: the contact mass, and the mass unit."""
    weighted, plain = 0.0, 0.0
    for i in range(friction.size):
        mu = friction[i]
        shift = mu * np.sqrt(velocity[i, 1] ** 2 + velocity[i, 2] ** 2)
        for turn in range(2):
            step = mass[i] if turn == 0 else unit
            y0 = reaction[i, 0] - step * (velocity[i, 0] + shift)
            y1 = reaction[i, 1] - step * velocity[i, 1]
            y2 = reaction[i, 2] - step * velocity[i, 2]
            length = np.sqrt(y1 * y1 + y2 * y2)
            if y0 < 0.0 or length > mu * y0:
                height = max(0.0, (y0 + mu * length) / (1.0 + mu * mu))
                shrink = mu * height / length if length > 0.0 else 0.0
                y0, y1, y2 = height, shrink * y1, shrink * y2
            square = (
                (reaction[i, 0] - y0) ** 2 + (reaction[i, 1] - y1) ** 2 + (reaction[i, 2] - y2) ** 2
            )
            if turn == 0:
                weighted += square / (step * step)
            else:
                plain += square / (step * step)
    return np.sqrt(weighted), np.sqrt(plain)


@compiled
def _times_left(blocks, starts, left):  # type: ignore[no-untyped-def]
    """Multiply the block rows of W by A."""
    out = np.empty_like(blocks)
    for i in range(starts.size - 1):
        for k in range(starts[i], starts[i + 1]):
            for a in range(3):
                for b in range(3):
                    out[k, a, b] = (
                        left[i, a, 0] * blocks[k, 0, b]
                        + left[i, a, 1] * blocks[k, 1, b]
                        + left[i, a, 2] * blocks[k, 2, b]
                    )
    return out


@compiled
def _fill_full(columns, starts, diagonal, blocks, added, full):  # type: ignore[no-untyped-def]
    """Write the blocks, with ``added`` on the diagonal, into a full matrix."""
    for i in range(starts.size - 1):
        for k in range(starts[i], starts[i + 1]):
            j = columns[k]
            for a in range(3):
                for b in range(3):
                    full[3 * i + a, 3 * j + b] = blocks[k, a, b]
                    if k == diagonal[i]:
                        full[3 * i + a, 3 * j + b] += added[i, a, b]


@compiled
def _scalar_rows(columns, starts, diagonal, blocks, added):  # type: ignore[no-untyped-def]
    """Compressed rows of the blocks with ``added`` on the diagonal."""
    contacts = starts.size - 1
    values = np.empty(9 * starts[-1])
    indices = np.empty(9 * starts[-1], np.int32)
    pointers = np.zeros(3 * contacts + 1, np.int32)
    place = 0
    for i in range(contacts):
        for a in range(3):
            for k in range(starts[i], starts[i + 1]):
                for b in range(3):
                    indices[place] = 3 * columns[k] + b
                    values[place] = blocks[k, a, b]
                    if k == diagonal[i]:
                        values[place] += added[i, a, b]
                    place += 1
            pointers[3 * i + a + 1] = place
    return values, indices, pointers
