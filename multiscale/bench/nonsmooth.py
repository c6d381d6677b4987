"""Complementarity and friction: the residual of every method against its run time."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from multiscale.bench.measure import BenchFamily, Row, Runner
from multiscale.bench.nonsmooth_scenes import (
    RigidBodies,
    block_tower,
    box_stack,
    condensed,
    granular,
    loaded_column,
    membrane,
    p_matrix,
    sphere_pile,
    tensegrity,
    wedged_block,
)
from multiscale.convergence import Solution
from multiscale.nonsmooth import solve_friction, solve_lcp, verify_friction, verify_lcp
from multiscale.nonsmooth.friction import FRICTION_METHODS
from multiscale.nonsmooth.lcp import LCP_METHODS

LCP = Callable[[int], tuple[csr_array | np.ndarray, np.ndarray]]
"""From a size to the matrix and the vector of a problem."""


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


class Problem(NamedTuple):
    """A scene with its solver and its verifier."""

    scene: str
    unknowns: int
    tolerance: float  # relative to the data
    methods: tuple[str, ...]
    solve: Callable[..., Solution]
    verify: Callable[[np.ndarray], float]  # from an answer to its residual, by the data only

    def answer(self, method: str, limit: int | None = None) -> Solution:
        """Solve by a method, with a limit on the iterations."""
        options = {} if limit is None else {"max_iterations": limit}
        return self.solve(method=method, tolerance=self.tolerance, **options)


def problem_of(name: str, *, quick: bool) -> Problem:
    """Build a scene of ``LCP_SCENES`` or of ``FRICTION_SCENES``."""
    if name in LCP_SCENES:
        make, *sizes = LCP_SCENES[name]
        matrix, vector = make(sizes[quick])
        return Problem(
            f"lcp, {name}, n = {vector.size}",
            vector.size,
            1e-10,
            ("auto", *LCP_METHODS),
            partial(solve_lcp, matrix, vector),
            lambda value: verify_lcp(matrix, vector, value),
        )
    pile, *sizes = FRICTION_SCENES[name]
    W, q, mu = pile(sizes[quick]).condensed()
    return Problem(
        f"friction, {name}, n = {q.size}",
        q.size,
        1e-8,
        ("auto", *FRICTION_METHODS),
        partial(solve_friction, W, q, mu),
        lambda value: verify_friction(W, q, mu, value).residual,
    )


@partial(
    BenchFamily,
    "complementarity and friction: residual of every method",
    packages=("clarabel",),
    threads=1,
    process=False,
    attributes={"wall_time_counts": "median; without imports and compilation"},
)
def nonsmooth(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Solve every scene by every method."""
    for name in (*LCP_SCENES, *FRICTION_SCENES):
        problem = problem_of(name, quick=quick)
        yield [judged(problem, run, method, quick) for method in problem.methods]


def judged(problem: Problem, run: Runner, method: str, quick: bool) -> Row:
    """Measure a method, and verify its answer."""
    row = run(
        problem.scene,
        method,
        *(problem.answer, method),
        warm=(method, 2),
        repeats=1 if quick else 3,
    )
    answer = row["value"]
    error = problem.verify(answer.value)
    return row | {
        "error": error,
        "tolerance": problem.tolerance,
        "converged": int(error <= problem.tolerance),
        "iterations": len(answer.residuals) - 1,
        "unknowns": problem.unknowns,
        "history": np.column_stack([answer.seconds, answer.residuals]),
    }
