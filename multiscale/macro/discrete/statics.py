"""Static equilibrium of a discrete structure."""

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.convergence import Solution, Status, check_limits
from multiscale.errors import CaseError, MultiscaleError
from multiscale.macro.discrete.checks import check_supports
from multiscale.macro.discrete.compatibility import LinkEquations, equations
from multiscale.macro.discrete.description import join_steps, step_values
from multiscale.macro.discrete.finite_displacement import find_finite_state
from multiscale.macro.discrete.link_stability import (
    material_entries,
    smallest_eigenvalue,
    stability_entries,
)
from multiscale.macro.discrete.link_state import LinkState, state_of
from multiscale.macro.discrete.link_system import LinkSystem
from multiscale.macro.discrete.link_tangent import Tangent, prepare_tangent
from multiscale.macro.discrete.mechanism import factorise_taut, name_mechanism, name_motion
from multiscale.macro.discrete.small_displacement import STATIC_METHODS, find_state
from multiscale.numerics.factorisation import Solve
from multiscale.numerics.newton import Limits
from multiscale.schema import Dataset

__all__ = ["solve_static"]

FindState = Callable[[np.ndarray, float, float], LinkState]
"""State from an initial displacement, its load factor, and the load factor to reach."""

EXACT_HINT = "an exact analysis (exact = true) includes the geometric stiffness of the prestress"


def solve_static(
    system: LinkSystem,
    load_factor: float | Sequence[float] = 1.0,
    *,
    method: str = "auto",
    exact: bool = False,
    stability: bool = False,
    max_iterations: int = 60,
    tolerance: float = 1e-10,
    callback: Callable[[int, float], None] | None = None,
) -> Dataset:
    r"""Find tensions and displacements under a load.

    Parameters
    ----------
    system : LinkSystem, the structure with its load :math:`F^d`
    load_factor : float or sequence of float
        :math:`\alpha`, dimensionless. Each step of a sequence starts from the last one.
    method : str
        ``"auto"`` is a proximal semismooth Newton method; if it fails, because too many links are
        slack, an interior-point method follows, and then Newton again.
        ``"newton"`` and ``"interior_point"`` are these methods alone; ``"lcp"`` solves the
        complementarity problem (10) of the source, ``"dual"`` the quadratic program in the
        tensions by clarabel, accurate to about 1e-7.
    exact : bool
        Whether elongations and directions are geometrically exact. Otherwise displacements are
        small, as in the source.
    stability : bool
        Whether to compute the smallest eigenvalue of the tangent, without and with the geometric
        stiffness of the tensions.
    max_iterations : int, iteration limit of a method
    tolerance : float
        Bound on the largest force out of balance relative to the largest nodal load (without
        load: to the largest prestress); dimensionless. The bound is raised to the rounding error;
        ``residual`` is the value reached.
    callback : callable, optional, called as ``callback(iteration, residual)``

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``: ``tension (link)``, ``slack (link)`` (0 where taut),
        ``displacement (node, component)``, with beams ``rotation`` and ``moment``; a sequence
        adds the dimension ``step``. A step that does not converge is NaN with ``converged`` 0,
        and the attribute ``failure`` states the reason and the nodes that can move freely.

    Raises
    ------
    CaseError
        If the structure is not supported, or the options do not fit it.

    Notes
    -----
    Tensions are unique. Slacks and displacements are not unique if slack links leave a mechanism
    that the load does not move: the result is then one of several solutions.

    Examples
    --------
    >>> from multiscale.macro import tensegrity_grid
    >>> result = solve_static(tensegrity_grid(4), [0.0, 1.0])
    >>> result.converged.values
    array([1, 1])
    >>> result.tension.sel(step=0).max().round(6).item()
    2550.0
    """
    check_limits(tolerance, max_iterations)
    factors = np.atleast_1d(np.asarray(load_factor, dtype=float))
    _check(system, factors, method, exact, stability)
    check_supports(system)
    model = equations(system)
    tangent = prepare_tangent(system, model)
    limits = Limits(max_iterations, tolerance, callback)
    find = _search(system, model, tangent, method, exact, limits)
    start, reached = np.zeros(model.n), 0.0
    columns, failures = list[dict[str, Any]](), list[str]()

    for factor in factors:
        clock = perf_counter()
        state = find(start, reached, factor)
        column = step_values(system, model, state)
        if not state.solution.converged:
            failures.append(f"load factor {factor:g}: {_reason(model, tangent, state, method)}")
        else:
            start, reached = state.solution.value, factor
            if stability:
                material = material_entries(model, tangent, state)
                column["tangent_eigenvalue"] = smallest_eigenvalue(tangent, material)
                whole = stability_entries(system, model, tangent, state)
                column["stability_eigenvalue"] = smallest_eigenvalue(tangent, whole)
        columns.append(column | {"wall_time": perf_counter() - clock})
    result = join_steps(system, factors, columns)
    if failures:
        result = result.assign_attrs(failure="\n".join(failures))
    return result if np.ndim(load_factor) else result.isel(step=0)


def _check(
    system: LinkSystem, factors: np.ndarray, method: str, exact: bool, stability: bool
) -> None:
    """Refuse options that do not fit the structure."""
    if factors.ndim != 1 or not factors.size or not np.isfinite(factors).all():
        raise CaseError(f"load_factor must be a finite number or a list of them, got {factors}")
    if method not in STATIC_METHODS:
        raise CaseError(f"method {method!r} does not exist; known: {list(STATIC_METHODS)}")
    if not exact:
        return
    if system.n_components == 6:
        raise CaseError("exact needs links without beams, because beams rotate by small angles")
    if np.isinf(system.stiffness).any():
        raise CaseError("exact needs extensible links; give a finite rigidity")
    if method != "auto":
        raise CaseError(f"exact has one method, 'auto', got {method!r}")
    if stability:
        raise CaseError("stability needs small displacements; leave out exact")


def _search(
    system: LinkSystem,
    model: LinkEquations,
    tangent: Tangent,
    method: str,
    exact: bool,
    limits: Limits,
) -> FindState:
    """Return the search for equilibria; with small displacements a mechanism has none."""
    if exact:
        return lambda start, reached, factor: find_finite_state(
            system, model, tangent, (reached, factor), start, limits
        )
    taut: Solve | None = None
    if method != "dual":
        try:
            taut = factorise_taut(model, tangent)
        except MultiscaleError:
            nothing = Solution(np.zeros(model.n), Status.STALLED, detail=EXACT_HINT)
            return lambda start, reached, factor: state_of(model, nothing, 0.0 * model.prestress)

    def find(start: np.ndarray, reached: float, factor: float) -> LinkState:
        nonlocal taut
        fresh, taut = taut, None  # the factors last until the next factorisation
        return find_state(model, tangent, factor, start, method, limits, fresh)

    return find


def _reason(model: LinkEquations, tangent: Tangent, state: LinkState, method: str) -> str:
    """Return a sentence on the failure of a step, with the nodes that can move freely."""
    solution = state.solution
    if solution.status is Status.INFEASIBLE and method != "lcp":
        reason = f"{name_motion(model, solution.value)}, and the load pushes there"
    elif solution.status is Status.STALLED:
        reason = name_mechanism(model, tangent, solution.value) or solution.status.value
    else:
        reason = solution.status.value
    return reason + (f"; {solution.detail}" if solution.detail else "")
