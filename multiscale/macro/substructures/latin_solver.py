"""Solve a structure that has been cut, step by step."""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.convergence import Status, check_limits
from multiscale.errors import MultiscaleError
from multiscale.fe.rigid_motion import count_free_motions
from multiscale.macro.substructures.bound import Admissible, ErrorBound
from multiscale.macro.substructures.cut_results import assemble_result, link_fields, load_factors
from multiscale.macro.substructures.indicator import indicate_error
from multiscale.macro.substructures.latin import MAJOR_INTERVAL, MINOR_INTERVAL, Latin, LatinIterate
from multiscale.macro.substructures.parallel import ProcessGroup
from multiscale.macro.substructures.problem import CutProblem
from multiscale.numerics.anderson import Anderson
from multiscale.schema import Dataset

__all__ = ["solve_latin", "solve_step"]

ACCOUNT = (
    "converged",
    "failure",
    "residual",
    "error_bound",
    "error_indicator",
    "iterations",
    "wall_time",
)

MEMORY, RELAXED = 16, 0.95
"""Iterates that the acceleration keeps; share of an image in the next iterate."""

HEURISTIC = 0.1
"""Change in an iteration, relative to the tolerance, at which the error counts as within it."""


def solve_latin(
    problem: CutProblem,
    load_factor: float | np.ndarray = 1.0,
    *,
    after: Dataset | None = None,
    coarse: bool = True,
    updated: bool = True,
    tolerance: float = 1e-8,
    max_iterations: int = 400,
    team: ProcessGroup | None = None,
    callback: Callable[[int, float, LatinIterate], None] | None = None,
    after_step: Callable[[], object] | None = None,
) -> Dataset:
    r"""Solve substructures and interfaces by the micro-macro LATIN method.

    Parameters
    ----------
    problem : CutProblem, the structure, cut
    load_factor : float or ndarray, shape (steps,) or (steps, cases)
        Factors of the load cases, one row for each step; each starts from the one before.
    after : Dataset, optional
        An earlier path by the same method, of this problem or of one with other loads or bolts:
        the first step goes on from its last. Its steps come first in the result. The states of the
        laws follow from its jumps.
    coarse : bool
        Whether a coarse problem balances the resultants of the interfaces in every iteration.
        Without it the number of iterations grows with the number of substructures.
    updated : bool
        Whether the search directions follow the status of the links and the laws of joints.
    tolerance : float
        Of the tensions, in the norm of :math:`k^{-1}` relative to their change from the
        prestress. The change in an iteration decides, which is heuristic; ``error_bound`` is
        guaranteed where all is links whose prestress holds itself, and cannot fall below some
        1e-7, because the tensions of slack links are only zero to rounding. With joints there
        is ``error_indicator``, a heuristic one: friction has no bound. What rounding makes
        unavoidable where bodies move far on soft joints is allowed for.
    max_iterations : int, iteration limit of a step
    team : ProcessGroup, optional
        Processes that share the substructures; all call this function, and all get the result.
    callback : callable, optional, called as ``callback(iteration, residual, iterate)``
    after_step : callable, optional, called after every step that converged

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``. A step that did not converge is NaN with ``converged`` 0, and
        the later ones are not tried. Attributes: ``unknowns``, ``coarse_unknowns``,
        ``substructures``, ``interfaces`` and, of a step that failed, ``failure``: where friction
        cannot carry the load, :func:`~.capacity.find_slide` says so. Joints add jump and traction
        at their points, in their own frame: normal, then both tangents.

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
    check_limits(tolerance, max_iterations)
    _refuse_floating(problem)
    factors = load_factors(problem, load_factor, after)
    method = Latin(problem, coarse=coarse and problem.divided, updated=updated, team=team)
    if after is not None:
        method.resume(after)
    judge = _judge(method) if coarse else None
    columns: list[dict[str, Any]] = []
    for factor in factors:
        load = method.stack.load @ factor
        try:
            columns.append(solve_step(method, load, judge, tolerance, max_iterations, callback))
        except MultiscaleError as error:  # a law without an answer: the steps before are kept
            if not columns:
                raise
            failure = str(method.slide(load, method.before) or error)
            columns.append(columns[-1] | {"converged": 0, "failure": failure})
        if not columns[-1]["converged"]:
            break
        if after_step is not None:
            after_step()
    return assemble_result(
        problem,
        factors,
        [{name: column[name] for name in ACCOUNT} | _fields(method, column) for column in columns],
        after,
        coarse_unknowns=method.n_coarse if method.coarse_wanted else 0,
    )


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


def solve_step(
    method: Latin,
    load: np.ndarray,
    judge: Callable[[LatinIterate], dict[str, float]] | None,
    tolerance: float,
    max_iterations: int,
    callback: Callable[[int, float, LatinIterate], None] | None,
) -> dict[str, Any]:
    """Iterate on one load until the error is small enough; the joints keep a converged state."""
    clock = perf_counter()
    own = method.z.size  # the entries behind are the same in all processes and count once

    def products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.asarray(method.team.total(a[:own].T @ b[:own]) + a[own:].T @ b[own:])

    acceleration = Anderson(MEMORY, relaxation=RELAXED, products=products)
    status, residual, due, last = Status.MAX_ITERATIONS, np.inf, MAJOR_INTERVAL, None
    pressure, closest = method.pressure(), np.inf
    for iteration in range(1, max_iterations + 1):
        z, r, found = method.iterate(load)
        change = method.distance(z, r)
        size = method.norm(change)
        residual, last = method.residual(found, last, change), found
        if callback is not None:
            callback(iteration, residual, found)
        if not np.isfinite(residual):
            status = Status.NOT_FINITE
            break
        if residual <= max(HEURISTIC * tolerance, method.rounding(found)):
            status = Status.CONVERGED
            break
        if iteration % MAJOR_INTERVAL == 0:
            if residual < closest:  # a body that runs away takes wild pressures on its way
                pressure, closest = method.pressure(), residual
            if method.far(found) and method.slide(load, pressure):
                status = Status.INFEASIBLE
                break
        x = acceleration.next(np.append(method.z, method.r), np.append(z, r), change, size)
        method.go_on_from(x[: z.size], x[z.size :])
        if method.updated and iteration >= due:
            renewed = method.update()
            if renewed is not None:
                acceleration.renew(renewed, np.append(method.z, method.r))
            major = renewed is not None and renewed.all()
            due = iteration + (MAJOR_INTERVAL if major else MINOR_INTERVAL)
    converged = status is Status.CONVERGED
    judged = judge(found) if converged and judge else {}
    if converged:
        method.go_on_from(z, r)
    jump, traction = method.joint_fields(method.r)
    fields = {"slack": method.slack(), "jump": jump, "traction": traction, "found": found}
    if converged:
        method.commit(found)
    return {
        **fields,
        "converged": int(converged),
        "failure": "" if converged else str(method.slide(load, pressure) or status.value),
        "residual": residual,
        "error_bound": judged.get("error_bound", np.nan),
        "error_indicator": judged.get("error_indicator", np.nan),
        "iterations": iteration,
        "wall_time": perf_counter() - clock,
    }


def _judge(method: Latin) -> Callable[[LatinIterate], dict[str, float]]:
    """Return what measures the error of a state, relative to its size: friction has no bound."""
    admissible = Admissible(method.stack, method.sides, method.k0.matrix, method.own)
    if method.problem.joints:

        def indicate(found: LatinIterate) -> dict[str, float]:
            return {"error_indicator": indicate_error(method, admissible, found).estimate.relative}

        return indicate
    bound, team = ErrorBound(method.stack, admissible), method.team
    return lambda found: {
        "error_bound": bound.evaluate(found.u, found.tension, found.force, team).relative
    }


def _fields(method: Latin, column: dict[str, Any]) -> dict[str, np.ndarray]:
    """Displacement of the nodes, and results of the links and joints of all processes."""
    problem, team, found = method.problem, method.team, column["found"]
    u = problem.average(team.concatenate(found.u))
    fields = {"displacement": problem.displacement(u)}
    if problem.joints:
        fields |= {name: column[name].T for name in ("jump", "traction")}
    tension = team.concatenate(method.admissible(found.tension))
    return fields | link_fields(problem, tension, team.concatenate(column["slack"]))
