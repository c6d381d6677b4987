r"""Newton steps of a structure that has been cut."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.sparse import block_array, csr_array, diags_array
from scipy.sparse.linalg import LinearOperator, cg, gmres

from multiscale.convergence import Status
from multiscale.errors import MultiscaleError
from multiscale.fe.condensation import CondensedStiffness, condense, split
from multiscale.laws.side_by_side import lay_side_by_side
from multiscale.macro.interface_newton import (
    FLOOR,
    GROWTH,
    face_stiffness,
    go_on_along_law,
    soften_tangent,
    tangent_traction,
)
from multiscale.macro.links.link_newton import SlackStiffness, exact_step
from multiscale.macro.substructures.balancing import Balancing, lay_out, prepare_balancing
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.coarse import coarse_basis
from multiscale.macro.substructures.inner_joints import move_joints_inside
from multiscale.macro.substructures.parallel import Alone, ProcessGroup, share, together
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stack import Factors, lay_out_sides, stack_parts
from multiscale.macro.substructures.state import JointState
from multiscale.macro.substructures.whole import stack_jumps
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.line_search import enough, step_length

__all__ = ["Imbalance", "Newton"]

HELD = 1e-12
"""Stiffness lent to every unknown in the tangent, relative to its diagonal."""

REGULAR = 1e-6
"""Stiffness lent to shared unknowns in the preconditioner, relative to the diagonal without
slack."""

LOOSE, FINEST = 1e-2, 1e-10
"""Largest and smallest residual at which a linear system counts as solved."""

UNSURE = 1e-8
"""Largest residual that rounding excuses: without a limit, a body that runs away would count as
in balance."""

KRYLOV, RESTART = 2000, 100
"""Iterations of a linear system, and those before GMRES starts anew. They cost far less than the
factors; a direction that they left unfinished would slow Newton's method down on large grids."""


@dataclass(frozen=True, eq=False)
class Imbalance:
    """Forces out of balance.

    Attributes
    ----------
    force : ndarray, shape (unknowns of the substructures,)
        With the tractions of the tangents of the joints at their own jumps, N.
    residual, rounding : float
        Largest of the whole structure and what rounding makes of it, relative to the load.
    tangent : ndarray, shape (3, 3, points), of the laws of joints, times the weights, N/m
    traction : ndarray, shape (3, points), on the joints, Pa
    softened : bool
        Whether laws (of this process) are stiffer than their tangents, so that they must go on.
    """

    force: np.ndarray
    residual: float
    rounding: float
    tangent: np.ndarray
    traction: np.ndarray
    softened: bool


@dataclass(frozen=True, eq=False)
class _Factored:
    """A tangent, condensed; its Schur complements in one table; and its preconditioner."""

    condensed: CondensedStiffness
    schur: np.ndarray
    balancing: Balancing
    symmetric: bool


@dataclass(frozen=True, eq=False)
class _Way:
    """Change of displacement, m, tension without slack, N, and jumps, m, in a step."""

    u: np.ndarray
    elastic: np.ndarray
    jump: np.ndarray


