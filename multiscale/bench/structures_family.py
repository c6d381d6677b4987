r"""Tensegrity grids of growing size: time, memory and accuracy of their statics.

The prestress grows with the square of the size, as the moment of the load does, so that the share
of slack cables stays about the same.
"""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec

import numpy as np

from multiscale.bench.trials import BenchFamily, Columns, Runs, Trial
from multiscale.macro import LinkSystem, solve_static, tensegrity_grid
from multiscale.macro.links.link_equations import compatibility

__all__ = [
    "GRID_METHODS",
    "GridAnswer",
    "GridMethod",
    "distance",
    "plan_structures",
    "scene_grid",
    "solve_grid",
    "verify",
]

LOAD_FACTORS = (1.0, 4.0)
MODULES = (8, 16, 32, 64, 128, 256)
"""Along an edge of the grid."""
QUICK_MODULES = (8, 16, 32)
SMALL = 4
"""Modules along an edge of the grid that warms up."""

REPEATS, REPEATED = 3, 64
"""Runs of each method, and modules along an edge above which there is only one."""

TOLERANCE = 1e-8
"""Verified residual up to which an answer counts as converged."""


@dataclass(frozen=True)
class GridMethod:
    """How a grid is solved.

    Attributes
    ----------
    method : str, method of :func:`multiscale.macro.solve_static`
    largest : int, modules along an edge of the largest grid that it gets
    pardiso : bool, whether PARDISO may factorise
    """

    method: str
    largest: int
    pardiso: bool = False


GRID_METHODS: Mapping[str, GridMethod] = {
    "Newton, PARDISO": GridMethod("newton", 256, pardiso=True),
    "Newton, SuperLU": GridMethod("newton", 64),
    "interior point": GridMethod("interior_point", 32),
}


@dataclass(frozen=True, eq=False)
class GridAnswer:
    """Answer of a method; NaN if it did not converge.

    Attributes
    ----------
    tension, displacement : ndarray, shape (links,), N, and (nodes, 3), m
    slack : int, number of slack cables
    iterations : float, steps of Newton's method; NaN for other methods, which do not count them
    """

    tension: np.ndarray
    displacement: np.ndarray
    slack: int
    iterations: float


def scene_grid(n: int) -> LinkSystem:
    """Make the grid of n x n modules."""
    return tensegrity_grid(n, prestress=2550.0 * (n / 16) ** 2)


def solve_grid(system: LinkSystem, load_factor: float, method: GridMethod) -> GridAnswer:
    """Solve by one method.

    Without ``pardiso`` the process cannot import pypardiso any more, so that it should be used for
    nothing else.
    """
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
    r"""Measure from the data alone how far an answer is from equilibrium and from the link laws."""
    B, free = compatibility(system), ~system.fixed
    lower, upper = system.bounds
    load, u, tension = load_factor * system.load[free], answer.displacement[free], answer.tension
    balance = np.abs(load - B.T @ tension).max() / np.abs(load).max()  # (7)
    lawful = np.clip(system.prestress + system.stiffness * (B @ u), lower, upper)  # (14), (15)
    misfit = np.abs(tension - lawful).max() / np.abs(tension).max()
    return float(np.maximum(balance, misfit))  # lets a NaN through


def distance(system: LinkSystem, tension: np.ndarray, reference: np.ndarray) -> float:
    r"""Distance of tensions (links,), N, from others in the norm of their energy, relative.

    :math:`\sqrt{\sum (\tau - \hat\tau)^2 / k}` over :math:`\sqrt{\sum \hat\tau^2 / k}` of the
    reference.
    """
    change, size = (np.sum(t**2 / system.stiffness) for t in (tension - reference, reference))
    return float(np.sqrt(change / size))


def plan_structures(*, quick: bool) -> BenchFamily:
    r"""Plan to solve grids of all sizes at two load factors by every method.

    If quick, the three smallest grids, and one run of each method.

    Notes
    -----
    *Residuals* are found by :func:`verify` in the answer, and alone decide on ``converged``.

    *Errors* are distances, by :func:`distance`, of the tensions, which are unique, from the
    tensions by Newton's method. For the interior-point method, which shares only the operators, the
    distance is a check of both. For Newton's method it is the distance
    between both factorisations, which is the effect of rounding. It is NaN where the other
    factorisation is missing, as on the largest grids; there the residual stands alone.

    *Times* hold for :func:`multiscale.macro.solve_static` in a process of its own, with the checks
    of the structure and all preparations, after the solution of a small grid that takes the imports
    and the compilation. *Memory* counts the whole process.
    """
    no_pardiso = ""
    if find_spec("pypardiso") is None:
        no_pardiso = "because pypardiso is not installed; pip install 'multiscale-contact[pardiso]'"
    grids = {n: scene_grid(n) for n in (QUICK_MODULES if quick else MODULES)}
    trials = {
        Trial(
            f"grid, α = {load_factor:g}",
            name,
            partial(solve_grid, grid, load_factor, method),
            partial(solve_grid, scene_grid(SMALL), load_factor, method),
            {
                "cables": int(np.count_nonzero(np.isfinite(grid.bounds[0]))),
                "unknowns": int(np.count_nonzero(~grid.fixed)),
            },
            1 if quick or n > REPEATED else REPEATS,
            left_out=no_pardiso if method.pardiso else "",
        ): (grid, load_factor)
        for load_factor in LOAD_FACTORS
        for n, grid in grids.items()
        for name, method in GRID_METHODS.items()
        if n <= method.largest
    }
    return BenchFamily(
        trials,
        partial(_judge, trials),
        title="statics of tensegrity grids: growth of time and memory",
        packages=("scipy", "pypardiso"),
        attributes={
            "wall_time_counts": f"median, above {REPEATED} x {REPEATED} modules one run; without "
            f"start of the process, imports and compilation"
        },
    )


def _judge(
    solved: Mapping[Trial, tuple[LinkSystem, float]], scene: str, runs: Runs
) -> Iterator[tuple[Trial, Columns]]:
    """Verify the answers, and compare answers to one grid."""
    answers = {trial: run.value for trial, run in runs.items() if run.value is not None}
    residuals = {trial: verify(*solved[trial], answer) for trial, answer in answers.items()}
    good = [trial for trial, residual in residuals.items() if residual <= TOLERANCE]
    newton = [trial for trial in good if GRID_METHODS[trial.method].method == "newton"]
    for trial, answer in answers.items():
        system = solved[trial][0]
        others = [one for one in newton if one is not trial and solved[one][0] is system]
        columns: Columns = {
            "iterations": answer.iterations,
            "residual": residuals[trial],
            "converged": int(trial in good),
        }
        if others:
            columns["error"] = distance(system, answer.tension, answers[others[0]].tension)
        if trial in good:
            columns["slack_fraction"] = answer.slack / trial.settings["cables"]
        yield trial, columns
