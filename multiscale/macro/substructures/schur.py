"""Newton-Schur: Newton's method of a cut structure with a Krylov method for the shared unknowns.

The tangent is condensed onto the unknowns that substructures share; see :class:`~.coarse.Balancing`
for the preconditioner. A joint belongs to its second substructure.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.sparse import block_array, csr_array, diags_array
from scipy.sparse.linalg import LinearOperator, cg, gmres

from multiscale.errors import CaseError, MultiscaleError
from multiscale.fe.condensation import CondensedStiffness, condense, split
from multiscale.laws.side_by_side import lay_side_by_side
from multiscale.macro.links.link_newton import SlackStiffness, exact_step
from multiscale.macro.monolithic import NO_LINKS, Assembled, Equilibrium, Place, find_equilibrium
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.coarse import (
    Balancing,
    coarse_basis,
    lay_out,
    prepare_balancing,
)
from multiscale.macro.substructures.problem import CutProblem, Substructure
from multiscale.macro.substructures.stack import (
    Alone,
    Factors,
    ProcessGroup,
    lay_out_sides,
    share,
    stack_substructures,
    together,
)
from multiscale.macro.substructures.stepping import JointState, Method, StepAnswer
from multiscale.macro.substructures.whole import stack_jumps
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.newton import Limits, NewtonRun, step_length
from multiscale.schema import Dataset

LENT = 1e-12
"""Stiffness lent to every unknown in the tangent, relative to its diagonal."""

REGULAR, WITH_JOINTS = 1e-10, 1e-6
"""Stiffness lent to shared unknowns in the preconditioner, relative to the diagonal without slack:
more acts as an elastic foundation below all interfaces and costs Krylov iterations. On joints 1e12
times stiffer than the bodies, less is rounded away."""

SLACK, SLACKEST = 0.3, 1e-5
"""Stiffness of slack links in the tangent, relative to their elastic stiffness: initial value, and
limit to which long steps reduce it."""

COARSEST, FINEST = 1e-2, 1e-10
"""Largest and smallest tolerance of a linear system, relative to the load."""

KRYLOV, RESTART = 2000, 100
"""Iteration limit of a linear system, and iterations between restarts of GMRES. They cost far less
than the factors; inaccurate directions would slow Newton's method down on large grids."""

OVERFLOW = 1e150
"""Residual above which its square overflows in the linear solver."""


@dataclass(frozen=True)
class NewtonSchur(Method):
    """Newton's method with a balanced Schur complement; see :func:`solve_schur`.

    It supports all laws but rigid contact, on many processes.

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
    """

    name: ClassVar[str] = "Newton-Schur"
    team: ProcessGroup | None = None
    callback: Callable[[int, float, "SchurIterate"], None] | None = None

    def start(self, problem: CutProblem) -> "SchurSolver":
        """Lay out shared and coarse unknowns."""
        return SchurSolver(problem, self)


def solve_schur(
    problem: CutProblem,
    load_factor: float | np.ndarray = 1.0,
    **options: Any,
) -> Dataset:
    r"""Solve substructures and interfaces by Newton's method and domain decomposition.

    Parameters
    ----------
    problem, load_factor
        As in :func:`solve_latin`.
    options
        Parameters of :class:`NewtonSchur`.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``. A step that did not converge is NaN with ``converged`` 0, and
        later steps are not tried. ``iterations`` counts the Newton steps, ``krylov_iterations`` the
        iterations of the linear solver in all of them. Attributes: ``unknowns``,
        ``shared_unknowns``, ``coarse_unknowns``, ``substructures``, ``interfaces`` and, if a step
        failed, ``failure``, as in :func:`solve_latin`, which lists the fields of joints.

    Raises
    ------
    CaseError
        If load factors do not fit the load cases.

    Notes
    -----
    The tangent is condensed onto the unknowns that substructures share. Conjugate gradients,
    preconditioned by BDDC, solve for them; the resultants of edges and all forces of
    cross-points are in equilibrium in every iteration. A joint belongs to its second substructure.
    If its tangent is not symmetric, as with friction, GMRES replaces conjugate gradients. The
    tolerance of the linear systems decreases with the residual.

    Without joints the line search is exact; see :func:`solve_static`.

    References
    ----------
    .. [1] C. R. Dohrmann, SIAM J. Sci. Comput. 25 (2003) 246-258,
       doi:10.1137/S1064827502412887.
    .. [2] S. C. Eisenstat, H. F. Walker, SIAM J. Sci. Comput. 17 (1996) 16-32,
       doi:10.1137/0917003, on the tolerance of the linear systems.
    """
    return NewtonSchur(**options).solve(problem, load_factor)


