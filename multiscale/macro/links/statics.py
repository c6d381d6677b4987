"""Static equilibrium of a structure of links along the load, with small or exact elongations."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from multiscale.convergence import Solution, Status, check_limits
from multiscale.errors import CaseError, MultiscaleError
from multiscale.macro.links.interior_point import solve_interior_point
from multiscale.macro.links.link_equations import (
    LinkEquations,
    LinkState,
    equations,
    force_scale,
    state_of,
)
from multiscale.macro.links.link_newton import RESIDUAL_STIFFNESS, solve_newton
from multiscale.macro.links.link_system import LinkSystem, check_supports, link_dataset, nodal_pull
from multiscale.macro.links.mechanisms import (
    factorise_taut,
    name_mechanism,
    name_motion,
    stability_eigenvalues,
)
from multiscale.nonsmooth import solve_lcp
from multiscale.numerics.factorisation import Solve
from multiscale.numerics.newton import Limits, NewtonRun, join_solutions, march
from multiscale.schema import Dataset

METHODS = ("auto", "newton", "interior_point", "lcp")

MAX_DENSE_LINKS = 5000
"""Largest number of links that may go slack for the dense matrix of method ``"lcp"``."""

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
    r"""Compute tensions and displacements under a load.

    Parameters
    ----------
    system : LinkSystem, the structure with its load :math:`F^d`
    load_factor : float or sequence of float
        :math:`\alpha`, dimensionless. Each step of a sequence starts from the step before.
    method : str
        ``"auto"`` is a proximal semismooth Newton method; if it fails, because too many links are
        slack, an interior-point method follows, and then Newton again. ``"newton"`` and
        ``"interior_point"`` use only these methods; ``"lcp"`` solves the complementarity problem
        (10) of the source.
    exact : bool
        Whether elongations and directions are geometrically exact. Otherwise displacements are
        small, as in the source.
    stability : bool
        Whether to compute the smallest eigenvalue of the tangent, without and with the geometric
        stiffness of the tensions.
    max_iterations : int, iteration limit of a method
    tolerance : float
        Bound on the largest residual force relative to the largest nodal load (without load: to
        the largest prestress); dimensionless. The bound is raised to the rounding error;
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
    Tensions are unique. Slack and displacements are not unique if the slack links make a mechanism
    that the load does not move: the result is then an arbitrary solution.

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
    _check_options(system, factors, method, exact, stability)
    check_supports(system)
    model = equations(system)
    limits = Limits(max_iterations, tolerance, callback)
    taut, mechanism = None, False  # factors of the structure without slack
    if not exact:
        try:
            taut = factorise_taut(model)
        except MultiscaleError:
            mechanism = True
    start, reached = np.zeros(model.n), 0.0
    columns, failures = list[dict[str, Any]](), list[str]()

    for factor in factors:
        clock = perf_counter()
        if exact:
            span = (reached, factor)
            state = find_finite_state(system, model, span, start, limits)
        elif mechanism:  # without equilibrium at small displacements
            nothing = Solution(np.zeros(model.n), Status.STALLED, detail=EXACT_HINT)
            state = state_of(model, nothing, 0.0 * model.prestress)
        else:
            state = _find_state(model, factor, start, method, limits, taut)
            taut = None  # the factors last until the next factorisation
        column = step_values(system, model, state)
        if not state.solution.converged:
            failures.append(f"load factor {factor:g}: {_reason(model, state, method)}")
        else:
            start, reached = state.solution.value, factor
            if stability:
                names = ("tangent_eigenvalue", "stability_eigenvalue")
                column |= zip(names, stability_eigenvalues(system, model, state), strict=True)
        columns.append(column | {"wall_time": perf_counter() - clock})
    result = join_steps(system, factors, columns)
    if failures:
        result = result.assign_attrs(failure="\n".join(failures))
    return result if np.ndim(load_factor) else result.isel(step=0)


