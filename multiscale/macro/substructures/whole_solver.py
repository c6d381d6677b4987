"""Newton's method for a cut structure of bodies, in one piece."""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.convergence import check_limits
from multiscale.errors import CaseError
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.condensed_problem import CondensedProblem, condense_problem
from multiscale.macro.substructures.cut_results import assemble_result, load_factors
from multiscale.macro.substructures.joint_state import state_after
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.whole_structure import assemble
from multiscale.schema import Dataset

__all__ = ["solve_whole"]


def solve_whole(
    problem: CutProblem,
    load_factor: float | np.ndarray = 1.0,
    *,
    after: Dataset | None = None,
    near: Dataset | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 100,
    after_step: Callable[[], object] | None = None,
) -> Dataset:
    """Solve elastic bodies in one piece: the slow twin of LATIN and Newton-Schur on large cuts.

    Parameters
    ----------
    problem, load_factor, after
        As of :func:`solve_latin`, without links, which :func:`multiscale.macro.solve_static` takes;
        however it is cut, the answer is the same.
    near : Dataset, optional
        The same steps, and those before, under other laws: each step begins with what this path
        did in it.
    tolerance, max_iterations
        See :func:`~multiscale.macro.monolithic.solve_interface`.
    after_step : callable, optional, called after every step that converged

    Returns
    -------
    Dataset
        As :func:`solve_latin` gives it. A step that did not converge is NaN with ``converged`` 0,
        and the later ones are not tried.

    Raises
    ------
    CaseError
        If load factors do not fit the load cases, there are links, or a joint is one of rigid
        contact.
    ConvergenceError
        If a step wins energy; see :func:`~multiscale.laws.side_by_side.advance_state`.
    """
    check_limits(tolerance, max_iterations)
    if problem.n_links:
        raise CaseError("links are not solved as bodies in one piece; solve_static takes them")
    if not all(joint.law and joint.law.compliant for joint in problem.joints):
        raise CaseError(
            "a joint needs a law that tells the traction of a jump; solve_latin takes rigid "
            "contact as well"
        )
    factors, bodies = load_factors(problem, load_factor, after), condense_problem(problem)
    whole = assemble(bodies.small)
    law, state, before = problem.law, state_after(problem, after), np.zeros(0)
    u: np.ndarray | None = None
    jump, first = np.zeros((3, problem.weight.size)), 0
    if after is not None and problem.joints:
        u = bodies.keep(problem.unknowns(after["displacement"].values[-1]))
        jump, before = after["jump"].values[-1].T, -after["traction"].values[-1, :, 0]
        first = after.sizes["step"]
    changes = _changes(problem, bodies, near) if problem.joints else []
    columns: list[dict[str, Any]] = []
    for step, factor in enumerate(factors, start=first):
        clock = perf_counter()
        # tangential jumps of the step alone: sums round away what slides far on a stiff law
        slid, state = jump * np.array([[0.0], [1.0], [1.0]]), law.from_here(state)
        starts = [(u, jump - slid)]
        if step < len(changes):  # as the path that is near, else from where this one stands
            moved, opened = changes[step]
            starts.insert(0, ((0.0 if u is None else u) + moved, jump - slid + opened))
        for start, begin in starts:
            solution = whole.solve(
                law,
                factor,
                start=start,
                jump=begin,
                state=state,
                max_iterations=max_iterations,
                tolerance=tolerance,
            )
            if solution.converged:
                break
        with np.errstate(over="ignore", invalid="ignore"):  # where a failed step may have ended
            response = law.respond(solution.jump, state)
        jump = slid + solution.jump
        failure = ""
        if not solution.converged:
            slide = find_slide(problem, problem.load(factor), before, -response.traction[0])
            failure = str(slide or solution.status.value)
        columns.append(
            {
                "displacement": problem.displacement(bodies.expand(solution.value)),
                **({"jump": jump.T, "traction": response.traction.T} if problem.joints else {}),
                "converged": int(solution.converged),
                "failure": failure,
                "residual": solution.residuals[-1],
                "iterations": len(solution.residuals) - 1,
                "wall_time": perf_counter() - clock,
            }
        )
        if not solution.converged:
            break
        if after_step is not None:
            after_step()
        u, before = solution.value, -response.traction[0]
        state = law.sliding(solution.jump, state).state
    return assemble_result(problem, factors, columns, after)


def _changes(
    problem: CutProblem, bodies: CondensedProblem, near: Dataset | None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Read off how kept unknowns and jumps, (3, points), change in the steps of a path, m."""
    if near is None:
        return []
    solved = near["converged"].values == 1
    u = problem.unknowns(near["displacement"].values[solved])
    jump = np.swapaxes(near["jump"].values[solved], 1, 2)
    pairs = (np.diff(one, axis=0, prepend=np.zeros_like(one[:1])) for one in (u, jump))
    return [(bodies.keep(moved), opened) for moved, opened in zip(*pairs, strict=True)]
