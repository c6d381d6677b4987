"""Tangent of a cut structure: condensed substructures and systems of the shared unknowns."""

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.linalg import eigvalsh, norm
from scipy.sparse import csr_array, diags_array, eye_array
from scipy.sparse.linalg import LinearOperator, gmres

from multiscale.errors import CaseError, MultiscaleError
from multiscale.fe.elasticity import CondensedStiffness, condense, split
from multiscale.fe.multigrid import joint_matrix
from multiscale.macro.substructures.balancing import Balancing, lay_out
from multiscale.macro.substructures.problem import CutProblem, Substructure
from multiscale.macro.substructures.stack import (
    LENT,
    Factors,
    ProcessGroup,
    stack_substructures,
    together,
)
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.krylov import conjugate_gradients, ritz_values

REGULAR, WITH_JOINTS = 1e-10, 1e-6
"""Stiffness lent to shared unknowns in the preconditioner, relative to the diagonal without slack:
more acts as an elastic foundation below all interfaces and costs Krylov iterations. On joints 1e12
times stiffer than the bodies, less is rounded away."""

DENSE = 400
"""Unknowns up to which the tangent of a substructure is a dense matrix."""

ROUNDING, EXAMINED = 1e-8, 3000
"""Negative eigenvalue, relative to the largest, that is ascribed to rounding; and unknowns of a
substructure up to which its eigenvalues are computed after a failure."""

KRYLOV, RESTART = 2000, 100
"""Iteration limit of a linear system, and iterations between restarts of GMRES. They cost far less
than the factors; inaccurate directions would slow Newton's method down on large grids."""


class Direction(NamedTuple):
    """Solution of a linear system."""

    value: np.ndarray  # m
    iterations: int
    condition: float  # of the preconditioned tangent; NaN where it is not symmetric
    unfinished: bool


