"""Coarse motions of interfaces: the problem that they carry, and stiffnesses against them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array

from multiscale.errors import CaseError, MultiscaleError
from multiscale.fe.condensation import compliances
from multiscale.macro.substructures.parallel import ProcessGroup
from multiscale.macro.substructures.problem import CutInterface, CutProblem
from multiscale.macro.substructures.stack import (
    Factors,
    Sides,
    Stack,
    lay_out_sides,
    split_columns,
    stack_parts,
)
from multiscale.numerics.factorisation import Solve, on_diagonal
from multiscale.schema import HOMOGENISED, Dataset

__all__ = ["Coarse", "coarse_basis", "homogenise", "prepare_coarse"]

INDEPENDENT = 1e-8
"""Size of a motion, relative to the largest, below which it is no motion of the interface."""

HELD = 1e-12
"""Stiffness lent to every unknown, relative to its diagonal, for mechanisms inside."""


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


def homogenise(problem: CutProblem, result: Dataset | None = None, *, step: int = -1) -> Dataset:
    r"""Condense every substructure onto the resultants of its interfaces.

    .. math::
        w^T K_E^H w = \min_{C_E u = w} u^T (K_E + B_E^T k_E B_E) u,    \tag{1}

    the stiffness against the coarse motions :math:`w` of the interfaces while nothing but the
    resultants :math:`K_E^H w` acts on them; once with all links taut and once without the
    stiffness of the slack ones.

    Parameters
    ----------
    problem : CutProblem, the structure, cut
    result : Dataset, optional
        Says by ``slack (step, link)`` which links are slack; not needed without links.
    step : int, step of the result

    Returns
    -------
    Dataset
        Follows ``HOMOGENISED``. ``coarse_unknown`` numbers what a resultant is: two
        substructures that have it in common share the number, and assembling by it gives the
        stiffness of the coarse structure.

    Raises
    ------
    CaseError
        If the result is not one of this structure, or its step did not converge.

    Notes
    -----
    With :math:`G = C (K + \kappa C^T C)^{-1} C^T`, (1) is :math:`G^{-1} - \kappa I` for every
    :math:`\kappa > 0`, even where :math:`K` is singular; here it is the largest stiffness of an
    unknown. The coarse motions of an interface are orthonormal in its nodes (of a joint, in its
    points).

    The kernel holds the rigid motions of a substructure without supports, and the mechanisms of
    its links: a floating part of a tensegrity may have some although all its links are taut.
    """
    slack = _slack_links(problem, result, step)
    parts = stack_parts(problem, range(len(problem.substructures)))
    motions = csr_array(parts.trace.T @ coarse_basis(problem)[lay_out_sides(problem).slot])
    used, columns = split_columns(motions, parts.start)  # coarse unknowns, C_E^T
    width = max((item.size for item in used), default=0)
    number = np.full((len(used), width), -1)
    rigid = np.full((len(used), width, 6), np.nan)
    for row, (C, item) in enumerate(zip(columns, used, strict=True)):
        number[row, : item.size] = item
        rigid[row, : item.size] = C.T @ problem.substructures[row].rigid_motions
    mine = slack[parts.links.number] if problem.n_links else np.zeros(0, dtype=bool)
    taut = np.ones(mine.size)
    dataset = HOMOGENISED.build(
        {
            "stiffness": [
                _condensed(parts, share, columns, width) for share in (taut, np.where(mine, 0, 1.0))
            ],
            "coarse_unknown": number,
            "rigid_motion": rigid,
            "slack_links": [
                int(slack[part.links.number].sum()) if part.links else 0
                for part in problem.substructures
            ],
        },
        coarse_unknowns=int(number.max(initial=-1)) + 1,
    )
    return dataset.assign_coords(status=["taut", "slackened"])


def _slack_links(problem: CutProblem, result: Dataset | None, step: int) -> np.ndarray:
    """Which links are slack, shape (links,)."""
    if not problem.n_links:
        return np.zeros(0, dtype=bool)
    if result is None or "slack" not in result:
        raise CaseError(
            f"the {problem.n_links} links need a result with 'slack'; give the result of a solver"
        )
    slack = result.slack.isel(step=step) if "step" in result.slack.dims else result.slack
    if slack.shape != (problem.n_links,):
        raise CaseError(
            f"the result must be of the {problem.n_links} links of the problem, got {slack.shape}"
        )
    if not np.isfinite(slack).all():
        raise CaseError(f"step {step} of the result did not converge: its slacks are NaN")
    return np.asarray(slack.values > 0.0)


def _condensed(
    parts: Stack, share: np.ndarray, columns: list[np.ndarray], width: int
) -> np.ndarray:
    """Evaluate (1) for all substructures at once, shape (substructures, width, width), N/m."""
    matrix = parts.matrix(share * parts.links.stiffness, None)
    taut = parts.matrix(parts.links.stiffness, None).diagonal()
    C = on_diagonal(columns)
    kappa = float(taut.max())
    held = diags_array(HELD * np.where(taut > 0.0, taut, kappa))
    answer_to = Factors()(csr_array(matrix + held + kappa * (C @ C.T)))
    condensed = np.full((len(columns), width, width), np.nan)
    start = np.cumsum([0, *(item.shape[1] for item in columns)])
    for place, flexibility in zip(
        condensed, compliances(answer_to, csr_array(C.T), start), strict=True
    ):
        size = len(flexibility)
        stiffness = np.linalg.inv(flexibility) - kappa * np.eye(size)
        place[:size, :size] = 0.5 * (stiffness + stiffness.T)
    return condensed
