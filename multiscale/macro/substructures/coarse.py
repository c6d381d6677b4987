"""The coarse problem: forces of the interfaces that act over long distances."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array, csr_array

from multiscale.errors import MultiscaleError
from multiscale.macro.substructures.parallel import ProcessGroup
from multiscale.macro.substructures.problem import CutInterface, CutProblem
from multiscale.macro.substructures.stack import Factors, Sides, Stack, split_columns
from multiscale.numerics.factorisation import Solve, on_diagonal

__all__ = ["Coarse", "coarse_basis", "prepare_coarse"]

INDEPENDENT = 1e-8
"""Size of a motion, relative to the largest, below which it is no motion of the interface."""


def coarse_basis(problem: CutProblem) -> csr_array:
    """Motions whose work the coarse problem balances, shape (slots, coarse unknowns).

    The resultants of an interface between two substructures, and every force of a weak
    cross-point, where three or more meet: without them the method diverges.
    """
    blocks = [_basis_of(face, problem) for face in problem.interfaces]
    return on_diagonal(blocks) if blocks else csr_array((0, 0))


def _basis_of(face: CutInterface, problem: CutProblem) -> np.ndarray:
    """Orthonormal motions of one interface."""
    if len(face.sides) > 2:
        return np.eye(face.size)
    first = int(not face.trace[0].nnz)  # the ground does not move
    motions = face.trace[first] @ problem.substructures[face.sides[first]].rigid_motions
    moved = np.abs(motions).max(axis=0)
    motions = motions[:, moved > 0.0] / moved[moved > 0.0]
    left, size, _ = np.linalg.svd(motions, full_matrices=False)
    return np.asarray(left[:, size > INDEPENDENT * size[0]])


@dataclass(frozen=True, eq=False)
class Coarse:
    r"""Multiplier :math:`w` that balances the coarse forces of a linear stage.

    Attributes
    ----------
    push : csr_array, shape (m, coarse), :math:`k_0 P`: force on every side of a coarse motion
    basis : csr_array, shape (m, coarse), :math:`P` on every side
    answer : ndarray, shape (n, columns)
        Displacement of the substructures of this process for the coarse motions of each, side
        by side.
    column : ndarray of int, shape (n, columns)
        Coarse unknown of every entry of ``answer``; the last one is a dummy.
    solve : callable, with the coarse matrix
    """

    push: csr_array
    basis: csr_array
    answer: np.ndarray
    column: np.ndarray
    solve: Solve

    def respond(self, w: np.ndarray) -> np.ndarray:
        """Displacement that the multiplier brings, shape (n,), m."""
        return np.asarray(np.einsum("nc,nc->n", self.answer, np.append(w, 0.0)[self.column]))


def prepare_coarse(
    basis: csr_array,
    side_stiffness: csr_array,
    stack: Stack,
    sides: Sides,
    parts: range,
    solve: Solve,
    factors: Factors,
    team: ProcessGroup,
) -> Coarse:
    r"""Condense the linear stage onto the coarse unknowns.

    .. math:: L = \sum_E P^T k_0 P - (k_0 P)^T T H T^T k_0 P,    \tag{1}

    with the inverse :math:`H` of the matrix of every substructure. All substructures are solved
    at once: the columns of different ones do not meet.
    """
    on_sides = csr_array(basis[sides.slot])
    push = csr_array(side_stiffness @ on_sides)
    first = sides.start[parts.start] if len(parts) else 0
    local_push = csr_array(stack.trace.T @ push[first : first + stack.trace.shape[0]])
    columns, pushes = split_columns(local_push, stack.start)
    width = max((used.size for used in columns), default=0)
    right = np.zeros((stack.n, width))
    column = np.full((stack.n, width), basis.shape[1])
    ends = list(pairwise(stack.start))
    for used, block, (a, b) in zip(columns, pushes, ends, strict=True):
        right[a:b, : used.size], column[a:b, : used.size] = block, used
    answer = solve(right)

    triplets = []
    for used, block, (a, b) in zip(columns, pushes, ends, strict=True):
        product = -block.T @ answer[a:b, : used.size]
        triplets.append((np.repeat(used, used.size), np.tile(used, used.size), product.ravel()))
    rows, cols, values = (
        np.concatenate(item) for item in zip(*team.collect(triplets), strict=True)
    )
    matrix = coo_array((values, (rows, cols)), shape=(basis.shape[1],) * 2)
    try:
        factor = factors(csr_array(matrix + on_sides.T @ push))
    except MultiscaleError as error:
        raise MultiscaleError(
            "the coarse problem of the substructures is singular: all of them together can move "
            "without resistance; add supports, or prestress where nothing is taut"
        ) from error
    return Coarse(push, on_sides, answer, column, factor)
