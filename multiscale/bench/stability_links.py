"""Stiff and extreme structures of links, each with a residual verified in the answer only."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from collections.abc import Callable

    from multiscale.macro import LinkSystem
    from multiscale.macro.substructures import Method
    from multiscale.macro.substructures.problem import CutProblem

MODULES = 8  # number of modules along an edge of the grids
REFERENCE_PRESTRESS, CABLE_RIGIDITY = 600.0, 4e6
"""Prestress and axial rigidity of the cables of the grids, N."""
SHORT = 4.0 * np.finfo(float).eps / 1e-9
"""Stretch over the largest displacement, with a rounding of 1e-9 by the displacements, which is the
tolerance of ``motion``: where links are that stiff, stretches are judged instead of forces."""


def _grid(bar_over_cable: float, prestress: float) -> "LinkSystem":
    from multiscale.laws.link import Bar
    from multiscale.macro import tensegrity_grid

    return tensegrity_grid(
        MODULES, bar=Bar(CABLE_RIGIDITY * bar_over_cable), prestress=REFERENCE_PRESTRESS * prestress
    )


def structure(bar_over_cable: float, prestress: float, load_factor: float) -> float:
    """Solve a tensegrity grid at rest: distance from equilibrium and from the laws of its links."""
    from multiscale.bench.structures import GridMethod, solve_grid, verify

    grid, method = _grid(bar_over_cable, prestress), GridMethod("auto", MODULES, pardiso=True)
    return verify(grid, load_factor, solve_grid(grid, load_factor, method))


def equivalent_plate(bar_over_cable: float, prestress: float, load_factor: float) -> float:
    """Solve the plate equivalent to a grid: distance of its motion by one load step and by two."""
    from multiscale.laws.link import Bar
    from multiscale.macro import tensegrity_grid
    from multiscale.macro.links import EquivalentPlate, plate_cell, solve_plate

    bar, tension = Bar(CABLE_RIGIDITY * bar_over_cable), REFERENCE_PRESTRESS * prestress
    cell = plate_cell(tensegrity_grid(1, bar=bar, prestress=tension), (1.0, 1.0))
    plate = EquivalentPlate(_grid(bar_over_cable, prestress), cell, (MODULES // 2,) * 2)
    ends = []
    for path in ([load_factor], [0.5 * load_factor, load_factor]):
        result = solve_plate(plate, path)
        refuse_failure(result)
        ends.append(result["displacement"].to_numpy()[-1])
    direct, stepped = ends
    return float(np.linalg.norm(direct - stepped) / np.linalg.norm(stepped))


def _dome(rise: float, bars: int) -> "tuple[LinkSystem, Callable[[float], float]]":
    """Return a dome of bars under its critical load, and the force at a height."""
    from multiscale.laws.link import Bar
    from multiscale.macro import LinkSystem

    angle = 2.0 * np.pi * np.arange(bars) / bars
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(bars)])
    start = np.hypot(1.0, rise)

    def bears(height: float) -> float:
        length = np.hypot(1.0, height)
        return float(bars / start * (start - length) * height / length)

    fixed, load = np.ones((bars + 1, 3), dtype=bool), np.zeros((bars + 1, 3))
    # critical where the bars are (L0 / b)^(1/3) long
    fixed[-1, 2], load[-1, 2] = False, -bears(np.sqrt(start ** (2.0 / 3.0) - 1.0))
    ends = np.column_stack([np.arange(bars), np.full(bars, bars)])
    nodes = np.vstack([ring, [0.0, 0.0, rise]])
    return LinkSystem(nodes, ends, (Bar(1.0),), np.zeros(bars, int), fixed, load), bears


def limit_load(rise: float, bars: int) -> float:
    """Press the apex of a dome past its limit: error of the critical load."""
    from multiscale.macro import solve_past_limit

    path = solve_past_limit(_dome(rise, bars)[0], 1.2)
    refuse_failure(path)
    return abs(float(path["critical_factor"]) - 1.0)


def near_limit(share: float, rise: float) -> float:
    """Press the apex of a dome by a share of its critical load: error of the force."""
    from multiscale.macro import solve_static

    dome, bears = _dome(rise, 6)
    rest = solve_static(dome, [share], exact=True)
    refuse_failure(rest)
    borne = bears(rise + float(rest["displacement"][-1, -1, 2]))
    return float(abs(borne / (-share * dome.load[-1, 2]) - 1.0))


def loose_links(scene: str, load: float, solver: str) -> float:
    """Load mechanisms and slack links: distance from the balance of forces, or of momentum."""
    from multiscale.laws.link import Bar, Cable
    from multiscale.macro import LinkSystem, simulate, solve_static

    law, corners = (Cable if scene == "slack cables" else Bar)(1e6), np.eye(4, 3)
    position = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    fixed, force = np.zeros((4, 3), dtype=bool), 0.0 * corners
    if scene == "flat square":  # a corner is pushed across the plane of its bars
        fixed[:3], force[3, 2] = True, -load
    else:  # along the motion of a square with hinges, or towards the supports of cables
        fixed[:2], fixed[2:, 2] = True, True
        force[2:, 0 if scene == "hinged square" else 1] = -load
    ends = np.array(
        [[1, 2], [2, 3], [3, 0], [0, 2], [1, 3]][: 3 if scene == "hinged square" else 5]
    )
    links = LinkSystem(position, ends, (law,), np.zeros(len(ends), int), fixed, force)
    if solver == "motion":
        h, mass = 1e-3, 2.0
        result = simulate(links, h * np.arange(21), mass)
        refuse_failure(result)
        v, tension = result["velocity"].to_numpy(), result["tension"].to_numpy()
        pull = np.zeros((len(tension), 4, 3))
        for (i, j), t, e in zip(ends, tension.T, links.direction, strict=True):
            pull[:, i] += t[:, None] * e
            pull[:, j] -= t[:, None] * e
        change = mass * np.diff(v, axis=0) / h - force - pull[1:]
        return float(np.abs(change[:, ~fixed]).max() / (load + np.abs(pull).max()))
    result = solve_static(links, [1.0], exact=solver == "exact")
    refuse_failure(result)
    place = position + result["displacement"].to_numpy()[-1] * (solver == "exact")
    balance = force.copy()
    for (i, j), t in zip(ends, result["tension"].to_numpy()[-1], strict=True):
        way = place[j] - place[i]
        balance[i] += t * way / np.linalg.norm(way)
        balance[j] -= t * way / np.linalg.norm(way)
    return float(np.abs(balance[~fixed]).max() / load)


def motion(bar_over_cable: float, prestress: float, step: float) -> float:
    """Release a grid from its load: worst of momentum, motion, link laws and energy."""
    from multiscale.macro import simulate, solve_static
    from multiscale.macro.links.link_equations import compatibility

    grid, mass = _grid(bar_over_cable, prestress), 2.0
    loaded = solve_static(grid, 1.0)["displacement"].values
    result = simulate(
        grid,
        step * np.arange(21),
        mass,
        load_factor=lambda t: 0.0,
        start=(loaded, np.zeros_like(loaded)),
    )
    refuse_failure(result)
    B, free = compatibility(grid), ~grid.fixed
    u, v = (result[name].values[:, free] for name in ("displacement", "velocity"))
    tension = result["tension"].values
    force = (B.T @ tension.T).T
    momentum = mass * np.diff(v, axis=0) / step + force[1:]  # (7) with inertia
    lawful = np.clip(grid.prestress + grid.stiffness * (B @ u.T).T, *grid.bounds)  # (14), (15)
    # a stretch is the difference of displacements, with their rounding
    short = SHORT * grid.stiffness * np.abs(u).max()
    moved = np.diff(u, axis=0) - step * v[1:]  # the scheme with theta = 1
    terms = ("kinetic_energy", "elastic_energy", "numerical_dissipation", "link_dissipation")
    balance = sum(result[name].values for name in terms) - result["work"].values
    kinetic = 0.5 * mass * np.sum(v**2, axis=1) - result["kinetic_energy"].values
    energy = np.abs(result["elastic_energy"].values).max()
    return float(
        max(
            np.abs(momentum).max() / (np.abs(force).max() + short.max()),
            np.abs(moved).max() / np.abs(u).max(),
            np.max(np.abs(tension - lawful) / (np.abs(tension).max() + short)),
            np.abs(kinetic).max() / energy,
            np.ptp(balance) / energy,
        )
    )


def cut_structure(bar_over_cable: float, load_factor: float, parts: int, method: str) -> float:
    """Solve a cut grid: distance of its tensions from the uncut grid."""
    solver = method_of(method, parts)
    return _distance_of_cut(
        bar_over_cable, load_factor, parts, lambda problem: solver.solve(problem, load_factor)
    )


def homogenised(bar_over_cable: float, load_factor: float, parts: int) -> float:
    """Solve a grid by homogenised substructures, resolved with slack: distance of its tensions."""
    from multiscale.macro import NewtonSchur
    from multiscale.macro.substructures import solve_homogenised

    newton = NewtonSchur(tolerance=1e-8)

    def solve(problem: "CutProblem") -> Dataset:
        return solve_homogenised(problem, lambda problem: newton.solve(problem, load_factor))

    return _distance_of_cut(bar_over_cable, load_factor, parts, solve)


def _distance_of_cut(
    bar_over_cable: float,
    load_factor: float,
    parts: int,
    solve: "Callable[[CutProblem], Dataset]",
) -> float:
    """Return the distance of the tensions of a cut grid from the uncut grid."""
    from multiscale.bench.structures import distance
    from multiscale.macro import cut_links, solve_static
    from multiscale.macro.substructures import split_grid

    grid = _grid(bar_over_cable, 1.0)
    cut = solve(cut_links(grid, split_grid(grid, (parts, parts))))
    refuse_failure(cut)
    whole = solve_static(grid, load_factor)["tension"].values
    return distance(grid, cut["tension"].values.reshape(-1), whole.reshape(-1))


def method_of(name: str, parts: int) -> "Method":
    """Build a solver of assemblies by name, with ``parts`` substructures along a body's edge."""
    from multiscale.macro import AssembledNewton, LatinMethod, NewtonSchur

    cut = (parts, parts)
    methods: dict[str, Method] = {
        "whole": AssembledNewton(),
        "LATIN": LatinMethod(cut),
        "Schur": NewtonSchur(cut),
    }
    return methods[name]


def refuse_failure(result: Dataset) -> None:
    """Raise the failure of a result if its path ended early."""
    if not result["converged"].values.all():
        raise ConvergenceError(result.attrs.get("failure") or "a step did not converge")
