r"""The friction problem in dimensionless 3x3 blocks: what every method of this folder works on."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from scipy.sparse import bsr_array, csr_array

from multiscale.nonsmooth.coulomb import ROUND_OFF, closing_norm, contact_mass
from multiscale.numerics.compiled import compiled

__all__ = ["ScaledFriction", "scale_friction"]


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
        squares = natural_map_squares(
            self.respond(reaction) * self.velocity_unit,
            reaction * self.reaction_unit,
            *self.measure,
        )
        slack = ROUND_OFF * float(norm(reaction * self.reaction_unit)) / self.measure[2]
        return max(float(squares[0]), float(squares[1]) - slack) / self.size


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
    own = np.abs(mobility[:, :dim])
    mean = own.mean(axis=1)
    # a direction that nothing moves is measured by the others
    normal, tangent = (
        np.where(one > 1e-12 * mean, one, mean) for one in (own[:, 0], own[:, 1:].mean(axis=1))
    )
    both = np.column_stack([normal, tangent, tangent])
    unit = 1.0 / np.sqrt(np.where(both > 0.0, both, own.max(initial=0.0) or 1.0))  # D
    _rescale(data, columns, starts, diagonal, unit, carries)
    full = np.where(carries, full * unit, 0.0)
    size = float(norm(full)) or 1.0
    return ScaledFriction(
        blocks=data,
        columns=columns,
        starts=starts,
        diagonal=diagonal,
        velocity=full / size,
        friction=np.where(friction > 0.0, friction, 1.0) * unit[:, 0] / unit[:, 1],  # (1)
        reaction_unit=unit * size,
        velocity_unit=size / unit,
        measure=(
            np.ascontiguousarray(friction, dtype=float),
            contact_mass(mobility[:, :dim]),
            step,
        ),
        size=closing_norm(velocity.reshape(contacts, dim)),
    )


@compiled
def _with_diagonal(data, indices, indptr):  # type: ignore[no-untyped-def]
    """Copy block rows into 3x3 blocks, adding diagonal blocks that are missing."""
    contacts, dim = indptr.size - 1, data.shape[1]
    starts = np.zeros(contacts + 1, np.int64)
    for i in range(contacts):
        found = 1
        for k in range(indptr[i], indptr[i + 1]):
            if indices[k] == i:
                found = 0
        starts[i + 1] = starts[i] + indptr[i + 1] - indptr[i] + found
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
def natural_map_squares(velocity, reaction, friction, mass, unit):  # type: ignore[no-untyped-def]
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