class Newton:
    r"""A structure, the displacement reached, and steps towards equilibrium.

    A process holds some of the substructures; what all share is the same in every digit.

    .. math::
        \sum_E R_E^T \left( K u_E + B^T P(\tau^0 + k B u_E) + J^T w\, t(J u_E) - f_E \right) = 0,
        \qquad u_E = R_E u,    \tag{1}

    with the links and joints of every substructure :math:`E`.
    """

    def __init__(self, problem: CutProblem, team: ProcessGroup | None = None) -> None:
        self.problem, self.team = problem, team or Alone()
        perfect, inner = move_joints_inside(problem)
        mine = share(len(perfect.substructures), self.team)
        self.stack = stack_parts(perfect, mine)
        self.unknown = np.concatenate([perfect.substructures[part].unknown for part in mine])
        self.parts = split(self.stack.start, self.stack.shared)
        sides, slot = lay_out_sides(perfect), np.zeros(self.stack.n, dtype=int)
        slot[self.stack.trace.indices] = sides.slot[sides.start[mine[0]] : sides.start[mine.stop]]
        self.slot = slot[self.parts.edge]
        basis = coarse_basis(perfect)
        self.layout = lay_out(self.parts, self.slot, basis, perfect.interfaces, mine, self.team)
        places = [place for place, (owner, _) in enumerate(inner) if owner in mine]
        own = [problem.joints[place] for place in places]
        self.points = np.r_[(slice(0), *(problem.points[place] for place in places))]
        laws = [joint.law for joint in own if joint.law]
        counts = [joint.weight.size for joint in own]
        self.law = lay_side_by_side(laws, counts, problem.gap[self.points])
        self.weight = problem.weight[self.points]
        jumps = [self._placed(inner[at][1], inner[at][0] - mine[0]) for at in places]
        self.operator = stack_jumps(jumps, self.stack.n)
        normal, diagonal = self.operator[: self.points.size], self.stack.stiffness.diagonal()
        self.resistance = face_stiffness(diagonal, normal, self.weight) if own else 0.0
        self.state = np.zeros((self.law.n_state, self.points.size))
        links = self.stack.links
        self.taut = self.assemble(self.stack.matrix(links.stiffness, None).diagonal())[self.unknown]
        self.factors = (Factors(), Factors())
        self.factored: _Factored | None = None
        self.key = np.full(links.stiffness.size + 1, np.nan)
        self.magnitude = abs(self.stack.stiffness)
        self.u, self.elastic = np.zeros(self.stack.n), np.zeros(links.stiffness.size)
        self.reached: np.ndarray | None = None
        # jumps are summed up, as the tensions: the difference of both sides would round them away
        self.jump = self.at = np.zeros((3, self.points.size))  # of bodies, and of the tangents

    def _placed(self, operator: csr_array, part: int) -> csr_array:
        """Let an operator of one substructure act on the unknowns of all."""
        shape = (operator.shape[0], self.stack.n)
        columns = operator.indices + self.stack.start[part]
        return csr_array((operator.data, columns, operator.indptr), shape=shape)

    def start(self, state: JointState, factor: np.ndarray) -> None:
        """Begin a step from a committed state with factors of the load cases."""
        self.factor, self.load, self.unfinished = factor, self.stack.load @ factor, 0
        links, self.before = self.stack.links, state.pressure
        if state.unknowns is not self.reached:
            self.u = state.unknowns[self.unknown]
            self.elastic = links.stiffness * (links.operator @ self.u)
        self.jump = self.at = state.jump[:, self.points]
        self.state = state.history[: self.law.n_state, self.points]
        self.lower, self.upper = links.lower - links.prestress, links.upper - links.prestress
        self.lending, self.known = SlackStiffness(), None
        self.closest, self.least = self._place(), np.inf
        self.scale = float(np.abs(self.assemble(self.load)).max(initial=0.0)) or (
            self._largest(links.prestress) or 1.0
        )

    def assemble(self, force: np.ndarray) -> np.ndarray:
        """Add up over the substructures of all processes, shape (problem.n,)."""
        return self.team.total(np.bincount(self.unknown, force, minlength=self.problem.n))

    def _largest(self, value: np.ndarray) -> float:
        """Largest size of an entry in all processes."""
        own = np.abs(value).max(initial=0.0)
        return float(self.team.concatenate(np.array([own])).max())

    def _sum(self, value: float | np.integer) -> float:
        """Add up over the processes."""
        return float(self.team.total(np.array([value], dtype=float))[0])

    def tension(self) -> np.ndarray:
        """Tension of the links, N."""
        links = self.stack.links
        return np.asarray(links.prestress + np.clip(self.elastic, self.lower, self.upper))

    def slack(self) -> np.ndarray:
        """Distance by which the ends of a link miss it, m."""
        change = np.clip(self.elastic, self.lower, self.upper)
        return np.asarray(np.abs(change - self.elastic) / self.stack.links.stiffness)

    def displacement(self) -> np.ndarray:
        """Displacement of the unknowns of the whole structure, m."""
        shares = self.assemble(np.ones(self.stack.n))
        return np.asarray(self.assemble(self.u) / np.maximum(shares, 1.0))

    def imbalance(self) -> Imbalance:
        """Evaluate (1)."""
        u, tension, joints = self.u, self.tension(), self.operator.T
        own = self.law.respond(self.at, self.state)
        response = soften_tangent(own, self.resistance)
        outer = self.load - self.stack.stiffness @ u - self.stack.links.operator.T @ tension
        balanced, force = (
            outer - joints @ (self.weight * traction).ravel()
            for traction in (response.traction, tangent_traction(response, self.at, self.jump))
        )
        residual = float(np.abs(self.assemble(balanced)).max(initial=0.0)) / self.scale
        largest = self._largest(np.append(self.magnitude @ np.abs(u), tension))
        rounding = min(8.0 * float(np.finfo(float).eps) * largest / self.scale, UNSURE)
        tangent, softened = self.weight * response.tangent, response is not own
        return Imbalance(force, residual, rounding, tangent, response.traction, softened)

    def advance(self, imbalance: Imbalance, tolerance: float, *, search: bool = False) -> int:
        """Take one Newton step; return the number of iterations of the linear solver.

        Its length is searched by the energy if wanted, where there are joints.
        """
        carries = np.clip(self.elastic, self.lower, self.upper) == self.elastic
        if self.known is not None and not self._sum(np.count_nonzero(carries != self.known)):
            self.lending.reset()
        self.known = carries
        if imbalance.residual < self.least and self.at is self.jump:
            self.closest, self.least = self._place(), imbalance.residual
        if search and self.at is not self.jump:
            return self._search_from_closest(tolerance)
        accuracy = min(LOOSE, imbalance.residual)
        accuracy = max(accuracy, 0.1 * tolerance / imbalance.residual, FINEST)
        try:
            direction, count = self._solve(imbalance, carries, accuracy)
        except (MultiscaleError, np.linalg.LinAlgError):
            search = self.at is self.jump  # an open or frictionless interface is held, a little
            direction, count = self._solve(self._held(imbalance), carries, accuracy)

        way = self._way(direction)
        work = self._sum(imbalance.force @ direction)
        if not self.problem.joints:
            step = self._exact_step(way, work)
            self._move(step, way)
        elif search or self.problem.n_links:
            step = step_length(lambda step: self._slope(step, way), -work)
            self._move(step, way)
            self.closest = self._place()
        elif self._goes_on(way, work, imbalance):
            step = 1.0
        else:
            return count + self._search_from_closest(tolerance)
        self.lending.adapt(step)
        return count

    def _place(self) -> tuple[np.ndarray, ...]:
        """Displacement and tension reached, jumps, and jumps of the tangents."""
        return self.u, self.elastic, self.jump, self.at

    def _held(self, imbalance: Imbalance) -> Imbalance:
        """Lend stiffness to the tangents of joints."""
        lent = FLOOR * self.resistance * self.weight * np.eye(3)[:, :, None]
        return replace(imbalance, tangent=imbalance.tangent + lent)

    def _search_from_closest(self, tolerance: float) -> int:
        """Search from the smallest residual; from jumps of their own, the laws would mislead."""
        self.u, self.elastic, self.jump, _ = self.closest
        self.at = self.jump
        return self.advance(self.imbalance(), tolerance, search=True)

    def _way(self, direction: np.ndarray) -> _Way:
        """Let links and joints follow a direction of the unknowns."""
        links = self.stack.links
        return _Way(
            direction,
            links.stiffness * (links.operator @ direction),
            (self.operator @ direction).reshape(3, -1),
        )

    def _goes_on(self, way: _Way, work: float, here: Imbalance) -> bool:
        """Take a whole step, after which the laws may go on from jumps of their own.

        See :mod:`multiscale.macro.interface_newton`. Nothing is done where the residual explodes.
        """
        before = self._place()
        self._move(1.0, way)
        after = self.imbalance()
        softened = bool(self._sum(here.softened))
        if softened or not enough(work, self._sum(after.force @ way.u)):
            self.at = go_on_along_law(self.law, before[3], self.jump, self.resistance, self.state)
            after = self.imbalance()
        if not after.residual <= GROWTH * here.residual:
            self.u, self.elastic, self.jump, self.at = before
            return False
        return True

    def _move(self, step: float, way: _Way) -> None:
        """Go along a direction."""
        self.u = self.u + step * way.u
        self.elastic = self.elastic + step * way.elastic
        self.jump = self.at = self.jump + step * way.jump

    def _solve(
        self, imbalance: Imbalance, carries: np.ndarray, accuracy: float
    ) -> tuple[np.ndarray, int]:
        """Newton direction and the number of iterations that it took."""
        key = np.append(carries, self.lending.share)
        changed = self._sum(np.count_nonzero(key != self.key))
        if self.problem.joints or self.factored is None or changed:
            self.factored, self.key = self._factorise(imbalance, carries), key
        edge, count = self._solve_shared(self.factored, imbalance.force, accuracy)
        return self.factored.condensed.expand(imbalance.force, edge[self.slot]), count

    def _factorise(self, imbalance: Imbalance, carries: np.ndarray) -> _Factored:
        """Condense the tangent and prepare what preconditions it."""
        share = np.where(carries, 1.0, self.lending.share)
        matrix = self.stack.matrix(share * self.stack.links.stiffness, None)
        tangent = imbalance.tangent
        if self.points.size:
            blocks = [[diags_array(entry) for entry in row] for row in tangent]
            matrix += self.operator.T @ block_array(blocks, format="csr") @ self.operator
        matrix = csr_array(matrix + HELD * diags_array(self.taut))
        symmetric = not self._sum(not np.array_equal(tangent, tangent.transpose(1, 0, 2)))
        inside, coarse = self.factors if symmetric else (factorise, factorise)
        condensed = together(self.team, lambda: condense(matrix, self.parts, inside))
        schur = self.layout.gather(condensed.blocks)
        added = np.zeros(self.layout.shared.shape)
        added[self.parts.owner, self.parts.column] = REGULAR * self.taut[self.parts.edge]
        balancing = prepare_balancing(self.layout, schur, added, coarse)
        return _Factored(condensed, schur, balancing, symmetric)

    def _solve_shared(
        self, factored: _Factored, force: np.ndarray, accuracy: float
    ) -> tuple[np.ndarray, int]:
        """Displacement of the shared unknowns by a preconditioned Krylov method."""
        layout, n, count = self.layout, self.layout.n_shared, 0
        if not n:
            return np.zeros(0), 0

        def note(_: object) -> None:
            nonlocal count
            count += 1

        own = np.bincount(self.slot, factored.condensed.reduce(force), minlength=n)
        right = self.team.total(own)
        bound = accuracy * float(np.linalg.norm(self.assemble(force)))
        S = LinearOperator((n, n), matvec=partial(layout.multiply, factored.schur), dtype=float)
        M = LinearOperator((n, n), matvec=factored.balancing, dtype=float)
        options = {"rtol": 0.0, "atol": bound, "M": M, "maxiter": KRYLOV, "callback": note}
        krylov = cg
        if not factored.symmetric:
            restarted = {"restart": RESTART, "maxiter": KRYLOV // RESTART}
            krylov, options = gmres, options | restarted | {"callback_type": "pr_norm"}
        edge, info = krylov(S, right, **options)
        self.unfinished += info != 0  # Newton's own residual judges what such a direction is worth
        return edge, count

    def _exact_step(self, way: _Way, work: float) -> float:
        """Step to the least energy; what is linear counts as one more link that never slackens."""
        curvature = self._sum(way.u @ (self.stack.stiffness @ way.u))
        no_bound = np.array([np.inf]) if curvature > 0.0 else np.zeros(0)
        rest = np.full(no_bound.size, curvature)
        elastic, growth, stiffness, lower, upper = (
            self.team.concatenate(value)
            for value in (
                self.elastic,
                way.elastic,
                self.stack.links.stiffness,
                self.lower,
                self.upper,
            )
        )
        return float(
            exact_step(
                np.append(elastic, 0.0 * rest),
                np.append(growth, rest),
                np.append(stiffness, rest),
                np.append(lower, -no_bound),
                np.append(upper, no_bound),
                work,
            )
        )

    def _slope(self, step: float, way: _Way) -> float:
        """Differentiate the energy along a direction, J."""
        here = self._place()
        self._move(step, way)
        force = self.imbalance().force
        self.u, self.elastic, self.jump, self.at = here
        return -self._sum(force @ way.u)

    def why(self, status: Status, closest: Imbalance) -> str:
        """Say why a step failed, from where it was closest to a solution."""
        load = self.problem.load(self.factor)
        pressure = -self.joined(closest.traction)[0]
        if slide := find_slide(self.problem, load, self.before, pressure):
            return str(slide)
        if self.unfinished:
            return (
                f"{status.value}; {self.unfinished} of its linear systems were left unfinished "
                f"after {KRYLOV} iterations, so cut the structure into fewer or more compact parts"
            )
        return status.value

    def joined(self, value: np.ndarray) -> np.ndarray:
        """Jump or traction at the points of the joints of all processes."""
        found = np.zeros((3, self.problem.weight.size))
        found[:, self.points] = value
        return self.team.total(found)
