"""Equilibrium with small displacements, by one method or several in turn."""

from dataclasses import replace

import numpy as np

from multiscale.convergence import Solution, Status
from multiscale.errors import CaseError
from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.dual_program import solve_dual_program
from multiscale.macro.discrete.interior_point import solve_interior_point
from multiscale.macro.discrete.link_complementarity import solve_complementarity
from multiscale.macro.discrete.link_newton import solve_newton
from multiscale.macro.discrete.link_state import LinkState
from multiscale.macro.discrete.link_tangent import Tangent
from multiscale.numerics.factorisation import Solve
from multiscale.numerics.newton import Limits, join_solutions

__all__ = ["STATIC_METHODS", "find_state"]

STATIC_METHODS = ("auto", "newton", "interior_point", "lcp", "dual")


def find_state(
    model: LinkEquations,
    tangent: Tangent,
    load_factor: float,
    start: np.ndarray,
    method: str,
    limits: Limits,
    taut: Solve | None = None,
) -> LinkState:
    """Find the equilibrium at a load factor."""
    rigid = np.isinf(model.stiffness).any()
    if method == "dual":
        return solve_dual_program(model, load_factor, tolerance=limits.tolerance)
    if method == "lcp":
        if rigid:
            raise CaseError(
                "method 'lcp' needs extensible links; use method='auto' or 'dual' for links of "
                "fixed length"
            )
        return solve_complementarity(model, tangent, load_factor, tolerance=limits.tolerance)

    if rigid and method == "newton":
        raise CaseError(
            "method 'newton' needs extensible links; use method='auto' for links of fixed length"
        )
    if rigid:
        return solve_interior_point(model, tangent, load_factor, limits)
    parts: list[tuple[str, Solution]] = []
    if method != "interior_point":
        state = solve_newton(model, tangent, load_factor, start, limits, taut)
        parts.append(("newton", state.solution))
    if method == "interior_point" or (method == "auto" and not state.solution.converged):
        state = solve_interior_point(model, tangent, load_factor, limits)
        inside = state.solution
        parts.append(("interior_point", inside))
        if inside.status is not Status.INFEASIBLE and inside.residuals:
            state = solve_newton(model, tangent, load_factor, inside.value, limits)
            parts.append(("newton", state.solution))
    whole = join_solutions([part for _, part in parts], [name for name, _ in parts])
    return replace(state, solution=whole)
