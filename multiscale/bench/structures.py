"""Tensegrity grids of growing size: time, memory and accuracy of their statics."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from multiscale.bench.measure import BenchFamily, Row, Runner
from multiscale.macro import LinkSystem, solve_static, tensegrity_grid
from multiscale.macro.links.link_equations import compatibility

MODULES, QUICK_MODULES = (8, 16, 32, 64, 128, 256), (8, 16)  # modules along an edge of the grid
REPEATED = 64  # modules along an edge above which each method runs once
TOLERANCE = 1e-8  # verified residual up to which an answer counts as converged


class GridMethod(NamedTuple):
    """A method of `solve_static`."""

    method: str
    largest: int  # modules along an edge of the largest grid
    pardiso: bool = False


GRID_METHODS: Mapping[str, GridMethod] = {
    "Newton, PARDISO": GridMethod("newton", 256, pardiso=True),
    "Newton, SuperLU": GridMethod("newton", 64),
    "interior point": GridMethod("interior_point", 32),
}


class GridAnswer(NamedTuple):
    """The statics of a grid, by a method."""

    tension: np.ndarray  # (links,), N
    displacement: np.ndarray  # (nodes, 3), m
    slack: int  # number of slack cables
    iterations: float  # of Newton's method; NaN for other methods


def scene_grid(n: int) -> LinkSystem:
    """Build the grid of n x n modules."""
    return tensegrity_grid(n, prestress=2550.0 * (n / 16) ** 2)


def solve_grid(system: LinkSystem, load_factor: float, method: GridMethod) -> GridAnswer:
    """Solve by a method; without ``pardiso`` the process cannot import pypardiso afterwards."""
    if not method.pardiso:
        sys.modules["pypardiso"] = None  # type: ignore[assignment]
    result = solve_static(system, load_factor, method=method.method)
    return GridAnswer(
        result["tension"].values,
        result["displacement"].values,
        int(np.count_nonzero(result["slack"].values > 0.0)),
        int(result["iterations"]) - 1 if method.method == "newton" else np.nan,
    )


def verify(system: LinkSystem, load_factor: float, answer: GridAnswer) -> float:
    r"""Return the distance of an answer from equilibrium and the link laws, by the data only."""
    B, free = compatibility(system), ~system.fixed
    lower, upper = system.bounds
    load, u, tension = load_factor * system.load[free], answer.displacement[free], answer.tension
    balance = np.abs(load - B.T @ tension).max() / np.abs(load).max()  # (7)
    lawful = np.clip(system.prestress + system.stiffness * (B @ u), lower, upper)  # (14), (15)
    misfit = np.abs(tension - lawful).max() / np.abs(tension).max()
    return float(np.maximum(balance, misfit))  # NaN if either is


def distance(system: LinkSystem, tension: np.ndarray, reference: np.ndarray) -> float:
    """Return the distance of tensions, N, over the reference, in the norm sqrt(sum t² / k)."""
    change, size = (np.sum(t**2 / system.stiffness) for t in (tension - reference, reference))
    return float(np.sqrt(change / size))


@partial(
    BenchFamily,
    "statics of tensegrity grids: growth of time and memory",
    packages=("scipy", "pypardiso"),
    attributes={
        "wall_time_counts": f"median, above {REPEATED} x {REPEATED} modules one run; without "
        f"start of the process, imports and compilation",
        "growth": "cables",
    },
)
def structures(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Solve grids of all sizes at two load factors by every method."""
    methods = dict(GRID_METHODS)
    if find_spec("pypardiso") is None:
        reason = "because pypardiso is not installed; pip install 'multiscale-contact[pardiso]'"
        run.leave_out("Newton, PARDISO", reason)
        del methods["Newton, PARDISO"]
    for load_factor in (1.0, 4.0):
        for n in QUICK_MODULES if quick else MODULES:
            grid = scene_grid(n)
            rows = [
                run(
                    f"grid, α = {load_factor:g}",
                    name,
                    *(solve_grid, grid, load_factor, method),
                    warm=(scene_grid(4), load_factor, method),
                    repeats=1 if quick or n > REPEATED else 3,
                    cables=int(np.count_nonzero(np.isfinite(grid.bounds[0]))),
                    unknowns=int(np.count_nonzero(~grid.fixed)),
                )
                for name, method in methods.items()
                if n <= method.largest
            ]
            yield judged(rows, grid, load_factor)


def judged(rows: Sequence[Row], grid: LinkSystem, load_factor: float) -> Sequence[Row]:
    """Verify the answers to a grid, and compare each with Newton's method."""
    for row in rows:
        if (answer := row["value"]) is None:
            continue
        row |= {"iterations": answer.iterations, "residual": verify(grid, load_factor, answer)}
        if row["residual"] <= TOLERANCE:
            row |= {"converged": 1, "slack_fraction": answer.slack / row["cables"]}
    newton = [row for row in rows if row["converged"] and row["method"].startswith("Newton")]
    for row in rows:
        if row["value"] is not None and (others := [other for other in newton if other is not row]):
            row["error"] = distance(grid, row["value"].tension, others[0]["value"].tension)
    return rows
