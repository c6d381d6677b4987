"""Growth of the cost of substructures, grains, piles and large bodies with their size."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from multiscale.bench.measure import BenchFamily, Row, Runner
from multiscale.bench.nonsmooth_scenes import sphere_pile
from multiscale.bench.structures import scene_grid
from multiscale.bench.substructures import CUT_METHODS, EDGE, CutScene
from multiscale.macro import AssembledNewton, MultigridNewton, solve_assembly, solve_past_limit
from multiscale.nonsmooth import solve_friction

BODIES = {"factors": AssembledNewton(), "multigrid": MultigridNewton()}

SIZES: Mapping[tuple[str, str], tuple[int, ...]] = {
    ("tensegrity grid in substructures", "Newton-Schur"): (8, 16, 32, 64, 128),
    ("deposit of grains", "sweeps"): (20, 60, 200, 600),
    ("pile with friction, solved or refused", "auto"): (30, 60, 100, 300, 1000),
    ("path of exact equilibrium of a grid", "arc length"): (4, 8, 16, 32),
    ("two bodies with a joint", "factors"): (8, 12, 16, 24),
    ("two bodies with a joint", "multigrid"): (8, 12, 16, 24, 32, 48),
}
"""Modules along an edge, grains, modules again, and elements along an edge."""


class Growth(NamedTuple):
    """Size of a structure, and whether it has an answer; of a pile, also the reason of none."""

    unknowns: int
    converged: bool
    iterations: float


def grow(method: str, size: int) -> Growth:
    """Solve a structure of a size by a method of ``SIZES``."""
    if method in BODIES:
        from multiscale.bench.stability_bodies import large_blocks

        blocks, loads = large_blocks(1.0, 0.2, size), np.array([[1.0, 0.0], [1.0, 1.0]])
        result = solve_assembly(blocks, loads, method=BODIES[method])
        solved, steps = bool(result["converged"].all()), float(result["iterations"].sum())
        return Growth(int(result.attrs["unknowns"]), solved, steps)
    if method == "sweeps":
        from multiscale.macro.granulate import ContactLaw, deposit, simulate_grains

        heap = deposit(np.full(size, 0.01), (0.1, 0.1), ContactLaw(0.5, compliance=0.02))
        motion = simulate_grains(heap, 0.2, 2e-3)
        good = bool(np.isfinite(motion["position"].values).all())
        return Growth(6 * size, good, float(motion["iterations"].sum()))
    if method == "auto":
        rng = np.random.default_rng(seed=1)
        W, q, friction = sphere_pile(size, rng).condensed()
        solution = solve_friction(W, q, friction)
        answered = solution.converged or bool(solution.detail)
        return Growth(q.size, answered, float(len(solution.residuals)))
    if method == "arc length":
        grid = scene_grid(size)
        path = solve_past_limit(grid, 1.0)
        steps = float(path["iterations"].sum())
        return Growth(int(np.count_nonzero(~grid.fixed)), "failure" not in path.attrs, steps)
    parts = size // min(EDGE, size // 2)
    scene = CutScene("grid", scene_grid(size), np.ones((1, 1)), (parts, parts))
    answer = scene.solve(CUT_METHODS[1])
    return Growth(answer.unknowns, answer.converged, answer.iterations)


@partial(
    BenchFamily,
    "growth of cost with size: substructures, grains, piles, large bodies",
    packages=("scipy", "pypardiso", "pyamg"),
    threads=1,
    attributes={"growth": "unknowns"},
)
def growth(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Solve structures of all sizes, in the smallest form the first two of each."""
    for (scene, method), sizes in SIZES.items():
        for size in sizes[:2] if quick else sizes:
            row = run(scene, method, *(grow, method, size), warm=(method, sizes[0]))
            yield [row | (row["value"] or Growth(0, False, np.nan))._asdict()]