def _check_options(
    system: LinkSystem, factors: np.ndarray, method: str, exact: bool, stability: bool
) -> None:
    if factors.ndim != 1 or not factors.size or not np.isfinite(factors).all():
        raise CaseError(f"load_factor must be a finite number or a list of them, got {factors}")
    if method not in METHODS:
        raise CaseError(f"method {method!r} does not exist; known: {list(METHODS)}")
    rigid = bool(np.isinf(system.stiffness).any())
    if rigid and method in ("newton", "lcp"):
        raise CaseError(
            f"method {method!r} needs extensible links; use method='auto' for links of fixed length"
        )
    one_sided = np.isfinite(system.bounds).any(axis=0)
    if method == "lcp" and np.count_nonzero(one_sided) > MAX_DENSE_LINKS:
        raise CaseError(
            f"method 'lcp' forms a dense matrix of the {np.count_nonzero(one_sided)} links that "
            f"may go slack, at most {MAX_DENSE_LINKS}; use method='auto'"
        )
    if not exact:
        return
    if system.n_components == 6:
        raise CaseError("exact needs links without beams, because beams rotate by small angles")
    if rigid:
        raise CaseError("exact needs extensible links; give a finite rigidity")
    if method != "auto":
        raise CaseError(f"exact needs the method 'auto', got {method!r}")
    if stability:
        raise CaseError("stability needs small displacements; leave out exact")


def _find_state(
    model: LinkEquations,
    load_factor: float,
    start: np.ndarray,
    method: str,
    limits: Limits,
    taut: Solve | None,
) -> LinkState:
    """Solve for equilibrium with small displacements, by a method or several in turn."""
    if method == "lcp":
        return _solve_complementarity(model, load_factor, limits.tolerance)
    if np.isinf(model.stiffness).any():
        return solve_interior_point(model, load_factor, limits)
    runs: list[tuple[str, Solution]] = []
    if method != "interior_point":
        state = solve_newton(model, load_factor, start, limits, taut)
        runs.append(("newton", state.solution))
    if method == "interior_point" or (method == "auto" and not state.solution.converged):
        state = solve_interior_point(model, load_factor, limits)
        inner = state.solution
        runs.append(("interior_point", inner))
        if inner.status is not Status.INFEASIBLE and inner.residuals:
            state = solve_newton(model, load_factor, inner.value, limits)
            runs.append(("newton", state.solution))
    whole = join_solutions([solution for _, solution in runs], [name for name, _ in runs])
    return replace(state, solution=whole)


def _solve_complementarity(model: LinkEquations, load_factor: float, tolerance: float) -> LinkState:
    """Condense the structure onto the links that may go slack, and solve for their slack."""
    # with the stiffness K without slack, and the opposite sign for struts, (10) of the source:
    #     A_c slack_c - tau_c = -k_c B_c K^-1 F^d - tau_c^0,  0 <= slack_c perp tau_c >= 0,
    #     A_c = k_c - k_c B_c K^-1 B_c^T k_c
    one_sided = np.flatnonzero(np.isfinite(model.lower) | np.isfinite(model.upper))
    k = model.stiffness[one_sided]
    sign = np.where(np.isfinite(model.lower[one_sided]), 1.0, -1.0)
    pull = (model.operator[one_sided].T * (sign * k)).toarray()  # B_c^T k_c
    solve = model.factorise(model.stiffness)
    motion = solve(pull)
    matrix = np.diag(k) - pull.T @ motion
    free = solve(load_factor * model.load - model.gather(model.prestress))
    taut = sign * model.prestress[one_sided] + pull.T @ free
    answer = solve_lcp(0.5 * (matrix + matrix.T), taut, tolerance=tolerance)
    return state_of(model, replace(answer, value=free - motion @ answer.value))


def _reason(model: LinkEquations, state: LinkState, method: str) -> str:
    """Return a sentence on the failure of a step, with the nodes that can move freely."""
    solution = state.solution
    if solution.status is Status.INFEASIBLE and method != "lcp":
        reason = f"{name_motion(model, solution.value)}, and the load acts on this motion"
    elif solution.status is Status.STALLED:
        reason = name_mechanism(model, solution.value) or solution.status.value
    else:
        reason = solution.status.value
    return reason + (f"; {solution.detail}" if solution.detail else "")


