"""Coarse motions of interfaces: coarse problem of LATIN, homogenised stiffness."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array

from multiscale.errors import CaseError, MultiscaleError
from multiscale.fe.elasticity import compliances
from multiscale.macro.substructures.problem import CutInterface, CutProblem
from multiscale.macro.substructures.stack import (
    LENT,
    Factors,
    Stack,
    split_columns,
    stack_substructures,
)
from multiscale.numerics.factorisation import Solve, on_diagonal
from multiscale.schema import HOMOGENISED, Dataset

INDEPENDENT = 1e-8
"""Singular value of a motion, relative to the largest, below which it depends on the others."""


def coarse_basis(problem: CutProblem) -> csr_array:
    """Motions with work that the coarse problem balances, shape (slots, coarse unknowns)."""
    blocks = [interface_motions(face, problem) for face in problem.interfaces]
    return on_diagonal(blocks) if blocks else csr_array((0, 0))


def interface_motions(face: CutInterface, problem: CutProblem) -> np.ndarray:
    """Orthonormal motions of an interface."""
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
    r"""Coarse problem of a linear stage: a multiplier :math:`w` balances the coarse forces."""

    push: csr_array  # k_0 P, force of coarse motions on every side, (m, coarse)
    basis: csr_array  # P on every side, (m, coarse)
    answer: np.ndarray  # displacement by the coarse motions of each substructure, (n, columns)
    column: np.ndarray  # coarse unknown of every entry of answer, or the number of all: a dummy
    solve: Solve  # with the coarse matrix

    def respond(self, w: np.ndarray) -> np.ndarray:
        """Displacement by the multiplier, shape (n,), m."""
        return np.asarray(np.einsum("nc,nc->n", self.answer, np.append(w, 0.0)[self.column]))


def prepare_coarse(
    basis: csr_array, side_stiffness: csr_array, stack: Stack, solve: Solve, factors: Factors
) -> Coarse:
    """Condense the linear stage onto the coarse unknowns."""
    # H T^T k_0 P: column j of a substructure is the answer to its coarse motion j
    # L = sum P^T k_0 P - (k_0 P)^T T H T^T k_0 P, with the inverse H of every substructure (1); all
    # are blocks of a diagonal matrix, so a single solve with several right sides is sufficient for
    # them
    on_sides = csr_array(basis[stack.sides.slot])
    push = csr_array(side_stiffness @ on_sides)
    local_push = csr_array(stack.trace.T @ push[stack.rows])
    columns, pushes = split_columns(local_push, stack.start)
    width = max((used.size for used in columns), default=0)
    right = np.zeros((stack.n, width))
    column = np.full((stack.n, width), basis.shape[1])
    ends = list(pairwise(stack.start))
    for used, block, (a, b) in zip(columns, pushes, ends, strict=True):
        right[a:b, : used.size], column[a:b, : used.size] = block, used
    answer = solve(right)

    # assemble (1)
    triplets = []
    for used, block, (a, b) in zip(columns, pushes, ends, strict=True):
        product = -block.T @ answer[a:b, : used.size]
        triplets.append((np.repeat(used, used.size), np.tile(used, used.size), product.ravel()))
    rows, cols, values = (
        np.concatenate(item) for item in zip(*stack.team.collect(triplets), strict=True)
    )
    matrix = coo_array((values, (rows, cols)), shape=(basis.shape[1],) * 2)
    try:
        factor = factors(csr_array(matrix + on_sides.T @ push))
    except MultiscaleError as error:
        raise MultiscaleError(
            "the coarse problem of the substructures is singular: all of them together can move "
            "without resistance; add supports, or prestress where all links are slack"
        ) from error
    return Coarse(push, on_sides, answer, column, factor)


def homogenise(problem: CutProblem, result: Dataset | None = None, *, step: int = -1) -> Dataset:
    r"""Condense every substructure onto the resultants of its interfaces.

    .. math::
        w^T K_E^H w = \min_{C_E u = w} u^T (K_E + B_E^T k_E B_E) u,    \tag{1}

    the stiffness against the coarse motions :math:`w` of the interfaces while only the resultants
    :math:`K_E^H w` act on them; first with all links taut, then without the stiffness of slack
    links.

    Parameters
    ----------
    problem : CutProblem, the structure, cut
    result : Dataset, optional
        Its ``slack (step, link)`` marks the slack links; not needed without links.
    step : int, step of the result

    Returns
    -------
    Dataset
        Follows ``HOMOGENISED``. ``coarse_unknown`` is the number of each resultant, the same in
        both substructures that share the resultant: assembly by it gives the stiffness of the
        coarse structure.

    Raises
    ------
    CaseError
        If the result belongs to another structure, or its step did not converge.

    Notes
    -----
    With :math:`G = C (K + \kappa C^T C)^{-1} C^T`, (1) is :math:`G^{-1} - \kappa I` for every
    :math:`\kappa > 0`, even where :math:`K` is singular; here it is the largest stiffness of an
    unknown. The coarse motions of an interface are orthonormal in its nodes (of a joint, in its
    points).

    The kernel contains the rigid motions of a substructure without supports, and the mechanisms of
    its links: a floating substructure of a tensegrity may have mechanisms although all its links
    are taut.
    """
    # coarse motions of each substructure, C_E^T, and its rigid motions
    slack = _slack_links(problem, result, step)
    stack = stack_substructures(problem)
    motions = csr_array(stack.trace.T @ coarse_basis(problem)[stack.sides.slot])
    used, columns = split_columns(motions, stack.start)
    width = max((item.size for item in used), default=0)
    number = np.full((len(used), width), -1)
    rigid = np.full((len(used), width, 6), np.nan)
    for row, (C, item) in enumerate(zip(columns, used, strict=True)):
        number[row, : item.size] = item
        rigid[row, : item.size] = C.T @ problem.substructures[row].rigid_motions
    # (1) with all links taut, and without the slack links
    slackened = slack[stack.links.number] if problem.n_links else np.zeros(0, dtype=bool)
    taut = np.ones(slackened.size)
    dataset = HOMOGENISED.build(
        {
            "stiffness": [
                _condensed(stack, share, columns, width)
                for share in (taut, np.where(slackened, 0, 1.0))
            ],
            "coarse_unknown": number,
            "rigid_motion": rigid,
            "slack_links": [
                int(slack[each.links.number].sum()) if each.links else 0
                for each in problem.substructures
            ],
        },
        coarse_unknowns=int(number.max(initial=-1)) + 1,
    )
    return dataset.assign_coords(status=["taut", "slackened"])


def _slack_links(problem: CutProblem, result: Dataset | None, step: int) -> np.ndarray:
    if not problem.n_links:
        return np.zeros(0, dtype=bool)
    if result is None or "slack" not in result:
        raise CaseError(
            f"the {problem.n_links} links need a result with 'slack'; give the result of a solver"
        )
    slack = result.slack.isel(step=step) if "step" in result.slack.dims else result.slack
    if slack.shape != (problem.n_links,):
        raise CaseError(
            f"slack of the result must have an entry for each of the {problem.n_links} links of "
            f"the problem, got shape {slack.shape}"
        )
    if not np.isfinite(slack).all():
        raise CaseError(f"step {step} of the result did not converge: its slack is NaN")
    return np.asarray(slack.values > 0.0)


def _condensed(
    stack: Stack, share: np.ndarray, columns: list[np.ndarray], width: int
) -> np.ndarray:
    """Evaluate (1) for all substructures at once, shape (substructures, width, width), N/m."""
    matrix = stack.matrix(share * stack.links.stiffness, None)
    taut = stack.matrix(stack.links.stiffness, None).diagonal()
    C = on_diagonal(columns)
    kappa = float(taut.max())
    lent = diags_array(LENT * np.where(taut > 0.0, taut, kappa))
    solve = Factors()(csr_array(matrix + lent + kappa * (C @ C.T)))
    condensed = np.full((len(columns), width, width), np.nan)
    start = np.cumsum([0, *(item.shape[1] for item in columns)])
    for place, flexibility in zip(
        condensed, compliances(solve, csr_array(C.T), start), strict=True
    ):
        size = len(flexibility)
        stiffness = np.linalg.inv(flexibility) - kappa * np.eye(size)
        place[:size, :size] = 0.5 * (stiffness + stiffness.T)
    return condensed
