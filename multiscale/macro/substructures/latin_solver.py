"""Solve a structure that has been cut, step by step."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import MultiscaleError
from multiscale.fe.rigid_motion import count_free_motions
from multiscale.macro.substructures.error import Admissible, ErrorBound, ForceError, indicate_error
from multiscale.macro.substructures.latin import MAJOR_INTERVAL, MINOR_INTERVAL, Latin, LatinIterate
from multiscale.macro.substructures.parallel import ProcessGroup
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.state import JointState
from multiscale.macro.substructures.stepping import Method, StepAnswer
from multiscale.numerics.anderson import Anderson
from multiscale.schema import Dataset

__all__ = ["LatinMethod", "LatinSolver", "solve_latin"]

MEMORY, RELAXED = 16, 0.95
"""Iterates that the acceleration keeps; share of an image in the next iterate."""

HEURISTIC = 0.1
"""Change in an iteration, relative to the tolerance, at which the error counts as within it."""


@dataclass(frozen=True)
class LatinMethod(Method):
    """Micro-macro LATIN: all laws, rigid contact too, and many processes; see :func:`solve_latin`.

    Only it gives an indicator of the error.

    Parameters
    ----------
    parts, max_iterations, after_step
        As of :class:`Method`.
    tolerance : float
        Of the tensions, in the norm of :math:`k^{-1}` relative to their change from the
        prestress. The change in an iteration decides, which is heuristic; ``error_bound`` is
        guaranteed where all is links whose prestress holds itself, and cannot fall below some
        1e-7, because the tensions of slack links are only zero to rounding. With joints there
        is ``error_indicator``, a heuristic one: friction has no bound. What rounding makes
        unavoidable where bodies move far on soft joints is allowed for.
    coarse : bool
        Whether a coarse problem balances the resultants of the interfaces in every iteration.
        Without it the number of iterations grows with the number of substructures.
    updated : bool
        Whether the search directions follow the status of the links and the laws of joints.
    team : ProcessGroup, optional
        Processes that share the substructures; all solve, and all get the result.
    callback : callable, optional, called as ``callback(iteration, residual, iterate)``
    """

    name: ClassVar[str] = "LATIN"
    tolerance: float = 1e-8
    max_iterations: int = 400
    coarse: bool = True
    updated: bool = True
    team: ProcessGroup | None = None
    callback: Callable[[int, float, LatinIterate], None] | None = None

    def start(self, problem: CutProblem) -> "LatinSolver":
        """Find the search directions of a structure and factorise its substructures."""
        return LatinSolver(problem, self)


def solve_latin(
    problem: CutProblem,
    load_factor: float | np.ndarray = 1.0,
    **options: Any,
) -> Dataset:
    r"""Solve substructures and interfaces by the micro-macro LATIN method.

    Parameters
    ----------
    problem : CutProblem, the structure, cut
    load_factor : float or ndarray, shape (steps,) or (steps, cases)
        Factors of the load cases, one row for each step; each starts from the one before.
    options
        Of :class:`LatinMethod`.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``. A step that did not converge is NaN with ``converged`` 0, and
        the later ones are not tried. Attributes: ``unknowns``, ``coarse_unknowns``,
        ``substructures``, ``interfaces`` and, of a step that failed, ``failure``: where friction
        cannot carry the load, with load and capacity of :func:`~.capacity.find_slide`. Joints add
        jump and traction at their points, in the frame of each: normal, then both tangents.

    Raises
    ------
    CaseError
        If load factors do not fit the load cases.
    MultiscaleError
        If the whole structure can move without resistance.

    Notes
    -----
    Each iteration is a *local stage*, one scalar projection for each link and a mean for each
    interface, and a *linear stage*, one solve for each substructure with factors that last
    until the status of a link or joint changes, and one coarse solve. Anderson acceleration
    combines the last iterates. One process with :func:`multiscale.macro.solve_static` is faster
    at every size that fits it.

    References
    ----------
    .. [1] P. Ladevèze, D. Dureisseix, Int. J. Numer. Methods Eng. 48 (2000) 1183-1200.
    .. [2] K. Nineb, P. Alart, D. Dureisseix, Int. J. Numer. Methods Eng. (2007), on tensegrities.
    """
    return LatinMethod(**options).solve(problem, load_factor)


def _refuse_floating(problem: CutProblem) -> None:
    """Refuse a structure without joints, which may stand on something, that nothing holds."""
    held = (np.diff(problem.expansion.indptr) == 0).reshape(len(problem.position), -1)
    if problem.joints or held.shape[1] < 3:
        return
    if freedom := count_free_motions(problem.position, held):
        raise MultiscaleError(
            f"{freedom} rigid motions of the substructures together can move without resistance; "
            f"add supports"
        )


class LatinSolver:
    """LATIN on a structure, step by step; iterates go on from the step before."""

    def __init__(self, problem: CutProblem, method: LatinMethod, *, judged: bool = True) -> None:
        _refuse_floating(problem)
        self.method = method
        self.iteration = Latin(
            problem,
            coarse=method.coarse and problem.divided,
            updated=method.updated,
            team=method.team,
        )
        self.judge: Callable[[LatinIterate], ForceError] | None = None
        if judged and method.coarse:
            admissible = Admissible(self.iteration)
            self.judge = ErrorBound(admissible)
            if problem.joints:  # friction has no bound
                self.judge = lambda iterate: indicate_error(admissible, iterate).estimate
        self.reached: np.ndarray | None = None
        self.report: dict[str, Any] = {}

    @property
    def attributes(self) -> dict[str, int]:
        """Number of coarse unknowns."""
        return {"coarse_unknowns": self.iteration.n_coarse if self.iteration.coarse_wanted else 0}

    def step(self, state: JointState, factor: np.ndarray, near: object = None) -> StepAnswer:
        """Iterate on one load until the error is small enough."""
        latin = self.iteration
        if state.unknowns is not self.reached and (self.report or np.any(state.unknowns)):
            latin.resume(state)
        latin.state = state
        load = latin.stack.load @ factor
        try:
            answer = self.iterate(load)
        except MultiscaleError as error:  # a law without an answer: the steps before are kept
            if not self.report:
                raise
            failure = str(latin.slide(load, state.pressure) or error)
            report = self.report | {"converged": 0, "failure": failure}
            return StepAnswer(state.unknowns, state.jump, state.traction, report)
        self.reached, self.report = answer.unknowns, answer.report
        return answer

    def iterate(self, load: np.ndarray) -> StepAnswer:
        """Run local and linear stages under forces on the substructures of this process, N.

        The next step begins with the iterate of a converged one.
        """
        clock, method, latin = perf_counter(), self.method, self.iteration
        rows = latin.z.size  # the entries behind are the same in all processes and count once

        def products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            return np.asarray(latin.team.total(a[:rows].T @ b[:rows]) + a[rows:].T @ b[rows:])

        acceleration = Anderson(MEMORY, relaxation=RELAXED, products=products)
        status, residual, due, last = Status.MAX_ITERATIONS, np.inf, MAJOR_INTERVAL, None
        pressure, closest = latin.pressure(), np.inf
        for iteration in range(1, method.max_iterations + 1):
            # both stages, and the distance of their states
            z, r, iterate = latin.iterate(load)
            change = latin.distance(z, r)
            size = latin.norm(change)
            residual, last = latin.residual(iterate, last, change), iterate
            if method.callback is not None:
                method.callback(iteration, residual, iterate)
            if not np.isfinite(residual):
                status = Status.NOT_FINITE
                break
            if residual <= max(HEURISTIC * method.tolerance, latin.rounding(iterate)):
                status = Status.CONVERGED
                break
            # bodies that run away
            if iteration % MAJOR_INTERVAL == 0:
                if residual < closest:  # they take wild pressures on their way
                    pressure, closest = latin.pressure(), residual
                if latin.far(iterate) and latin.slide(load, pressure):
                    status = Status.INFEASIBLE
                    break
            # next iterate, and search directions that follow the status of links and joints
            x = acceleration.next(np.append(latin.z, latin.r), np.append(z, r), change, size)
            latin.z, latin.r = x[: z.size], x[z.size :]
            if latin.updated and iteration >= due:
                renewed = latin.update()
                if renewed is not None:
                    acceleration.renew(renewed, np.append(latin.z, latin.r))
                major = renewed is not None and renewed.all()
                due = iteration + (MAJOR_INTERVAL if major else MINOR_INTERVAL)
        converged = status is Status.CONVERGED
        error = self.judge(iterate).relative if converged and self.judge else np.nan
        if converged:
            latin.z, latin.r = z, r
            latin.largest = max(latin.largest, latin.size(iterate))
        jump, traction = latin.joint_fields(latin.r)
        problem, team = latin.problem, latin.team
        tension = team.concatenate(latin.admissible(iterate.tension))
        report = {
            "converged": int(converged),
            "failure": "" if converged else str(latin.slide(load, pressure) or status.value),
            "residual": residual,
            "error_bound": np.nan if latin.joints else error,
            "error_indicator": error if latin.joints else np.nan,
            "iterations": iteration,
            "wall_time": perf_counter() - clock,
            **problem.link_fields(tension, team.concatenate(latin.slack())),
        }
        u = problem.average(team.concatenate(iterate.u))
        return StepAnswer(u, jump, traction, report)