def step_values(system: LinkSystem, model: LinkEquations, state: LinkState) -> dict[str, Any]:
    """Return the variables of a step, NaN unless it converged."""
    solution, links = state.solution, system.n_links
    valid = 1.0 if solution.converged else np.nan
    motion = valid * model.at_nodes(solution.value)
    column: dict[str, Any] = {
        "converged": int(solution.converged),
        "residual": solution.residuals[-1] if solution.residuals else np.nan,
        "iterations": len(solution.residuals),
        "tension": valid * state.tension[:links],
        "slack": valid * state.slack[:links],
        "displacement": motion[:, :3],
    }
    if system.n_components == 6:
        column["rotation"] = motion[:, 3:]
        twist, even_y, odd_y, even_z, odd_z = state.tension[links:].reshape(-1, 5).T
        moment = np.full((links, 5), np.nan)
        moment[model.link[links::5]] = np.stack(
            [twist, odd_y + even_y, odd_y - even_y, odd_z + even_z, odd_z - even_z], axis=1
        )
        column["moment"] = valid * moment
    return column


def join_steps(system: LinkSystem, factors: np.ndarray, columns: list[dict[str, Any]]) -> Dataset:
    """Join the variables of each step, at its load factor."""
    names = [name for column in columns for name in column]
    values = {
        name: np.array([column.get(name, np.nan) for column in columns])
        for name in dict.fromkeys(names)
    }
    part = {"part": ["torsion", "y1", "y2", "z1", "z2"]} if system.n_components == 6 else {}
    values |= {"load_factor": factors}
    return link_dataset(system, values, step=range(factors.size), end=range(2), **part)


MAX_STEP_HALVINGS = 8  # largest number of halvings of a load step

LATERAL_STIFFNESS = (0.0, *10.0 ** np.arange(-8.0, 1.0))
"""Least stiffness of a link across its axis in the tangent, relative to its elastic stiffness. The
next value follows where a step must be halved more than :data:`FEW_HALVINGS` times."""

FEW_HALVINGS, MAX_HALVINGS = 2, 40
"""Halvings of a Newton step, at most, and with the largest lateral stiffness."""


def find_finite_state(
    system: LinkSystem,
    model: LinkEquations,
    load_factors: tuple[float, float],
    start: np.ndarray,
    limits: Limits,
) -> LinkState:
    """Follow the equilibrium between two load factors in the displaced positions, (1)."""
    problem = FiniteLinks(system, model)

    def attempt(u: np.ndarray, load_factor: float) -> tuple[Solution, np.ndarray]:
        solution = _newton(problem, load_factor, u, limits)
        return solution, solution.value

    steps = march(attempt, start, load_factors, MAX_STEP_HALVINGS)
    solution = join_solutions([step.solution for step in steps])
    shape = problem.shape(solution.value)
    slack = np.abs(shape.tension - shape.elastic) / model.stiffness
    return LinkState(solution, shape.tension, slack)


class DeformedLinks(NamedTuple):
    """Links at displaced nodes."""

    length: np.ndarray  # (links,), m
    direction: np.ndarray  # unit vector, (links, 3)
    elastic: np.ndarray  # elastic tension, (links,), N
    tension: np.ndarray  # projected tension, (links,), N


