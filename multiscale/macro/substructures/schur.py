"""Newton-Schur: Newton's method of a cut structure with a Krylov method for the shared unknowns."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from time import perf_counter
from typing import Any, ClassVar, NamedTuple

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import MultiscaleError
from multiscale.laws.interface_law import lay_side_by_side
from multiscale.macro.links.link_newton import SlackStiffness, exact_step
from multiscale.macro.monolithic import Assembled, Equilibrium, Place, find_equilibrium
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.cut_tangent import KRYLOV, CutTangent
from multiscale.macro.substructures.latin_solver import LatinMethod, LatinSolver
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stack import ALONE, Factors, ProcessGroup
from multiscale.macro.substructures.stepping import JointState, Method, StepAnswer
from multiscale.numerics.newton import Limits, NewtonRun, step_length

SLACK, SLACKEST = 0.3, 1e-5
"""Stiffness of slack links in the tangent, relative to their elastic stiffness: initial value, and
limit to which long steps reduce it."""

COARSEST, COARSEST_WITH_JOINTS, FINEST = 1e-2, 1e-3, 1e-10
"""Largest and smallest tolerance of a linear system, relative to the load: whether a point
slips depends on more digits than whether a link is slack."""

INSIDE, ROUNDS = 1e-2, 30
"""Tolerance of the interiors of substructures, relative to the residual of the structure, and limit
of their Newton steps."""

OVERFLOW = 1e150
"""Residual above which its square overflows in the linear solver."""


@dataclass(frozen=True)
class NewtonSchur(Method):
    r"""Newton's method and domain decomposition: all laws but rigid contact, and many processes.

    Parameters
    ----------
    parts, after_step
        As in :class:`Method`.
    tolerance : float
        Bound on the largest residual force relative to the largest nodal load (without load: to
        the largest prestress); dimensionless. Rounding may raise it; ``residual`` is the value
        reached.
    max_iterations : int, limit of Newton steps for a load
    team : ProcessGroup, optional, as in :class:`LatinMethod`
    callback : callable, optional
        Called as ``callback(iteration, residual, iterate)`` with a :class:`SchurIterate`. Either
        all processes have a callback, or none.

    Notes
    -----
    The tangent is condensed onto the unknowns that substructures share, again only where a link or
    a joint changed its status. Conjugate gradients, preconditioned by BDDC with constraints from
    the flexibility of the jumps, :class:`~.balancing.Balancing`, solve for them; where the tangent
    is not symmetric, as with friction, GMRES. The tolerance of the linear systems decreases with
    the residual [1]_. With links and without joints line searches are exact, and the interior
    of every substructure is in balance before a step.

    In the result ``iterations`` counts the Newton steps, ``krylov_iterations`` the iterations of
    the linear solver in all of them, and ``condition_number`` is the largest ratio of the Ritz
    values of conjugate gradients. A step with joints that Newton's method does not solve, although
    friction carries its load, is solved again from the solution of LATIN: ``iterations`` counts
    the Newton steps of both attempts, ``wall_time`` contains LATIN, and the attribute ``fallback``
    has the reason and the iterations of LATIN. Other attributes: ``shared_unknowns``, and the
    largest ``coarse_unknowns``.

    References
    ----------
    .. [1] S. C. Eisenstat, H. F. Walker, SIAM J. Sci. Comput. 17 (1996) 16-32,
       doi:10.1137/0917003.
    """

    name: ClassVar[str] = "Newton-Schur"
    team: ProcessGroup | None = None
    callback: Callable[[int, float, "SchurIterate"], None] | None = None

    def start(self, problem: CutProblem) -> "SchurSolver":
        """Lay out shared and coarse unknowns."""
        return SchurSolver(problem, self)


class SchurIterate(NamedTuple):
    """Iterate of Newton's method."""

    displacement: np.ndarray  # of the unknowns of the structure, (n,), m
    tension: np.ndarray  # of the links of the substructures of this process in turn, N


