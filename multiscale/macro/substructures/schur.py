"""Semismooth Newton outside, a balanced Schur complement inside."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import MultiscaleError
from multiscale.macro.interface_newton import ROUNDS
from multiscale.macro.substructures.cut_tangent import Newton
from multiscale.macro.substructures.parallel import ProcessGroup
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.state import JointState
from multiscale.macro.substructures.stepping import Method, StepAnswer
from multiscale.numerics.newton import Limits, NewtonRun
from multiscale.schema import Dataset

__all__ = ["NewtonSchur", "solve_schur"]

OVERFLOW = 1e150
"""Residual whose square, in the linear solver, is no number any more."""


@dataclass(frozen=True)
class NewtonSchur(Method):
    """Newton's method with a balanced Schur complement; see :func:`solve_schur`.

    It takes all laws but rigid contact, on many processes.

    Parameters
    ----------
    parts, after_step
        As of :class:`Method`.
    tolerance : float
        Bound on the largest force out of balance relative to the largest nodal load (without
        load: to the largest prestress); dimensionless. What rounding makes unavoidable is
        allowed for; ``residual`` says what was reached.
    max_iterations : int, limit of Newton steps for one load
    team : ProcessGroup, optional, as of :class:`LatinMethod`
    callback : callable, optional
        Called as ``callback(iteration, residual, state)``: ``state.tension()`` of the links, N, in
        the order of the substructures (of this process), ``state.displacement()`` of all
        unknowns, m. All processes give one, or none.
    """

    name: ClassVar[str] = "Newton-Schur"
    team: ProcessGroup | None = None
    callback: Callable[[int, float, Newton], None] | None = None

    def start(self, problem: CutProblem) -> "_SchurSolver":
        """Lay out shared and coarse unknowns."""
        return _SchurSolver(problem, self)


def solve_schur(
    problem: CutProblem,
    load_factor: float | np.ndarray = 1.0,
    *,
    after: Dataset | None = None,
    **options: Any,
) -> Dataset:
    r"""Solve substructures and interfaces by Newton's method and domain decomposition.

    Parameters
    ----------
    problem, load_factor, after
        As of :func:`solve_latin`.
    options
        Of :class:`NewtonSchur`.

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
    return NewtonSchur(**options).solve(problem, load_factor, after)


class _SchurSolver:
    """Newton-Schur on a structure, step by step."""

    def __init__(self, problem: CutProblem, method: NewtonSchur) -> None:
        self.method, self.newton = method, Newton(problem, method.team)
        layout = self.newton.layout
        self.attributes = {"shared_unknowns": layout.n_shared, "coarse_unknowns": layout.n_coarse}

    @np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
    def step(self, state: JointState, factor: np.ndarray, near: object = None) -> StepAnswer:
        """Newton's method for one load."""
        clock, method, newton = perf_counter(), self.method, self.newton
        newton.start(state, factor)
        krylov, closest = 0, newton.imbalance()
        imbalance = closest

        def note(iteration: int, residual: float) -> None:
            if method.callback is not None:
                method.callback(iteration, residual, newton)

        run = NewtonRun(Limits(method.max_iterations, method.tolerance, note))
        while run.goes_on(imbalance.residual, imbalance.rounding):
            if newton.lending.exhausted:
                run.stop(Status.STALLED)
                break
            if imbalance.residual > OVERFLOW:  # bodies that slide away
                run.stop(Status.NOT_FINITE)
                break
            try:
                krylov += newton.advance(
                    imbalance, method.tolerance, search=run.since_best > ROUNDS
                )
            except (MultiscaleError, np.linalg.LinAlgError):  # the tangent is singular
                run.stop(Status.STALLED)
                break
            imbalance = newton.imbalance()
            closest = min(closest, imbalance, key=lambda place: place.residual)
        newton.reached, team = newton.displacement(), newton.team
        report = {
            "converged": int(run.converged),
            "failure": "" if run.converged else newton.why(run.status, closest),
            "residual": imbalance.residual,
            "iterations": run.steps,
            "krylov_iterations": krylov,
            "wall_time": perf_counter() - clock,
            **newton.problem.link_fields(
                team.concatenate(newton.tension()), team.concatenate(newton.slack())
            ),
        }
        jump, traction = newton.joined(newton.at), newton.joined(imbalance.traction)
        return StepAnswer(newton.reached, jump, traction, report)