class CutTangent:
    """Tangent of the substructures of a process, condensed again where it changes."""

    def __init__(self, problem: CutProblem, team: ProcessGroup) -> None:
        self.team, self.n, self.softens = team, problem.n, bool(problem.joints)
        perfect = _move_joints_inside(problem)
        self.stack = stack_substructures(perfect, team)
        local = self.local = self.stack.local
        self.unknown = np.concatenate([perfect.substructures[owner].unknown for owner in local])

        # rows of every substructure: unknowns, shared unknowns, links
        shared, links = split(self.stack.start, self.stack.shared), self.stack.links
        bodies = [perfect.substructures[owner] for owner in local]
        sizes = [each.n_links for each in bodies]
        self.spans, self.edges, self.rows = (
            [slice(a, b) for a, b in pairwise(start.tolist())]
            for start in (self.stack.start, shared.edge_start, np.cumsum([0, *sizes]))
        )
        self.splits = [
            split(np.array([0, span.stop - span.start]), self.stack.shared[span])
            for span in self.spans
        ]
        numbers = np.arange(len(local))
        self.of_unknown = np.repeat(numbers, np.diff(self.stack.start))
        self.of_link = np.repeat(numbers, sizes)

        # joints inside these substructures
        joints = list(enumerate(problem.joints))
        self.joints = [place for place, joint in joints if joint.sides[1] in local]
        self.points = np.r_[(slice(0), *(problem.points[place] for place in self.joints))]
        owners = [problem.joints[at].sides[1] - local.start for at in self.joints]
        counts = [problem.joints[at].weight.size for at in self.joints]
        self.of_point = np.repeat(np.array(owners, dtype=int), counts)
        self.jump = self._inside(problem.jump)

        # preconditioner
        slot = np.zeros(self.stack.n, dtype=int)
        slot[self.stack.trace.indices] = self.stack.sides.slot[self.stack.rows]
        self.slot = slot[shared.edge]
        layout = lay_out(shared, self.slot, self.stack)
        self.taut = self.assemble(self.stack.matrix(links.stiffness, None).diagonal())[self.unknown]
        added = np.zeros(layout.shared.shape)
        lent = WITH_JOINTS if problem.joints else REGULAR
        added[shared.owner, shared.column] = lent * self.taut[shared.edge]
        self.balancing = Balancing(layout, added)

        # factors, and the tangent that they have
        self.factors, self.coarse_factors = [Factors() for _ in local], Factors()
        self.condensed: list[CondensedStiffness] = []
        self.symmetric = True
        self._forget()

    def _inside(self, jump: csr_array) -> csr_array:
        """Jumps of the points of this process from the unknowns of their substructures."""
        rows = (jump.shape[0] // 3 * np.arange(3)[:, None] + self.points).ravel()
        entries = jump[rows].tocoo()
        row, column = entries.coords
        key = self.of_unknown * self.n + self.unknown
        order = np.argsort(key)
        sought = np.tile(self.of_point, 3)[row] * self.n + column
        at = order[np.searchsorted(key, sought, sorter=order)]
        return csr_array((entries.data, (row, at)), shape=(rows.size, self.stack.n))

    def _forget(self) -> None:
        self.condensed = []
        self.share = np.full(self.of_link.size, np.nan)
        self.tangent = np.full((3, 3, self.of_point.size), np.nan)

    def assemble(self, force: np.ndarray) -> np.ndarray:
        """Add up over the substructures of all processes, shape (n,)."""
        return self.team.total(np.bincount(self.unknown, force, minlength=self.n))

    def total(self, value: float | np.integer) -> float:
        """Add up over the processes."""
        return float(self.team.total(np.array([value], dtype=float))[0])

    def matrix(self, share: np.ndarray, tangent: np.ndarray) -> csr_array:
        """Tangent of all substructures for the stiffness of links and joints."""
        matrix = self.stack.matrix(share * self.stack.links.stiffness, None)
        if self.points.size:
            matrix += self.jump.T @ joint_matrix(tangent) @ self.jump
        return csr_array(matrix + LENT * diags_array(self.taut))

    def block(self, matrix: csr_array, owner: int) -> csr_array | np.ndarray:
        """Select the block of a substructure of this process; small blocks are dense."""
        span = self.spans[owner]
        first, last = matrix.indptr[span.start], matrix.indptr[span.stop]
        entries = matrix.data[first:last], matrix.indices[first:last] - span.start
        start = matrix.indptr[span.start : span.stop + 1] - first
        block = csr_array((*entries, start), shape=(start.size - 1,) * 2)
        return block.toarray() if start.size <= DENSE else block

    def renew(self, share: np.ndarray, tangent: np.ndarray) -> None:
        """Condense the substructures, and renew the preconditioner, where the tangent changed."""
        # substructures with a new tangent, and those with a tangent that is not symmetric
        count = len(self.spans)
        new = np.full(count, 0 if self.condensed else 1)
        new += np.bincount(self.of_link[share != self.share], minlength=count)
        other = np.any(tangent != self.tangent, axis=(0, 1))
        new += np.bincount(self.of_point[other], minlength=count)
        skew = self.of_point[np.any(tangent != tangent.transpose(1, 0, 2), axis=(0, 1))]
        symmetric = not self.total(skew.size)
        if not self.total(new.sum()) and symmetric == self.symmetric:
            return
        chosen, matrix = np.flatnonzero(new).tolist(), self.matrix(share, tangent)
        try:
            condensed = together(
                self.team,
                lambda: {at: self._condense(matrix, at, at not in skew) for at in chosen},
            )
            blocks = {owner: each.blocks[0] for owner, each in condensed.items()}
            self.balancing.renew(blocks, self.coarse_factors if symmetric else factorise)
        except (MultiscaleError, np.linalg.LinAlgError):
            self._forget()
            raise
        old = self.condensed
        self.condensed = [condensed.get(at) or old[at] for at in range(count)]
        self.share, self.tangent, self.symmetric = share, tangent, symmetric

    def _condense(self, matrix: csr_array, owner: int, symmetric: bool) -> CondensedStiffness:
        block = self.block(matrix, owner)
        try:
            inside = self.factors[owner] if symmetric else factorise
            return condense(block, self.splits[owner], inside)
        except MultiscaleError:
            if symmetric and block.shape[0] <= EXAMINED:
                refuse_negative(block, f"substructure {owner + self.local.start}")
            raise

    def reduce(self, force: np.ndarray) -> np.ndarray:
        """Force on the shared unknowns that is equivalent to forces on all unknowns, N."""
        reduced = [
            condensed.reduce(force[span])
            for condensed, span in zip(self.condensed, self.spans, strict=True)
        ]
        n = self.balancing.layout.n_shared
        return self.team.total(np.bincount(self.slot, np.concatenate(reduced), minlength=n))

    def expand(self, force: np.ndarray, shared: np.ndarray) -> np.ndarray:
        """Displacement of all unknowns from the displacement of the shared unknowns, m."""
        edge = shared[self.slot]
        return np.concatenate(
            [
                condensed.expand(force[span], edge[at])
                for condensed, span, at in zip(self.condensed, self.spans, self.edges, strict=True)
            ]
        )

    def solve(self, force: np.ndarray, accuracy: float) -> Direction:
        """Solve for the displacement under forces on the substructures."""
        if not self.balancing.layout.n_shared:
            return Direction(self.expand(force, np.zeros(0)), 0, np.nan, False)
        right, bound = self.reduce(force), accuracy * float(norm(self.assemble(force)))
        iterate = self._conjugate_gradients if self.symmetric else self._minimal_residuals
        edge, count, condition, unfinished = iterate(right, bound)
        return Direction(self.expand(force, edge), count, condition, unfinished)

    def _conjugate_gradients(self, right: np.ndarray, bound: float) -> Direction:
        steps = list[tuple[float, float]]()

        def note(length: float, share: float) -> None:
            steps.append((length, share))
            if not (length > 0.0 or self.softens):  # laws of joints may soften
                raise MultiscaleError(
                    f"the tangent is not positive semidefinite: along a direction it has "
                    f"{1.0 / length:.2g} of the stiffness of the preconditioner"
                )

        balancing = self.balancing
        edge, count = conjugate_gradients(
            balancing.multiply, right, balancing, goal=bound, limit=KRYLOV, note=note
        )
        values = ritz_values(steps)
        condition = values[-1] / values[0] if values.size and values[0] > 0.0 else np.nan
        return Direction(edge, count, condition, count == KRYLOV)

    def _minimal_residuals(self, right: np.ndarray, bound: float) -> Direction:
        residuals = list[float]()
        S, M = (
            LinearOperator(2 * right.shape, matvec=product, dtype=float)
            for product in (self.balancing.multiply, self.balancing)
        )
        options = {"restart": RESTART, "maxiter": KRYLOV // RESTART, "callback_type": "pr_norm"}
        edge, info = gmres(
            S, right, rtol=0.0, atol=bound, M=M, callback=residuals.append, **options
        )
        return Direction(edge, len(residuals), np.nan, bool(info))


def refuse_negative(matrix: csr_array | np.ndarray, name: str) -> None:
    """Refuse a symmetric matrix with eigenvalues below rounding, and report the smallest."""
    value = eigvalsh(matrix.toarray() if isinstance(matrix, csr_array) else matrix)
    if value[0] < -ROUNDING * value[-1]:
        raise MultiscaleError(
            f"the tangent of {name} is not positive semidefinite: its smallest eigenvalue is "
            f"{value[0]:.3g} N/m and its largest {value[-1]:.3g} N/m"
        )


def _move_joints_inside(problem: CutProblem) -> CutProblem:
    """Add every joint to its second substructure, with the unknowns of the first on the joint."""
    widened = list(problem.substructures)
    places = problem.places() if problem.joints else ()
    for joint in problem.joints:
        first, second = joint.sides
        touched = problem.substructures[first].unknown[np.unique(joint.trace[0].indices)]
        widened[second] = _widen(widened[second], touched, *places)
    for joint in problem.joints:
        if joint.law is None or not joint.law.compliant:
            raise CaseError(
                f"a joint of substructures {joint.sides} needs a law that gives the traction of a "
                f"jump; solve_latin supports rigid contact"
            )
    return CutProblem(tuple(widened), problem.position, problem.expansion)


def _widen(
    substructure: Substructure, unknowns: np.ndarray, position: np.ndarray, component: np.ndarray
) -> Substructure:
    """Append unknowns of the structure that a substructure does not have, without stiffness."""
    unknown = np.append(substructure.unknown, np.setdiff1d(unknowns, substructure.unknown))
    wide, links = eye_array(unknown.size, substructure.n, format="csr"), substructure.links
    return Substructure(
        csr_array(wide @ substructure.stiffness @ wide.T),
        wide @ substructure.load,
        unknown,
        position[unknown],
        component[unknown],
        links and replace(links, operator=csr_array(links.operator @ wide.T)),
    )