class SchurSolver:
    """Newton-Schur on a structure, step by step; each process has some of the substructures."""

    def __init__(self, problem: CutProblem, method: NewtonSchur) -> None:
        self.problem, self.method, self.team = problem, method, method.team or ALONE
        tangent = self.tangent = CutTangent(problem, self.team)
        self.stack, self.points = tangent.stack, tangent.points
        joints, links = [problem.joints[place] for place in tangent.joints], self.stack.links
        laws = [joint.law for joint in joints if joint.law]
        counts = [joint.weight.size for joint in joints]
        self.law = lay_side_by_side(laws, counts, problem.gap[self.points])
        weight, n = problem.weight[self.points], self.stack.n
        load, motions = self.stack.load, np.zeros((n, 0))
        self.bodies = Assembled(self.stack.stiffness, load, tangent.jump, weight, motions)
        # end of the last step, and factors of interiors
        self.reached = np.zeros(problem.n), np.zeros(n), np.zeros(links.stiffness.size)
        self.factors = [Factors() for _ in tangent.spans]
        self.coarse_unknowns, self.fallbacks, self.latin_iterations = 0, list[str](), 0

    @property
    def attributes(self) -> Mapping[str, int | str]:
        """Number of shared unknowns, largest number of coarse unknowns, and restarted steps."""
        shared = self.tangent.balancing.layout.n_shared
        counts: dict[str, int | str] = {
            "shared_unknowns": shared,
            "coarse_unknowns": self.coarse_unknowns,
        }
        if self.fallbacks:
            counts["fallback"] = (
                f"{len(self.fallbacks)} steps were solved from LATIN: {self.fallbacks[0]}; "
                f"LATIN took {self.latin_iterations} iterations"
            )
        return counts

    def carried(self, elastic: np.ndarray) -> np.ndarray:
        """Change of the tension of the links, N, from the change without slack."""
        links = self.stack.links
        lower, upper = links.lower - links.prestress, links.upper - links.prestress
        return np.asarray(np.clip(elastic, lower, upper))

    def tension(self, elastic: np.ndarray) -> np.ndarray:
        """Tension of the links, N, from its change without slack."""
        return np.asarray(self.stack.links.prestress + self.carried(elastic))

    def iterate(self, here: Place) -> SchurIterate:
        """Displacement of the structure and tension of the links."""
        u = self.stack.problem.average(self.team.concatenate(here.value))
        return SchurIterate(u, self.tension(here.elastic))

    def joined(self, value: np.ndarray) -> np.ndarray:
        """Jump or traction at the points of the joints of all processes."""
        every = np.zeros((3, self.problem.weight.size))
        every[:, self.points] = value
        return self.team.total(every)

    @np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
    def step(self, state: JointState, factor: np.ndarray, near: object = None) -> StepAnswer:
        """Newton's method for a load."""
        clock, links = perf_counter(), self.stack.links
        # start from the unknowns of the substructures and the tensions of the step before
        last, u, elastic = self.reached
        if state.unknowns is not last:
            u = state.unknowns[self.tangent.unknown]
            elastic = links.stiffness * (links.operator @ u)
        balance = _CutEquilibrium(self, self.stack.load @ factor, state)
        begin = balance.place(u, state.jump[:, self.points], elastic=elastic)
        run, here, best = self._iterate(balance, begin)
        steps, failure = run.steps, ""
        if not run.converged:
            # reason of the failure, by the iterate closest to a solution
            load, pressure = self.problem.load(factor), -self.joined(best.traction)[0]
            slide = find_slide(self.problem, load, state.pressure, pressure)
            failure = str(slide) if slide else balance.explain(run.status)
            if self.problem.joints and not slide:
                start = self._restart(balance, begin, state, factor)
                if start is not None:
                    run, here, _ = self._iterate(balance, start)
                    steps += run.steps
                if run.converged:
                    self.fallbacks.append(failure)
                    failure = ""

        # result
        displacement, tension = self.iterate(here)
        self.reached = displacement, here.value, here.elastic
        slack = np.abs(self.carried(here.elastic) - here.elastic) / links.stiffness
        columns: dict[str, Any] = {
            "converged": int(run.converged),
            "failure": failure,
            "residual": balance.residual(here),
            "iterations": steps,
            "krylov_iterations": balance.krylov,
            "condition_number": balance.condition,
            "wall_time": perf_counter() - clock,
            **self.problem.link_fields(
                self.team.concatenate(tension), self.team.concatenate(slack)
            ),
        }
        return StepAnswer(
            self.reached[0], self.joined(here.at), self.joined(here.traction), columns
        )

    def _iterate(self, balance: "_CutEquilibrium", here: Place) -> tuple[NewtonRun, Place, Place]:
        """Apply Newton's method from a start; return its record, and last and best iterate."""
        method, latest = self.method, here

        def report(iteration: int, residual: float) -> None:
            if method.callback is not None:
                method.callback(iteration, residual, self.iterate(latest))

        def note(place: Place) -> None:
            nonlocal latest
            latest = place

        run = NewtonRun(Limits(method.max_iterations, method.tolerance, report))
        return run, *find_equilibrium(balance, here, run, note)

    def _restart(
        self, balance: "_CutEquilibrium", begin: Place, state: JointState, factor: np.ndarray
    ) -> Place | None:
        """Place the bodies where LATIN solves the step; None if it does not solve it."""
        method = LatinMethod(tolerance=self.method.tolerance, team=self.team)
        try:
            answer = LatinSolver(self.problem, method, judged=False).step(state, factor)
        except MultiscaleError:
            return None
        self.latin_iterations += answer.report["iterations"]
        if not answer.report["converged"]:
            return None
        u, links = answer.unknowns[self.tangent.unknown], self.stack.links
        jump = begin.jump + (self.bodies.jump @ (u - begin.value)).reshape(begin.jump.shape)
        elastic = links.stiffness * (links.operator @ u)
        balance.slack_stiffness, balance.carried_before = SlackStiffness(SLACK, SLACKEST), None
        return balance.place(u, jump, at=answer.jump[:, self.points], elastic=elastic)