@dataclass(frozen=True, eq=False)
class FiniteLinks:
    r"""Residual, energy and tangent of the links in their displaced positions.

    .. math:: \sum n\, \tau = \alpha F^d, \qquad \tau = P(\tau^0 + k (|x_2 - x_1| - L)).    \tag{1}
    """

    system: LinkSystem
    model: LinkEquations

    def shape(self, u: np.ndarray) -> DeformedLinks:
        """Return the links at a displacement."""
        system, model = self.system, self.model
        moved = model.at_nodes(u)[:, :3]
        relative = moved[system.ends[:, 1]] - moved[system.ends[:, 0]]
        span = system.span + relative
        length = np.sqrt(np.einsum("li,li->l", span, span))
        # |x|^2 - L^2 without the difference of two nearly equal numbers
        elongation = np.einsum("li,li->l", 2.0 * system.span + relative, relative)
        elongation /= length + system.length
        elastic = model.prestress + model.stiffness * elongation
        tension = np.clip(elastic, model.lower, model.upper)
        return DeformedLinks(length, span / length[:, None], elastic, tension)

    def residual(self, shape: DeformedLinks, load_factor: float) -> np.ndarray:
        """Return the residual force, shape (n,), N."""
        force = nodal_pull(self.system, shape.tension[:, None] * shape.direction)
        return np.asarray(load_factor * self.model.load - force[self.model.number >= 0])

    def energy(self, shape: DeformedLinks, u: np.ndarray, load_factor: float) -> float:
        """Return the potential energy up to a constant, J."""
        model = self.model
        stored = shape.tension * (shape.elastic - 0.5 * shape.tension) / model.stiffness
        return float(stored.sum() - load_factor * model.load @ u)

    def direction(
        self, shape: DeformedLinks, residual: np.ndarray, lateral: float
    ) -> np.ndarray | None:
        """Return the Newton direction with a lateral stiffness; None if it does not descend."""
        carries = shape.tension == shape.elastic
        along = self.model.stiffness * np.where(carries, 1.0, RESIDUAL_STIFFNESS)
        across = shape.tension / shape.length
        if lateral:
            across = np.maximum(across, lateral * self.model.stiffness)
        try:
            entries = self.model.tangent.geometric(shape.direction, along, across)
            direction = self.model.tangent.factorise(entries)(residual)
        except MultiscaleError:
            return None
        return direction if direction @ residual > 0.0 else None


@np.errstate(all="ignore")  # overflow makes the residual infinite, which stops the loop
def _newton(
    problem: FiniteLinks, load_factor: float, start: np.ndarray, limits: Limits
) -> Solution:
    model, u = problem.model, start
    scale = force_scale(model, load_factor * model.load)
    shape = problem.shape(u)
    residual = problem.residual(shape, load_factor)
    run = NewtonRun(limits)
    while True:
        stiffest = float(model.stiffness.max()) * float(np.abs(u).max(initial=0.0))
        rounding = 8.0 * np.finfo(float).eps * (float(np.abs(shape.tension).max()) + stiffest)
        if not run.goes_on(float(np.abs(residual).max(initial=0.0)) / scale, rounding / scale):
            break
        step = _step(problem, load_factor, u, shape, residual)
        if step is None:
            run.stop(Status.STALLED)
            break
        u, shape, residual = step
    return run.solution(u)


def _step(
    problem: FiniteLinks,
    load_factor: float,
    u: np.ndarray,
    shape: DeformedLinks,
    residual: np.ndarray,
) -> tuple[np.ndarray, DeformedLinks, np.ndarray] | None:
    """Return a Newton step that lowers energy or residual; None if all trials fail."""
    energy, before = problem.energy(shape, u, load_factor), float(np.abs(residual).max())
    # links without tension, or nearly in line with their ends, resist a lateral load only after a
    # large displacement; the largest lateral stiffness makes the tangent an upper bound, and every
    # step lowers the energy
    for lateral in LATERAL_STIFFNESS:
        direction = problem.direction(shape, residual, lateral)
        if direction is None:
            continue
        slope = float(residual @ direction)
        halvings = MAX_HALVINGS if lateral == LATERAL_STIFFNESS[-1] else FEW_HALVINGS
        for halving in range(halvings + 1):
            step = 0.5**halving
            trial = u + step * direction
            after = problem.shape(trial)
            left = problem.residual(after, load_factor)
            falls = problem.energy(after, trial, load_factor) <= energy - 1e-4 * step * slope
            if falls or float(np.abs(left).max()) < 0.9 * before:
                return trial, after, left
    return None
