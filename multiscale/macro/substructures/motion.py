"""Moreau-Jean steps of a structure that has been cut."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.errors import CaseError
from multiscale.macro.substructures.latin_solver import LatinMethod, LatinSolver
from multiscale.macro.substructures.parallel import ProcessGroup
from multiscale.macro.substructures.problem import CutProblem
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = ["simulate_latin"]


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
    r"""Follow a cut structure in time, by implicit steps of :func:`multiscale.macro.simulate`.

    Parameters
    ----------
    problem : CutProblem, the structure, cut; one load case
    times : ndarray, shape (steps + 1,)
        Rising by equal steps h, s. The first is the initial state.
    mass : float or ndarray, shape (nodes,), mass of each node, kg
    load_factor : callable, :math:`\alpha(t)`
    start : tuple of ndarray, shape (nodes, 3), optional
        Displacement, m, and velocity, m/s, at the first time; at rest if not given.
    tolerance, max_iterations, team
        As :func:`solve_latin`, of each step.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, one step for each time. A step that fails is NaN with
        ``converged`` 0, the attribute ``failure`` has the reason, and the later ones are not tried.

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
    method = LatinMethod(tolerance=tolerance, max_iterations=max_iterations, team=team)
    times = np.asarray(times, dtype=float)
    h = _step(times)
    inertia = _masses(problem, mass) / h**2
    shares = problem.shares
    shared = csr_array(diags_array(1.0 / shares) @ inertia)
    parts = tuple(
        replace(part, stiffness=csr_array(part.stiffness + shared[part.unknown][:, part.unknown]))
        for part in problem.substructures
    )
    solver = LatinSolver(replace(problem, substructures=parts), method, judged=False)
    latin = solver.iteration
    local = np.concatenate([problem.substructures[part].unknown for part in latin.parts])
    force = problem.sum_up([part.load[:, 0] for part in problem.substructures])
    u, v = _initial(problem, start)
    links = latin.stack.links
    e = links.operator @ u[local]
    tension = latin.admissible(links.prestress + links.stiffness * e)
    at_rest = {"converged": 1, "residual": 0.0, "wall_time": 0.0} | problem.link_fields(
        latin.team.concatenate(tension), latin.team.concatenate(latin.slack())
    )
    rows = [_row(problem, times[0], u, v, at_rest)]

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
            f"times must rise by equal steps, because the substructures are factorised for one; "
            f"got steps from {steps.min():g} to {steps.max():g} s"
        )
    return h


def _masses(problem: CutProblem, mass: float | np.ndarray) -> csr_array:
    """Mass of the unknowns, kg; what moves with a rigid plate is coupled by it."""
    nodes = len(problem.position)
    if np.ndim(mass) and np.shape(mass) != (nodes,):
        raise CaseError(f"mass must be one number or one per node ({nodes},), got {np.shape(mass)}")
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
    """Displacement and velocity of the unknowns at the first time."""
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
    """One row of the dataset."""
    names = ("converged", "residual", "wall_time", "tension", "slack")
    moved = {"displacement": problem.displacement(u), "velocity": problem.displacement(v)}
    return {"time": time, **moved, **{name: report[name] for name in names if name in report}}


def _dataset(problem: CutProblem, rows: list[dict[str, Any]]) -> Dataset:
    """Join the rows."""
    values: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    result = MACRO_RESULT.build(values | {"position": problem.position})
    return result.assign_coords(component=["x", "y", "z"])