class _CutEquilibrium(Equilibrium):
    r"""Equilibrium of a cut structure under a load; without joints the line search is exact.

    .. math::
        \sum_E R_E^T \left( K u_E + B^T P(\tau^0 + k B u_E) + J^T w\, t(J u_E) - f_E \right) = 0,
        \qquad u_E = R_E u.    \tag{1}
    """

    def __init__(self, cut: SchurSolver, load: np.ndarray, state: JointState) -> None:
        history = state.history[: cut.law.n_state, cut.points]
        super().__init__(cut.bodies, load, cut.law, history)
        self.cut, self.links = cut, cut.stack.links
        self.resists, self.descends = bool(cut.problem.joints), cut.problem.n_links > 0
        self.slack_stiffness = SlackStiffness(SLACK, SLACKEST)
        self.carried_before: np.ndarray | None = None
        self.krylov, self.unfinished, self.condition, self.fault = 0, 0, np.nan, ""
        largest = float(np.abs(cut.tangent.assemble(load)).max(initial=0.0))
        self.scale = largest or self._most(self.links.prestress) or 1.0

    def _most(self, value: np.ndarray) -> float:
        most = np.abs(value).max(initial=0.0)
        return float(self.cut.team.concatenate(np.array([most])).max())

    def inner(self, value: np.ndarray, elastic: np.ndarray) -> np.ndarray:
        """Return the forces of bodies and links less the load, N."""
        links = self.links.operator.T @ self.cut.tension(elastic)
        return np.asarray(super().inner(value, elastic) + links)

    def stretch(self, direction: np.ndarray) -> np.ndarray:
        """Change of tension without slack along a direction, N."""
        return np.asarray(self.links.stiffness * (self.links.operator @ direction))

    def size(self, force: np.ndarray) -> float:
        """Largest force of the whole structure, N."""
        return float(np.abs(self.cut.tangent.assemble(force)).max(initial=0.0))

    def largest(self, here: Place) -> float:
        """Size of the forces that cancel in equilibrium, N."""
        forces = self.magnitude @ np.abs(here.value)
        return self._most(np.append(forces, self.cut.tension(here.elastic)))

    def dot(self, first: np.ndarray, second: np.ndarray) -> float:
        """Work in all substructures, J."""
        return self.cut.tangent.total(float(first @ second))

    def anywhere(self, flag: bool) -> bool:
        """Whether a flag is set in any process."""
        return bool(self.cut.tangent.total(flag))

    def explain(self, status: Status) -> str:
        """Report why Newton's method stopped, and linear systems without a solution."""
        unfinished = (
            f"; {self.unfinished} of its linear systems did not converge in {KRYLOV} "
            f"iterations; cut the structure into fewer or more compact substructures"
        )
        return status.value + self.fault + (unfinished if self.unfinished else "")

    def residual(self, here: Place) -> float:
        """Largest residual force relative to the load; infinite if its square is infinite."""
        residual = super().residual(here)
        return residual if residual <= OVERFLOW else np.inf

    def direction(self, here: Place, floor: float = 0.0) -> np.ndarray | None:
        """Newton direction, m; None if the tangent is singular."""
        cut, residual = self.cut, self.residual(here)
        if self.slack_stiffness.exhausted:
            return None
        # status of the links, and the stiffness lent to slack links
        carries = cut.carried(here.elastic) == here.elastic
        if self.carried_before is not None and not cut.tangent.total(
            np.count_nonzero(carries != self.carried_before)
        ):
            self.slack_stiffness.reset()
        self.carried_before = carries
        try:
            lent = floor * self.bodies.resistance * self.bodies.weight * np.eye(3)[:, :, None]
            share = np.where(carries, 1.0, self.slack_stiffness.share)
            cut.tangent.renew(share, here.tangent + lent)
            cut.coarse_unknowns = max(cut.coarse_unknowns, cut.tangent.balancing.n_coarse)
            # the tolerance of the linear system decreases with the residual
            coarsest = COARSEST_WITH_JOINTS if cut.problem.joints else COARSEST
            accuracy = min(coarsest, residual)
            accuracy = max(accuracy, 0.1 * cut.method.tolerance / residual, FINEST)
            answer = cut.tangent.solve(-here.gradient, accuracy)
        except (MultiscaleError, np.linalg.LinAlgError) as error:
            self.fault = f"; {error}"
            return None
        self.krylov += answer.iterations
        self.unfinished += answer.unfinished
        self.condition = np.fmax(self.condition, answer.condition)
        return answer.value

    def step(self, here: Place, direction: np.ndarray) -> Place:
        """Move by an exact line search with links, an approximate search with links and joints."""
        if not self.cut.problem.n_links:
            return super().step(here, direction)
        if self.cut.problem.joints:
            length = step_length(
                lambda step: self.dot(direction, self.move(here, step, direction).gradient),
                self.dot(direction, here.gradient),
            )
        else:
            length = self._exact_step(here, direction)
        self.slack_stiffness.adapt(length)
        there = self.move(here, length, direction)
        done = self.cut.problem.joints or self.residual(there) <= self.cut.method.tolerance
        return there if done else self.relax(there)

    def relax(self, here: Place) -> Place:
        """Balance the inside of every substructure by Newton's method with exact steps."""
        tangent = self.cut.tangent
        value, elastic = here.value.copy(), here.elastic.copy()
        goal = max(INSIDE * self.residual(here), 0.1 * self.cut.method.tolerance) * self.scale
        lending = [SlackStiffness(SLACKEST, SLACKEST) for _ in tangent.spans]
        inside = np.where(tangent.stack.shared, 0.0, 1.0)
        for _ in range(ROUNDS):
            # substructures with forces inside
            force = -inside * self.inner(value, elastic)
            size = [np.abs(force[span]).max() for span in tangent.spans]
            active = [at for at, largest in enumerate(size) if goal < largest < np.inf]
            if not active:
                break
            # Newton directions, then the steps of least energy
            carries = self.cut.carried(elastic) == elastic
            share = np.array([each.share for each in lending])[tangent.of_link]
            matrix = tangent.matrix(np.where(carries, 1.0, share), here.tangent)
            direction, step = np.zeros(value.size), np.zeros(len(lending))
            for owner in active:
                span, within = tangent.spans[owner], tangent.splits[owner].inside
                K = tangent.block(matrix, owner)[within][:, within]
                with suppress(MultiscaleError):  # a singular inside is left to the next step
                    direction[within + span.start] = self.cut.factors[owner](K)(force[span][within])
            growth, linear = self.stretch(direction), self.bodies.stiffness @ direction
            for owner in active:
                span, rows = tangent.spans[owner], tangent.rows[owner]
                work = float(force[span] @ direction[span])
                curvature = float(direction[span] @ linear[span])
                step[owner] = self._step_of(rows, elastic, growth, curvature, work, ALONE)
                lending[owner].adapt(step[owner])
            value += step[tangent.of_unknown] * direction
            elastic += step[tangent.of_link] * growth
        return self.place(value, here.jump, elastic=elastic)

    def _exact_step(self, here: Place, direction: np.ndarray) -> float:
        """Step of the whole structure to the least energy."""
        curvature = self.dot(direction, self.bodies.stiffness @ direction)
        growth, work = self.stretch(direction), -self.dot(direction, here.gradient)
        return self._step_of(slice(None), here.elastic, growth, curvature, work, self.cut.team)

    def _step_of(
        self,
        rows: slice,
        elastic: np.ndarray,
        growth: np.ndarray,
        curvature: float,
        work: float,
        team: ProcessGroup,
    ) -> float:
        """Step to the least energy of some links, N, with a curvature of linear elements, J."""
        links, linear = self.links, np.full(int(curvature > 0.0), curvature)  # without limits
        limits = links.lower - links.prestress, links.upper - links.prestress
        of_links = elastic, growth, links.stiffness, *limits
        more = 0.0 * linear, linear, linear, -np.inf * linear, np.inf * linear
        joined = (
            np.append(team.concatenate(value[rows]), end)
            for value, end in zip(of_links, more, strict=True)
        )
        return float(exact_step(*joined, work))
