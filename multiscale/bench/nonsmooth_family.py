"""Complementarity and friction: the residual of every method against its run time."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from multiscale.bench.friction_scenes import (
    RigidBodies,
    block_tower,
    box_stack,
    sphere_pile,
    wedged_block,
)
from multiscale.bench.lcp_scenes import (
    condensed,
    granular,
    loaded_column,
    membrane,
    p_matrix,
    tensegrity,
)
from multiscale.bench.trials import BenchFamily, Columns, Runs, Trial
from multiscale.convergence import Solution
from multiscale.nonsmooth import solve_friction, solve_lcp, verify_friction, verify_lcp
from multiscale.nonsmooth.friction import FRICTION_METHODS
from multiscale.nonsmooth.lcp import LCP_METHODS

__all__ = [
    "FRICTION_SCENES",
    "LCP_SCENES",
    "Problem",
    "friction_problem",
    "lcp_problem",
    "plan_nonsmooth",
]

LCP_TOLERANCE, FRICTION_TOLERANCE = 1e-10, 1e-8
REPEATS = 3

WARM_UP = 2
"""Iterations of every method that take the compilation and are not counted."""

LCP = Callable[[int], tuple[csr_array | np.ndarray, np.ndarray]]
"""Makes a matrix and a vector of a size."""


def _grains(size: int, mass_ratio: float = 1.0) -> tuple[csr_array, np.ndarray]:
    mass, directions, velocity = granular(size, mass_ratio=mass_ratio)
    return condensed(mass, directions), velocity


def _column(size: int) -> tuple[csr_array, np.ndarray]:
    mass, directions, velocity = loaded_column(size, mass_ratio=1e6)
    return condensed(mass, directions), velocity


LCP_SCENES: Mapping[str, tuple[LCP, int, int]] = {
    "granular": (_grains, 300, 60),
    "granular, mass ratio 1e6": (partial(_grains, mass_ratio=1e6), 300, 60),
    "stack, mass ratio 1e6": (_column, 500, 100),
    "membrane, contrast 1e8": (partial(membrane, contrast=1e8), 30, 12),
    "tensegrity, contrast 1e8": (partial(tensegrity, contrast=1e8), 12, 10),
    "not symmetric": (p_matrix, 200, 60),
}
"""Generator, size and quick size of each scene."""


def _rng() -> np.random.Generator:
    return np.random.default_rng(seed=1)


FRICTION_SCENES: Mapping[str, tuple[Callable[[int], RigidBodies], int, int]] = {
    "box stack": (lambda n: box_stack(n, _rng()), 20, 5),
    "box stack, mass ratio 1e6": (lambda n: box_stack(n, _rng(), mass_ratio=1e6), 20, 5),
    "hyperstatic tower": (lambda n: block_tower(n, _rng()), 8, 3),
    "sphere pile": (lambda n: sphere_pile(n, _rng()), 60, 20),
    "wedge that slides": (lambda n: wedged_block(0.3), 1, 1),
    "wedge that jams": (lambda n: wedged_block(1.5), 1, 1),
}
"""Generator, size and quick size of each scene."""


@dataclass(frozen=True)
class Problem:
    """A scene, the methods for it, and the judge of their answers.

    Attributes
    ----------
    scene : str, name with the number of unknowns
    unknowns : int, length of an answer
    tolerance : float, residual asked for, relative to the data
    methods : tuple of str, names of all methods, ``"auto"`` first
    solve : callable, takes ``method`` and ``max_iterations`` by name
    verify : callable, an answer to its residual, from the data alone
    """

    scene: str
    unknowns: int
    tolerance: float
    methods: tuple[str, ...]
    solve: Callable[..., Solution]
    verify: Callable[[np.ndarray], float]


def lcp_problem(name: str, *, quick: bool) -> Problem:
    """Build a scene of ``LCP_SCENES``."""
    make, size, quick_size = LCP_SCENES[name]
    matrix, vector = make(quick_size if quick else size)
    return Problem(
        f"lcp, {name}, n = {vector.size}",
        vector.size,
        LCP_TOLERANCE,
        ("auto", *LCP_METHODS),
        partial(solve_lcp, matrix, vector, tolerance=LCP_TOLERANCE),
        lambda value: verify_lcp(matrix, vector, value),
    )


def friction_problem(name: str, *, quick: bool) -> Problem:
    """Build a scene of ``FRICTION_SCENES``."""
    make, size, quick_size = FRICTION_SCENES[name]
    W, q, mu = make(quick_size if quick else size).condensed()
    return Problem(
        f"friction, {name}, n = {q.size}",
        q.size,
        FRICTION_TOLERANCE,
        ("auto", *FRICTION_METHODS),
        partial(solve_friction, W, q, mu, tolerance=FRICTION_TOLERANCE),
        lambda value: verify_friction(W, q, mu, value).residual,
    )


def plan_nonsmooth(*, quick: bool) -> BenchFamily:
    """Plan to solve every scene by every method.

    If quick, smaller scenes and one run of each instead of the median of three.
    The dataset has histories.

    Notes
    -----
    *Errors* are measured by the verifier, and ``converged`` is 1 if they are within the
    ``tolerance`` of the scene; a failed run stays in the table with its error. The histories hold
    every residual in its order, also where it rose; the answer is the best. A residual counts as
    an iteration: a step of a Newton or interior-point method, twenty sweeps, n / 20 pivots.

    *Times* are measured on one thread in this process, with scaling and verification, after two
    iterations of every method on the same scene that take the compilation. A hundred processes
    would take longer to start than the solvers to run, so memory is not measured.
    """
    problems = {problem.scene: problem for problem in _problems(quick)}

    def trial(problem: Problem, method: str) -> Trial:
        warm_up = partial(problem.solve, method=method, max_iterations=WARM_UP)
        task, repeats = partial(problem.solve, method=method), 1 if quick else REPEATS
        return Trial(problem.scene, method, task, warm_up, repeats=repeats)

    return BenchFamily(
        [trial(problem, method) for problem in problems.values() for method in problem.methods],
        partial(_judge, problems),
        title="complementarity and friction: residual of every method",
        packages=("clarabel",),
        threads=1,
        process=False,
        attributes={"wall_time_counts": "median; without imports and compilation"},
    )


def _problems(quick: bool) -> Iterator[Problem]:
    for name in LCP_SCENES:
        yield lcp_problem(name, quick=quick)
    for name in FRICTION_SCENES:
        yield friction_problem(name, quick=quick)


def _judge(
    problems: Mapping[str, Problem], scene: str, runs: Runs
) -> Iterator[tuple[Trial, Columns]]:
    """Verify the answers to a problem."""
    problem = problems[scene]
    for trial, run in runs.items():
        answer: Any = run.value
        error = problem.verify(answer.value)
        yield (
            trial,
            {
                "error": error,
                "tolerance": problem.tolerance,
                "converged": int(error <= problem.tolerance),
                "iterations": len(answer.residuals) - 1,
                "unknowns": problem.unknowns,
                "history": np.column_stack([answer.seconds, answer.residuals]),
            },
        )
