"""Semismooth Newton outside, a balanced Schur complement inside."""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.convergence import Status, check_limits
from multiscale.errors import MultiscaleError
from multiscale.macro.interface_newton import ROUNDS
from multiscale.macro.substructures.cut_results import assemble_result, link_fields, load_factors
from multiscale.macro.substructures.cut_tangent import Newton
from multiscale.macro.substructures.parallel import ProcessGroup
from multiscale.macro.substructures.problem import CutProblem
from multiscale.numerics.newton import Limits, NewtonRun
from multiscale.schema import Dataset

__all__ = ["solve_schur"]

OVERFLOW = 1e150
"""Residual whose square, in the linear solver, is no number any more."""


def solve_schur(
    problem: CutProblem,
    load_factor: float | np.ndarray = 1.0,
    *,
    after: Dataset | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 100,
    team: ProcessGroup | None = None,
    callback: Callable[[int, float, Newton], None] | None = None,
    after_step: Callable[[], object] | None = None,
) -> Dataset:
    r"""Solve substructures and interfaces by Newton's method and domain decomposition.

    Parameters
    ----------
    problem, load_factor, after, team
        As of :func:`solve_latin`.
    tolerance : float
        Bound on the largest force out of balance relative to the largest nodal load (without
        load: to the largest prestress); dimensionless. What rounding makes unavoidable is
        allowed for; ``residual`` says what was reached.
    max_iterations : int, limit of Newton steps for one load
    callback : callable, optional
        Called as ``callback(iteration, residual, state)``: ``state.tension()`` of the links, N, in
        the order of the substructures (of this process), ``state.displacement()`` of all
        unknowns, m. All processes give one, or none.
    after_step : callable, optional, called after every step that converged

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``. A step that did not converge is NaN with ``converged`` 0, and the
        later ones are not tried. ``iterations`` counts the Newton steps, ``krylov_iterations`` the
        iterations of the linear solver in all of them. Attributes: ``unknowns``,
        ``shared_unknowns``, ``coarse_unknowns``, ``substructures``, ``interfaces`` and, of a step
        that failed, ``failure``, as in :func:`solve_latin`, which says what joints add.

    Raises
    ------
    CaseError
        If load factors do not fit the load cases.

    Notes
    -----
    The tangent is condensed onto the unknowns that substructures share. Conjugate gradients,
    preconditioned by BDDC, solve for them; the resultants of edges and all forces of
    cross-points are in balance in every iteration. A joint belongs to its second substructure.
    If its tangent is not symmetric, as with friction, GMRES takes the place of conjugate
    gradients. Each system is solved the more accurately the closer the solution is.

    Without joints the step is exact along every direction; see :func:`solve_static`.

    References
    ----------
    .. [1] C. R. Dohrmann, SIAM J. Sci. Comput. 25 (2003) 246-258,
       doi:10.1137/S1064827502412887.
    .. [2] S. C. Eisenstat, H. F. Walker, SIAM J. Sci. Comput. 17 (1996) 16-32,
       doi:10.1137/0917003, on how accurately to solve.
    """
    check_limits(tolerance, max_iterations)
    factors = load_factors(problem, load_factor, after)
    method = Newton(problem, team)
    if after is not None:
        method.resume(after)
    columns: list[dict[str, Any]] = []
    for factor in factors:
        columns.append(_solve_step(method, factor, tolerance, max_iterations, callback))
        if not columns[-1]["converged"]:
            break
        if after_step is not None:
            after_step()
    return assemble_result(
        problem,
        factors,
        columns,
        after,
        shared_unknowns=method.layout.n_shared,
        coarse_unknowns=method.layout.n_coarse,
    )


@np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
def _solve_step(
    method: Newton,
    factor: np.ndarray,
    tolerance: float,
    max_iterations: int,
    callback: Callable[[int, float, Newton], None] | None,
) -> dict[str, Any]:
    """Newton's method for one load."""
    clock = perf_counter()
    method.start(factor)
    krylov, closest = 0, method.imbalance()
    imbalance = closest

    def note(iteration: int, residual: float) -> None:
        if callback is not None:
            callback(iteration, residual, method)

    run = NewtonRun(Limits(max_iterations, tolerance, note))
    while run.goes_on(imbalance.residual, imbalance.rounding):
        if method.lending.exhausted:
            run.stop(Status.STALLED)
            break
        if imbalance.residual > OVERFLOW:  # bodies that slide away
            run.stop(Status.NOT_FINITE)
            break
        try:
            krylov += method.advance(imbalance, tolerance, search=run.since_best > ROUNDS)
        except (MultiscaleError, np.linalg.LinAlgError):  # the tangent is singular
            run.stop(Status.STALLED)
            break
        imbalance = method.imbalance()
        closest = min(closest, imbalance, key=lambda one: one.residual)
    if run.converged:
        method.commit()
    return {
        "displacement": method.problem.displacement(method.displacement()),
        **method.joint_fields(imbalance),
        **link_fields(
            method.problem,
            method.team.concatenate(method.tension()),
            method.team.concatenate(method.slack()),
        ),
        "converged": int(run.converged),
        "failure": "" if run.converged else method.why(run.status, closest),
        "residual": imbalance.residual,
        "iterations": run.steps,
        "krylov_iterations": krylov,
        "wall_time": perf_counter() - clock,
    }
