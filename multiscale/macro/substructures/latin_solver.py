"""LATIN steps of a cut structure: statics, and dynamics by the scheme of Moreau and Jean."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.convergence import Status
from multiscale.errors import CaseError, MultiscaleError
from multiscale.fe.elasticity import count_free_motions
from multiscale.macro.substructures.error import ErrorEstimate
from multiscale.macro.substructures.latin import MAJOR_INTERVAL, MINOR_INTERVAL, Latin, LatinIterate
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stack import ALONE, ProcessGroup
from multiscale.macro.substructures.stepping import JointState, Method, StepAnswer
from multiscale.numerics.krylov import Anderson
from multiscale.schema import MACRO_RESULT, Dataset

MEMORY, RELAXED = 16, 0.95
"""Iterates stored by the acceleration; share of an image in the next iterate."""

HEURISTIC = 0.1
"""Change in an iteration, relative to the tolerance, at which the error is within the tolerance."""


@dataclass(frozen=True)
class LatinMethod(Method):
    """Micro-macro LATIN: all laws, rigid contact too, and many processes; see :func:`solve_latin`.

    It is the only method with an indicator of the error.

    Parameters
    ----------
    parts, max_iterations, after_step
        As in :class:`Method`.
    tolerance : float
        Error of the tensions, in the norm of :math:`k^{-1}` relative to their change from the
        prestress. The change in an iteration decides, which is heuristic; ``error_bound`` is
        guaranteed for links with a self-stress, and cannot fall below some 1e-7, because the
        tensions of slack links are only zero to rounding. With joints the heuristic
        ``error_indicator`` takes its place: friction has no bound. The tolerance allows for
        rounding where bodies move far on soft joints.
    coarse : bool
        Whether a coarse problem balances the resultants of the interfaces in every iteration.
        Without it the number of iterations grows with the number of substructures.
    team : ProcessGroup, optional
        Processes that share the substructures; all take part, and all get the result.
    callback : callable, optional, called as ``callback(iteration, residual, iterate)``
    """

    name: ClassVar[str] = "LATIN"
    tolerance: float = 1e-8
    max_iterations: int = 400
    coarse: bool = True
    team: ProcessGroup | None = None
    callback: Callable[[int, float, LatinIterate], None] | None = None

    def start(self, problem: CutProblem) -> "LatinSolver":
        """Compute the search directions of a structure and factorise its substructures."""
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
        Factors of the load cases, a row for each step; each step starts from the step before.
    options
        Parameters of :class:`LatinMethod`.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``. A step that did not converge is NaN with ``converged`` 0, and
        later steps are not tried. Attributes: ``unknowns``, ``coarse_unknowns``,
        ``substructures``, ``interfaces`` and, if a step failed, ``failure``: where friction
        cannot carry the load, with load and capacity of :func:`~.capacity.find_slide`. Joints add
        jump and traction at their points, in the frame of each joint: normal, then both tangents.

    Raises
    ------
    CaseError
        If load factors do not fit the load cases.
    MultiscaleError
        If the whole structure can move without resistance.

    Notes
    -----
    Each iteration is a *local stage*, a scalar projection for each link and a mean for each
    interface, and a *linear stage*, a solve for each substructure with factors that last until the
    status of a link or joint changes, and a coarse solve. Anderson acceleration combines the last
    iterates. :func:`multiscale.macro.solve_static` on one process is faster at every size that
    fits into its memory.

    References
    ----------
    .. [1] P. Ladevèze, D. Dureisseix, Int. J. Numer. Methods Eng. 48 (2000) 1183-1200.
    .. [2] K. Nineb, P. Alart, D. Dureisseix, Int. J. Numer. Methods Eng. (2007), on tensegrities.
    """
    return LatinMethod(**options).solve(problem, load_factor)


def _refuse_floating(problem: CutProblem) -> None:
    fixed = (np.diff(problem.expansion.indptr) == 0).reshape(len(problem.position), -1)
    if problem.joints or fixed.shape[1] < 3:
        return
    if freedom := count_free_motions(problem.position, fixed):
        raise MultiscaleError(
            f"{freedom} rigid motions of the substructures together can move without resistance; "
            f"add supports"
        )