class _Factored(NamedTuple):
    """A condensed tangent."""

    condensed: CondensedStiffness
    schur: np.ndarray  # Schur complements, (substructures, w, w)
    balancing: Balancing  # preconditioner
    symmetric: bool


class SchurSolver:
    """Newton-Schur on a structure, step by step; each process has some of the substructures."""

    def __init__(self, problem: CutProblem, method: NewtonSchur) -> None:
        self.problem, self.method, self.team = problem, method, method.team or Alone()
        perfect, inner = _move_joints_inside(problem)
        local = share(len(perfect.substructures), self.team)
        self.stack = stack_substructures(perfect, local)
        self.unknown = np.concatenate([perfect.substructures[owner].unknown for owner in local])

        # shared and coarse unknowns
        self.split = split(self.stack.start, self.stack.shared)
        sides, slot = lay_out_sides(perfect), np.zeros(self.stack.n, dtype=int)
        slot[self.stack.trace.indices] = sides.slot[sides.start[local[0]] : sides.start[local.stop]]
        self.slot = slot[self.split.edge]
        basis = coarse_basis(perfect)
        self.layout = lay_out(self.split, self.slot, basis, perfect.interfaces, local, self.team)
        self.attributes = {
            "shared_unknowns": self.layout.n_shared,
            "coarse_unknowns": self.layout.n_coarse,
        }

        # joints inside the substructures of this process
        places = [place for place, (owner, _) in enumerate(inner) if owner in local]
        joints = [problem.joints[place] for place in places]
        self.points = np.r_[(slice(0), *(problem.points[place] for place in places))]
        laws = [joint.law for joint in joints if joint.law]
        counts = [joint.weight.size for joint in joints]
        self.law = lay_side_by_side(laws, counts, problem.gap[self.points])
        jumps = [self._placed(inner[at][1], inner[at][0] - local[0]) for at in places]
        self.bodies = Assembled(
            self.stack.stiffness,
            self.stack.load,
            stack_jumps(jumps, self.stack.n),
            problem.weight[self.points],
            np.zeros((self.stack.n, 0)),
        )

        # factors, and the end of the last step
        links = self.stack.links
        self.taut = self.assemble(self.stack.matrix(links.stiffness, None).diagonal())[self.unknown]
        self.factors = Factors(), Factors()
        self.factored: _Factored | None = None
        self.key = np.full(links.stiffness.size + 1, np.nan)
        self.reached = np.zeros(problem.n), np.zeros(self.stack.n), np.zeros(links.stiffness.size)

    def _placed(self, operator: csr_array, owner: int) -> csr_array:
        """Extend an operator on a substructure to the unknowns of all substructures."""
        shape = (operator.shape[0], self.stack.n)
        columns = operator.indices + self.stack.start[owner]
        return csr_array((operator.data, columns, operator.indptr), shape=shape)

    def assemble(self, force: np.ndarray) -> np.ndarray:
        """Add up over the substructures of all processes, shape (problem.n,)."""
        return self.team.total(np.bincount(self.unknown, force, minlength=self.problem.n))

    def total(self, value: float | np.integer) -> float:
        """Add up over the processes."""
        return float(self.team.total(np.array([value], dtype=float))[0])

    def carried(self, elastic: np.ndarray) -> np.ndarray:
        """Change of the tension of the links, N, from the change without slack."""
        links = self.stack.links
        lower, upper = links.lower - links.prestress, links.upper - links.prestress
        return np.asarray(np.clip(elastic, lower, upper))

    def tension(self, elastic: np.ndarray) -> np.ndarray:
        """Tension of the links, N, from its change without slack."""
        return np.asarray(self.stack.links.prestress + self.carried(elastic))

    def joined(self, value: np.ndarray) -> np.ndarray:
        """Jump or traction at the points of the joints of all processes."""
        every = np.zeros((3, self.problem.weight.size))
        every[:, self.points] = value
        return self.team.total(every)

    @np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
    def step(self, state: JointState, factor: np.ndarray, near: object = None) -> StepAnswer:
        """Newton's method for a load."""
        clock, method, links = perf_counter(), self.method, self.stack.links
        # start from the unknowns of the substructures and the tensions of the step before
        last, u, elastic = self.reached
        if state.unknowns is not last:
            u = state.unknowns[self.unknown]
            elastic = links.stiffness * (links.operator @ u)
        balance = _CutEquilibrium(self, self.stack.load @ factor, state)
        here = balance.place(u, state.jump[:, self.points], elastic=elastic)
        latest = [here]

        def report(iteration: int, residual: float) -> None:
            if method.callback is not None:
                method.callback(iteration, residual, SchurIterate(self, latest[0]))

        run = NewtonRun(Limits(method.max_iterations, method.tolerance, report))

        def note(place: Place) -> None:
            latest[0] = place

        here, best = find_equilibrium(balance, here, run, note)

        # result
        iterate = SchurIterate(self, here)
        self.reached = iterate.displacement(), here.value, here.elastic
        tension = iterate.tension()
        slack = np.abs(self.carried(here.elastic) - here.elastic) / links.stiffness
        columns = {
            "converged": int(run.converged),
            "failure": "" if run.converged else self._why(run, factor, state, best, balance),
            "residual": balance.residual(here),
            "iterations": run.steps,
            "krylov_iterations": balance.krylov,
            "wall_time": perf_counter() - clock,
            **self.problem.link_fields(
                self.team.concatenate(tension), self.team.concatenate(slack)
            ),
        }
        return StepAnswer(
            self.reached[0], self.joined(here.at), self.joined(here.traction), columns
        )

    def _why(
        self,
        run: NewtonRun,
        factor: np.ndarray,
        state: JointState,
        best: Place,
        balance: "_CutEquilibrium",
    ) -> str:
        """Explain the failure of a step by the iterate closest to a solution."""
        load, pressure = self.problem.load(factor), -self.joined(best.traction)[0]
        if slide := find_slide(self.problem, load, state.pressure, pressure):
            return str(slide)
        if balance.unfinished:
            return (
                f"{run.status.value}; {balance.unfinished} of its linear systems did not converge "
                f"in {KRYLOV} iterations, so cut the structure into fewer or more compact "
                f"substructures"
            )
        return run.status.value

    def factorise(self, tangent: np.ndarray, carried: np.ndarray) -> _Factored:
        """Condense the tangent of joints and links and prepare its preconditioner."""
        matrix = self.stack.matrix(carried * self.stack.links.stiffness, None)
        if self.points.size:
            blocks = [[diags_array(entry) for entry in row] for row in tangent]
            B = self.bodies.jump
            matrix += B.T @ block_array(blocks, format="csr") @ B
        matrix = csr_array(matrix + LENT * diags_array(self.taut))
        symmetric = not self.total(not np.array_equal(tangent, tangent.transpose(1, 0, 2)))
        inside, coarse = self.factors if symmetric else (factorise, factorise)
        condensed = together(self.team, lambda: condense(matrix, self.split, inside))
        schur = self.layout.gather(condensed.blocks)
        added = np.zeros(self.layout.shared.shape)
        lent = WITH_JOINTS if self.problem.joints else REGULAR
        added[self.split.owner, self.split.column] = lent * self.taut[self.split.edge]
        balancing = prepare_balancing(self.layout, schur, added, coarse)
        return _Factored(condensed, schur, balancing, symmetric)

    def solve_shared(
        self, factored: _Factored, force: np.ndarray, accuracy: float
    ) -> tuple[np.ndarray, int, bool]:
        """Solve for the shared unknowns by a preconditioned Krylov method.

        Returns their displacement, the number of iterations, and whether it did not converge.
        """
        layout, n, count = self.layout, self.layout.n_shared, 0
        if not n:
            return np.zeros(0), 0, False

        def note(_: object) -> None:
            nonlocal count
            count += 1

        reduced = np.bincount(self.slot, factored.condensed.reduce(force), minlength=n)
        right = self.team.total(reduced)
        bound = accuracy * float(np.linalg.norm(self.assemble(force)))
        S = LinearOperator((n, n), matvec=partial(layout.multiply, factored.schur), dtype=float)
        M = LinearOperator((n, n), matvec=factored.balancing, dtype=float)
        options = {"rtol": 0.0, "atol": bound, "M": M, "maxiter": KRYLOV, "callback": note}
        krylov = cg
        if not factored.symmetric:
            restarted = {"restart": RESTART, "maxiter": KRYLOV // RESTART}
            krylov, options = gmres, options | restarted | {"callback_type": "pr_norm"}
        edge, info = krylov(S, right, **options)
        return edge, count, bool(info)  # an inaccurate direction shows in Newton's residual


class _CutEquilibrium(Equilibrium):
    r"""Equilibrium of a cut structure under a load.

    .. math::
        \sum_E R_E^T \left( K u_E + B^T P(\tau^0 + k B u_E) + J^T w\, t(J u_E) - f_E \right) = 0,
        \qquad u_E = R_E u,    \tag{1}

    with the links and joints of every substructure :math:`E`. Without joints the line search is
    exact.
    """

    def __init__(self, cut: SchurSolver, load: np.ndarray, state: JointState) -> None:
        history = state.history[: cut.law.n_state, cut.points]
        super().__init__(cut.bodies, load, cut.law, history)
        self.cut, self.links = cut, cut.stack.links
        self.resists, self.descends = bool(cut.problem.joints), cut.problem.n_links > 0
        self.lending, self.known = SlackStiffness(SLACK, SLACKEST), None
        self.krylov = self.unfinished = 0
        largest = float(np.abs(cut.assemble(load)).max(initial=0.0))
        self.scale = largest or self._most(self.links.prestress) or 1.0

    def _most(self, value: np.ndarray) -> float:
        """Largest size of an entry in all processes."""
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
        return float(np.abs(self.cut.assemble(force)).max(initial=0.0))

    def largest(self, here: Place) -> float:
        """Size of the forces that cancel in equilibrium, N."""
        forces = self.magnitude @ np.abs(here.value)
        return self._most(np.append(forces, self.cut.tension(here.elastic)))

    def dot(self, first: np.ndarray, second: np.ndarray) -> float:
        """Work in all substructures, J."""
        return self.cut.total(float(first @ second))

    def anywhere(self, flag: bool) -> bool:
        """Whether a flag is set in any process."""
        return bool(self.cut.total(flag))

    def residual(self, here: Place) -> float:
        """Largest residual force relative to the load; infinite if its square is infinite."""
        residual = super().residual(here)
        return residual if residual <= OVERFLOW else np.inf

    def direction(self, here: Place, floor: float = 0.0) -> np.ndarray | None:
        """Newton direction, m; None if the tangent is singular."""
        cut, residual = self.cut, self.residual(here)
        if self.lending.exhausted:
            return None
        # status of the links, and the stiffness lent to slack links
        carries = cut.carried(here.elastic) == here.elastic
        if self.known is not None and not cut.total(np.count_nonzero(carries != self.known)):
            self.lending.reset()
        self.known = carries
        key = np.append(carries, self.lending.share)
        changed = cut.total(np.count_nonzero(key != cut.key))
        try:
            # factors last until a link or a joint changes
            factored = cut.factored
            if cut.problem.joints or factored is None or changed:
                lent = floor * self.bodies.resistance * self.bodies.weight * np.eye(3)[:, :, None]
                carried = np.where(carries, 1.0, self.lending.share)
                factored = cut.factorise(here.tangent + lent, carried)
                cut.factored, cut.key = factored, key
            # the tolerance of the linear system decreases with the residual
            accuracy = min(COARSEST, residual)
            accuracy = max(accuracy, 0.1 * cut.method.tolerance / residual, FINEST)
            edge, count, unfinished = cut.solve_shared(factored, -here.gradient, accuracy)
        except (MultiscaleError, np.linalg.LinAlgError):
            return None
        self.krylov, self.unfinished = self.krylov + count, self.unfinished + unfinished
        return np.asarray(factored.condensed.expand(-here.gradient, edge[cut.slot]))

    def step(self, here: Place, direction: np.ndarray) -> Place:
        """Move by an exact line search with links, an approximate search with links and joints.

        Without links the step is a full Newton step. Line searches minimise the energy.
        """
        if not self.cut.problem.n_links:
            return super().step(here, direction)
        if self.cut.problem.joints:
            length = step_length(
                lambda step: self.dot(direction, self.move(here, step, direction).gradient),
                self.dot(direction, here.gradient),
            )
        else:
            length = self._exact_step(here, direction)
        self.lending.adapt(length)
        return self.move(here, length, direction)

    def _exact_step(self, here: Place, direction: np.ndarray) -> float:
        """Step to the least energy; linear stiffness counts as a further link without limits."""
        links, team = self.links, self.cut.team
        curvature = self.dot(direction, self.bodies.stiffness @ direction)
        no_bound = np.array([np.inf]) if curvature > 0.0 else NO_LINKS
        linear = np.full(no_bound.size, curvature)
        elastic, growth, stiffness, lower, upper = (
            team.concatenate(value)
            for value in (
                here.elastic,
                self.stretch(direction),
                links.stiffness,
                links.lower - links.prestress,
                links.upper - links.prestress,
            )
        )
        return float(
            exact_step(
                np.append(elastic, 0.0 * linear),
                np.append(growth, linear),
                np.append(stiffness, linear),
                np.append(lower, -no_bound),
                np.append(upper, no_bound),
                -self.dot(direction, here.gradient),
            )
        )


@dataclass(frozen=True, eq=False)
class SchurIterate:
    """Iterate of Newton's method."""

    cut: SchurSolver
    here: Place

    def tension(self) -> np.ndarray:
        """Tension of the links, N, in the order of the substructures (of this process)."""
        return self.cut.tension(self.here.elastic)

    def displacement(self) -> np.ndarray:
        """Displacement of the unknowns of the whole structure, m."""
        shares = self.cut.assemble(np.ones(self.cut.stack.n))
        return np.asarray(self.cut.assemble(self.here.value) / np.maximum(shares, 1.0))


def _move_joints_inside(problem: CutProblem) -> tuple[CutProblem, list[tuple[int, csr_array]]]:
    """Add every joint to its second substructure, with the unknowns of the first on the joint.

    The first side of the joint becomes a perfect interface between the first substructure and the
    second with the joint, so that the stiffness of the joint, from zero to rigid, belongs to the
    second substructure.
    """
    # add unknowns of the first side
    widened = list(problem.substructures)
    for joint in problem.joints:
        first, second = joint.sides
        touched = np.unique(joint.trace[0].indices)
        new = ~np.isin(problem.substructures[first].unknown[touched], widened[second].unknown)
        widened[second] = _widen(widened[second], problem.substructures[first], touched[new])

    # jump of each joint from the unknowns of its second substructure
    inner = []
    for joint in problem.joints:
        first, second = joint.sides
        owner, lower, upper = widened[second], problem.substructures[first], joint.trace[1]
        order = np.argsort(owner.unknown)
        place = np.zeros(lower.n, dtype=int)
        touched = np.unique(joint.trace[0].indices)
        place[touched] = order[np.searchsorted(owner.unknown[order], lower.unknown[touched])]
        rows = joint.trace[0].tocoo()
        below = csr_array(
            (rows.data, (rows.coords[0], place[rows.coords[1]])), shape=(joint.size, owner.n)
        )
        above = csr_array((upper.data, upper.indices, upper.indptr), shape=(joint.size, owner.n))
        if joint.law is None or not joint.law.compliant:
            raise CaseError(
                f"a joint of substructures {joint.sides} needs a law that gives the traction of a "
                f"jump; solve_latin supports rigid contact"
            )
        inner.append((second, csr_array(above - below)))
    return CutProblem(tuple(widened), problem.position, problem.expansion), inner


def _widen(substructure: Substructure, other: Substructure, unknowns: np.ndarray) -> Substructure:
    """Append unknowns of another substructure."""
    n, added = substructure.n + unknowns.size, unknowns.size
    K = substructure.stiffness
    start = np.append(K.indptr, np.full(added, K.indptr[-1]))
    links = substructure.links
    if links is not None:
        B = links.operator
        links = replace(
            links, operator=csr_array((B.data, B.indices, B.indptr), shape=(B.shape[0], n))
        )
    return Substructure(
        csr_array((K.data, K.indices, start), shape=(n, n)),
        np.concatenate([substructure.load, np.zeros((added, substructure.load.shape[1]))]),
        np.append(substructure.unknown, other.unknown[unknowns]),
        np.concatenate([substructure.position, other.position[unknowns]]),
        np.append(substructure.component, other.component[unknowns]),
        links,
    )
