"""Coarse motions of interfaces: coarse problem, homogenised stiffness, BDDC preconditioner."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array

from multiscale.errors import CaseError, MultiscaleError
from multiscale.fe.condensation import Split, compliances
from multiscale.macro.substructures.problem import CutInterface, CutProblem
from multiscale.macro.substructures.stack import (
    Factors,
    ProcessGroup,
    Sides,
    Stack,
    lay_out_sides,
    split_columns,
    stack_substructures,
    together,
)
from multiscale.numerics.factorisation import Solve, on_diagonal
from multiscale.schema import HOMOGENISED, Dataset

INDEPENDENT = 1e-8
"""Singular value of a motion, relative to the largest, below which it depends on the others."""

LENT = 1e-12
"""Stiffness lent to every unknown, relative to its diagonal, for mechanisms inside."""


def coarse_basis(problem: CutProblem) -> csr_array:
    """Motions with work that the coarse problem balances, shape (slots, coarse unknowns).

    The resultants of an interface between two substructures, and every force of a weak
    cross-point, where three or more meet: without them the method diverges.
    """
    blocks = [_basis_of(face, problem) for face in problem.interfaces]
    return on_diagonal(blocks) if blocks else csr_array((0, 0))


def _basis_of(face: CutInterface, problem: CutProblem) -> np.ndarray:
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
    basis: csr_array,
    side_stiffness: csr_array,
    stack: Stack,
    sides: Sides,
    local: range,
    solve: Solve,
    factors: Factors,
    team: ProcessGroup,
) -> Coarse:
    r"""Condense the linear stage onto the coarse unknowns.

    .. math:: L = \sum_E P^T k_0 P - (k_0 P)^T T H T^T k_0 P,    \tag{1}

    with the inverse :math:`H` of the matrix of every substructure. One solve with several right
    sides serves all substructures, because their matrices are blocks of a diagonal matrix.
    """
    # H T^T k_0 P: column j of a substructure is the answer to its coarse motion j
    on_sides = csr_array(basis[sides.slot])
    push = csr_array(side_stiffness @ on_sides)
    first = sides.start[local.start] if len(local) else 0
    local_push = csr_array(stack.trace.T @ push[first : first + stack.trace.shape[0]])
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
    stack = stack_substructures(problem, range(len(problem.substructures)))
    motions = csr_array(stack.trace.T @ coarse_basis(problem)[lay_out_sides(problem).slot])
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
                int(slack[substructure.links.number].sum()) if substructure.links else 0
                for substructure in problem.substructures
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


@dataclass(frozen=True, eq=False)
class Layout:
    """Shared and coarse unknowns of the p substructures of a process, in padded tables.

    Rows with fewer than w shared or c coarse unknowns are filled up by ``n_shared`` and
    ``n_coarse``.
    """

    shared: np.ndarray  # numbers of the shared unknowns, (p, w)
    coarse: np.ndarray  # numbers of the coarse unknowns, (p, c)
    constraint: np.ndarray  # coarse unknowns from the shared unknowns, C_E, (p, c, w)
    n_shared: int
    n_coarse: int
    # size of every interface; its substructures in this process and its columns in each
    faces: list[tuple[int, list[tuple[int, np.ndarray]]]]
    team: ProcessGroup  # processes that share the substructures

    def gather(self, blocks: list[np.ndarray]) -> np.ndarray:
        """Stack the matrices of the substructures in an array, shape (p, w, w)."""
        width = self.shared.shape[1]
        table = np.zeros((len(blocks), width, width))
        for place, block in zip(table, blocks, strict=True):
            place[: len(block), : len(block)] = block
        return table

    def take(self, value: np.ndarray) -> np.ndarray:
        """Restrict shared unknowns to every substructure, shape (p, w)."""
        return np.asarray(np.append(value, 0.0)[self.shared])

    def add(self, value: np.ndarray) -> np.ndarray:
        """Add up over the substructures of all processes, shape (shared,)."""
        force = np.bincount(self.shared.ravel(), value.ravel(), self.n_shared + 1)
        return self.team.total(force[:-1])

    def multiply(self, schur: np.ndarray, value: np.ndarray) -> np.ndarray:
        """Apply the sum of the matrices of the substructures, shape (shared,)."""
        return self.add(np.einsum("pij,pj->pi", schur, self.take(value)))


def lay_out(
    split: Split,
    slot: np.ndarray,
    basis: csr_array,
    interfaces: Sequence[CutInterface],
    local: range,
    team: ProcessGroup,
) -> Layout:
    """Tabulate the unknowns of the substructures of this process, ``local``."""
    n_shared, n_coarse = basis.shape
    count = split.edge_start.size - 1
    shared = np.full((count, int(np.diff(split.edge_start).max(initial=0))), n_shared)
    shared[split.owner, split.column] = slot
    used, motions = split_columns(csr_array(basis[slot]), split.edge_start)
    width = max((item.size for item in used), default=0)
    coarse = np.full((count, width), n_coarse)
    constraint = np.zeros((count, width, shared.shape[1]))
    for owner, (block, item) in enumerate(zip(motions, used, strict=True)):
        coarse[owner, : item.size] = item
        constraint[owner, : item.size, : block.shape[0]] = block.T
    order, faces, first = np.argsort(shared, axis=1), [], 0
    for face in interfaces:
        rows = np.arange(first, first + face.size)
        owners = [owner - local.start for owner in face.sides if owner in local]
        at = [order[owner][np.searchsorted(shared[owner][order[owner]], rows)] for owner in owners]
        faces.append((face.size, list(zip(owners, at, strict=True))))
        first += face.size
    return Layout(shared, coarse, constraint, n_shared, n_coarse, faces, team)


@dataclass(frozen=True, eq=False)
class Balancing:
    r"""Preconditioner by balanced solves of the substructures.

    .. math:: M^{-1} = \sum_E R_E^T D_E (Z_E + \Phi_E L^{-1} \Psi_E^T) D_E R_E,    \tag{1}

    where, with the Schur complement :math:`S_E` and the coarse unknowns :math:`C_E`,

    .. math::
        \begin{pmatrix} S_E & C_E^T \\ C_E & 0 \end{pmatrix}^{-1} =
        \begin{pmatrix} Z_E & \Phi_E \\ \Psi_E^T & -L_E \end{pmatrix}, \qquad
        L = \sum_E L_E.    \tag{2}

    References
    ----------
    .. [1] C. R. Dohrmann, SIAM J. Sci. Comput. 25 (2003) 246-258,
       doi:10.1137/S1064827502412887.
    """

    layout: Layout
    fine: np.ndarray
    right: np.ndarray
    left: np.ndarray
    solve: Solve | None

    def __call__(self, force: np.ndarray) -> np.ndarray:
        """Approximate displacement of the shared unknowns for a force on them."""
        layout = self.layout
        shares = layout.take(force)
        u = np.einsum("pij,pj->pi", self.fine, shares)
        if self.solve is not None:
            amount = np.einsum("pij,pj->pi", self.left, shares)
            total = np.bincount(layout.coarse.ravel(), amount.ravel(), layout.n_coarse + 1)
            w = np.append(self.solve(layout.team.total(total[:-1])), 0.0)
            u += np.einsum("pij,pj->pi", self.right, w[layout.coarse])
        return layout.add(u)


def prepare_balancing(
    layout: Layout, schur: np.ndarray, added: np.ndarray, factorise: Callable[[csr_array], Solve]
) -> Balancing:
    """Invert (2) for every substructure and factorise the coarse matrix."""
    # (2), scaled by the largest stiffness; padding has a unit diagonal
    count, width = layout.shared.shape
    size = layout.coarse.shape[1]
    real, wanted = layout.shared < layout.n_shared, layout.coarse < layout.n_coarse
    diagonal = np.where(real, np.einsum("pii->pi", schur) + added, 0.0)
    unit = np.max(diagonal, axis=1, initial=0.0)
    unit[unit <= 0.0] = 1.0
    matrix = np.zeros((count, width + size, width + size))
    matrix[:, :width, :width] = schur / unit[:, None, None]
    at = np.arange(width)
    matrix[:, at, at] += np.where(real, added / unit[:, None], 1.0)
    matrix[:, width:, :width] = layout.constraint
    matrix[:, :width, width:] = layout.constraint.transpose(0, 2, 1)
    at = np.arange(width, width + size)
    matrix[:, at, at] += np.where(wanted, 0.0, 1.0)
    inverse = together(layout.team, lambda: np.linalg.inv(matrix))

    # assemble L
    coarse = -inverse[:, width:, width:] * unit[:, None, None]
    rows = np.broadcast_to(layout.coarse[:, :, None], coarse.shape)
    columns = np.broadcast_to(layout.coarse[:, None, :], coarse.shape)
    used = wanted[:, :, None] & wanted[:, None, :]
    entries = layout.team.collect([(coarse[used], rows[used], columns[used])])
    value, row, column = (np.concatenate(item) for item in zip(*entries, strict=True))
    assembled = csr_array(coo_array((value, (row, column)), shape=(layout.n_coarse,) * 2))
    D = together(layout.team, partial(_scaling, layout, schur, added))
    return Balancing(
        layout,
        D @ (inverse[:, :width, :width] / unit[:, None, None]) @ D.transpose(0, 2, 1),
        D @ inverse[:, :width, width:],
        inverse[:, width:, :width] @ D.transpose(0, 2, 1),
        _solve_first(layout.team, assembled, factorise) if layout.n_coarse else None,
    )


def _solve_first(
    team: ProcessGroup, matrix: csr_array, factorise: Callable[[csr_array], Solve]
) -> Solve:
    """Solve on the first process and send the result, so that all have the same digits."""
    solve = together(team, lambda: None if team.rank else factorise(matrix))
    return lambda right: team.total(np.zeros_like(right) if solve is None else solve(right))


def _scaling(layout: Layout, schur: np.ndarray, added: np.ndarray) -> np.ndarray:
    r"""Share of every substructure in the motion of an interface :math:`F`.

    .. math:: D_E = \Big( \sum_{E'} S_{E'}^{FF} \Big)^{-1} S_E^{FF}    \tag{3}
    """
    D = np.zeros_like(schur)
    blocks, sums = [], [np.zeros(0)]
    for size, sides in layout.faces:
        of_sides = []
        for owner, at in sides:
            block = schur[owner][np.ix_(at, at)]
            of_sides.append(0.5 * (block + block.T) + np.diag(added[owner, at]))
        blocks.append(of_sides)
        sums.append(sum(of_sides, np.zeros((size, size))).ravel())
    # sum over the processes for all interfaces together, then (3)
    total, first = layout.team.total(np.concatenate(sums)), 0
    for (size, sides), of_sides in zip(layout.faces, blocks, strict=True):
        whole = total[first : first + size**2].reshape(size, size)
        first += size**2
        for (owner, at), block in zip(sides, of_sides, strict=True):
            D[owner][np.ix_(at, at)] = np.linalg.solve(whole, block)
    return D