class LatinSolver:
    """LATIN on a structure, step by step; a step starts from the iterates of the step before."""

    def __init__(self, problem: CutProblem, method: LatinMethod, *, judged: bool = True) -> None:
        _refuse_floating(problem)
        self.method = method
        divided = len(problem.substructures) > 1 or bool(problem.joints)
        self.iteration = Latin(problem, method.team or ALONE, coarse=method.coarse and divided)
        self.judge = ErrorEstimate(self.iteration) if judged and method.coarse else None
        self.reached: np.ndarray | None = None
        self.report: dict[str, Any] = {}

    @property
    def attributes(self) -> dict[str, int]:
        """Number of coarse unknowns."""
        return {"coarse_unknowns": self.iteration.n_coarse if self.iteration.coarse_wanted else 0}

    def step(self, state: JointState, factor: np.ndarray, near: object = None) -> StepAnswer:
        """Iterate under a load until the error is small enough."""
        latin = self.iteration
        failed = not self.report.get("converged", 1)
        if failed:  # the directions of that step mislead the next
            latin.begin()
        elsewhere = state.unknowns is not self.reached
        if failed or (elsewhere and (self.report or np.any(state.unknowns))):
            latin.resume(state)
        latin.state = state
        load = latin.stack.load @ factor
        try:
            answer = self.iterate(load)
        except MultiscaleError as error:  # a law failed: return the steps before
            if not self.report:
                raise
            failure = str(latin.slide(load, state.pressure) or error)
            self.report = self.report | {"converged": 0, "failure": failure}
            return StepAnswer(state.unknowns, state.jump, state.traction, self.report)
        self.reached, self.report = answer.unknowns, answer.report
        return answer

    def iterate(self, load: np.ndarray) -> StepAnswer:
        """Run local and linear stages under forces on the substructures of this process, N."""
        clock, method, latin = perf_counter(), self.method, self.iteration
        rows = latin.z.size  # later entries are equal in all processes and count once

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
                if residual < closest:  # pressures far from the solution mislead find_slide
                    pressure, closest = latin.pressure(), residual
                if latin.far(iterate) and latin.slide(load, pressure):
                    status = Status.INFEASIBLE
                    break
            # next iterate, and search directions that follow the status of links and joints
            x = acceleration.next(np.append(latin.z, latin.r), np.append(z, r), change, size)
            latin.z, latin.r = x[: z.size], x[z.size :]
            if iteration >= due:
                renewed = latin.update()
                if renewed is not None:
                    acceleration.renew(renewed, np.append(latin.z, latin.r))
                major = renewed is not None and renewed.all()
                due = iteration + (MAJOR_INTERVAL if major else MINOR_INTERVAL)
        # error, and state for the next step
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
            "error_bound": np.nan if problem.joints else error,
            "error_indicator": error if problem.joints else np.nan,
            "iterations": iteration,
            "wall_time": perf_counter() - clock,
            **problem.link_fields(tension, team.concatenate(latin.slack())),
        }
        u = problem.average(team.concatenate(iterate.u))
        return StepAnswer(u, jump, traction, report)


