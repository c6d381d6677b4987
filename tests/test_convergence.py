"""Records of iterations, when they stop, and paths with halved steps."""

from inspect import signature

import numpy as np
import pytest

from multiscale.convergence import Solution, Status
from multiscale.errors import CaseError, ConvergenceError
from multiscale.macro.continuum.contact_steps import solve_contact
from multiscale.macro.joint.tread import slide_tread
from multiscale.macro.links.statics import solve_static
from multiscale.macro.monolithic import solve_interface
from multiscale.macro.substructures import AssembledNewton, LatinMethod, NewtonSchur
from multiscale.macro.substructures.latin_solver import simulate_latin
from multiscale.micro.cell import solve_cell
from multiscale.micro.damage.element_fatigue import local_fatigue
from multiscale.micro.damage.rve import effective_stiffness
from multiscale.micro.elastic.viscoelastic import solve_sliding
from multiscale.micro.slide import slide_cell
from multiscale.nonsmooth.coulomb import verify_friction
from multiscale.nonsmooth.friction import solve_friction
from multiscale.nonsmooth.lcp import solve_lcp
from multiscale.numerics.newton import Limits, NewtonRun, join_solutions, march
from multiscale.upscaling.export import pressure_overclosure


def test_unwrapping_a_converged_solution_gives_its_value():
    assert Solution(np.ones(2), Status.CONVERGED, (1e-12,)).unwrap().sum() == 2.0


SOLVERS = [
    *(solve_friction, solve_lcp, verify_friction, solve_cell, slide_cell, solve_sliding),
    *(local_fatigue, effective_stiffness, solve_contact, solve_static, slide_tread),
    *(solve_interface, simulate_latin),
    *(pressure_overclosure, AssembledNewton, NewtonSchur, LatinMethod, Limits),
]


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("tolerance", [-1.0, 0.0, 1.0, np.nan])
def test_a_solver_refuses_a_tolerance_that_is_not_a_share(solve, tolerance):
    arguments = signature(solve).parameters.values()
    missing = [
        argument
        for argument in arguments
        if argument.default is argument.empty and argument.name != "tolerance"
    ]
    with pytest.raises(CaseError, match="tolerance is relative and must lie between 0 and 1"):
        solve(
            *(None for item in missing if item.kind is not item.KEYWORD_ONLY),
            **{item.name: None for item in missing if item.kind is item.KEYWORD_ONLY},
            tolerance=tolerance,
        )


def attempt(limit, none=()):
    """Steps converge up to a length; from some places nothing can be solved."""

    def solve(reached, aim):
        if reached in none:
            raise ConvergenceError("nothing holds")
        status = Status.CONVERGED if aim - reached <= limit else Status.STALLED
        return Solution(np.array(aim), status, (0.0,), (1.0,)), aim

    return solve


def test_a_path_is_gone_in_halves_where_steps_fail():
    parts = march(attempt(0.3), 0.0, (0.0, 1.0), cuts=3)
    assert [part.aim for part in parts] == [1.0, 0.5, 0.25, 0.5, 0.75, 1.0]
    whole = join_solutions([part.solution for part in parts], ["a", "b"])
    assert whole.converged
    assert whole.seconds == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


def test_a_path_ends_with_the_shortest_step_that_fails():
    parts = march(attempt(0.1), 0.0, (0.0, 1.0), cuts=2)
    assert [part.aim for part in parts] == [1.0, 0.5, 0.25]
    assert not parts[-1].solution.converged


@pytest.mark.parametrize("none", [0.0, 0.5])
def test_a_step_without_any_solution_raises_at_once_or_when_it_is_shortest(none):
    with pytest.raises(ConvergenceError, match="nothing holds"):
        march(attempt(0.5, none=(none,)), 0.0, (0.0, 1.0), cuts=2)


def test_a_run_stops_at_the_limit_at_rounding_and_without_progress():
    run = NewtonRun(Limits(max_iterations=2, tolerance=1e-3))
    assert [run.goes_on(residual) for residual in (1.0, 0.5, 0.4)] == [True, True, False]
    assert run.solution(np.zeros(1)).status is Status.MAX_ITERATIONS
    run = NewtonRun(Limits(tolerance=1e-3))
    assert not run.goes_on(0.1, floor=0.2)
    assert run.converged
    run = NewtonRun(Limits(tolerance=1e-3), patience=1)
    assert [run.goes_on(residual) for residual in (1.0, 2.0, 2.0)] == [True, True, False]
    assert run.status is Status.STALLED
    assert run.since_best == 2