def simulate_latin(
    problem: CutProblem,
    times: np.ndarray,
    mass: float | np.ndarray,
    *,
    load_factor: Callable[[float], float] = lambda time: 1.0,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 400,
    team: ProcessGroup | None = None,
) -> Dataset:
    r"""Integrate a cut structure in time by implicit steps, as :func:`multiscale.macro.simulate`.

    Parameters
    ----------
    problem : CutProblem, the structure, cut; with one load case
    times : ndarray, shape (steps + 1,)
        Rising by equal steps h, s. The first is the initial state.
    mass : float or ndarray, shape (nodes,), mass of each node, kg
    load_factor : callable, :math:`\alpha(t)`
    start : tuple of ndarray, shape (nodes, 3), optional
        Displacement, m, and velocity, m/s, at the first time; at rest if not given.
    tolerance, max_iterations, team
        As in :func:`solve_latin`, for each step.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, a step for each time. A step that fails is NaN with
        ``converged`` 0, the attribute ``failure`` has the reason, and later steps are not tried.

    Raises
    ------
    CaseError
        If times or masses are refused.

    Notes
    -----
    With :math:`u^+ = u^- + h v^+`, a step of (6), (9) of the source is the static problem

    .. math::
        \frac{M}{h^2} u^+ + B^T \tau^+ = F^+ + \frac{M}{h^2} \left(u^- + h v^-\right),

    so that the mass is a stiffness of the substructures. It makes them positive definite.
    """
    # substructures with their share of M / h^2
    method = LatinMethod(tolerance=tolerance, max_iterations=max_iterations, team=team)
    times = np.asarray(times, dtype=float)
    h = _step(times)
    inertia = _masses(problem, mass) / h**2
    shares = problem.shares
    solver = LatinSolver(problem.with_stiffness(inertia), method, judged=False)
    latin = solver.iteration
    local = np.concatenate([problem.substructures[owner].unknown for owner in latin.stack.local])
    force = problem.sum_up([substructure.load[:, 0] for substructure in problem.substructures])

    # initial state
    u, v = _initial(problem, start)
    links = latin.stack.links
    e = links.operator @ u[local]
    tension = latin.admissible(links.prestress + links.stiffness * e)
    at_rest = {"converged": 1, "residual": 0.0, "wall_time": 0.0} | problem.link_fields(
        latin.team.concatenate(tension), latin.team.concatenate(latin.slack())
    )
    rows = [_row(problem, times[0], u, v, at_rest)]

    # time steps
    for time in times[1:]:
        push = load_factor(time) * force + inertia @ (u + h * v)
        following, _, _, report = solver.iterate(push[local] / shares[local])
        if not report["converged"]:
            failed = {name: np.full(np.shape(value), np.nan) for name, value in rows[0].items()}
            account = {name: report[name] for name in ("residual", "wall_time")}
            rows.append(failed | {"time": time, "converged": 0} | account)
            return _dataset(problem, rows).assign_attrs(
                failure=f"the motion ends before {time:g} s: {report['failure']}"
            )
        v, u = (following - u) / h, following
        rows.append(_row(problem, time, u, v, report))
    return _dataset(problem, rows)


def _step(times: np.ndarray) -> float:
    """Equal step of the times, s."""
    steps = np.diff(times)
    if times.ndim != 1 or times.size < 2 or not np.all(steps > 0.0):
        raise CaseError(f"times must rise and be at least two (s), got {times[:5]}")
    h = float(steps.mean())
    if np.ptp(steps) > 1e-9 * h:
        raise CaseError(
            f"times must rise by equal steps, because the factors of the substructures need it; "
            f"got steps from {steps.min():g} to {steps.max():g} s"
        )
    return h


def _masses(problem: CutProblem, mass: float | np.ndarray) -> csr_array:
    """Mass matrix of the unknowns, kg; rigid plates couple the masses of their nodes."""
    nodes = len(problem.position)
    if np.ndim(mass) and np.shape(mass) != (nodes,):
        raise CaseError(
            f"mass must be a number or an array of shape ({nodes},), got shape {np.shape(mass)}"
        )
    spread = np.broadcast_to(np.asarray(mass, dtype=float), (nodes,))
    E = problem.expansion
    of_row = np.repeat(spread, E.shape[0] // nodes)
    moved = of_row[np.diff(E.indptr) > 0]
    if not np.all((moved > 0.0) & np.isfinite(moved)):
        raise CaseError(f"mass must be positive and finite (kg), got {moved.min():g}")
    return csr_array(E.T @ diags_array(of_row) @ E)


def _initial(
    problem: CutProblem, start: tuple[np.ndarray, np.ndarray] | None
) -> tuple[np.ndarray, np.ndarray]:
    if start is None:
        return np.zeros(problem.n), np.zeros(problem.n)
    nodes = len(problem.position)
    shape = (nodes, problem.expansion.shape[0] // nodes)
    for name, given in zip(("displacement", "velocity"), start, strict=True):
        if np.shape(given) != shape:
            raise CaseError(f"start {name} must have shape {shape}, got {np.shape(given)}")
    u, v = problem.unknowns(np.array(start, dtype=float))
    return u, v


def _row(
    problem: CutProblem, time: float, u: np.ndarray, v: np.ndarray, report: dict[str, Any]
) -> dict[str, Any]:
    names = ("converged", "residual", "wall_time", "tension", "slack")
    moved = {"displacement": problem.displacement(u), "velocity": problem.displacement(v)}
    return {"time": time, **moved, **{name: report[name] for name in names if name in report}}


def _dataset(problem: CutProblem, rows: list[dict[str, Any]]) -> Dataset:
    values: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    result = MACRO_RESULT.build(values | {"position": problem.position})
    return result.assign_coords(component=["x", "y", "z"])
