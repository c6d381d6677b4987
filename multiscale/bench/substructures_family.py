"""Cut structures: error against run time of LATIN, Newton-Schur and the solver of the whole."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.bench.structures_family import distance, scene_grid
from multiscale.bench.trials import BenchFamily, Columns, Runs, Trial
from multiscale.fe.boxes import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import (
    Assembly,
    Body,
    LinkSystem,
    cut_links,
    solve_latin,
    solve_schur,
    solve_static,
)
from multiscale.macro.bodies import stacked_blocks
from multiscale.macro.substructures import (
    CutProblem,
    assemble,
    cut_assembly,
    solve_whole,
    split_grid,
)
from multiscale.schema import Dataset

__all__ = [
    "CUT_METHODS",
    "CutAnswer",
    "CutScene",
    "make_scenes",
    "plan_substructures",
    "solve_scene",
]

CUT_METHODS = ("whole structure", "Newton-Schur", "LATIN")
"""Methods: the first one is the reference of the others, and the second one of the first one."""

MODULES, QUICK_MODULES = (16, 32, 64, 128), (8, 16)
"""Numbers of modules along an edge of the grid."""

EDGE = 8
"""Modules along an edge of a substructure, at most: half of the smallest grid."""

TOLERANCE = 1e-8
"""Tolerance of the substructured solvers."""

RIGHT = 1e-7
"""Error up to which an answer counts as converged: the stopping test of LATIN is heuristic."""

THREADS = 1
"""Number of threads: the substructures of a process are solved one after the other."""

ONCE = 64
"""Modules along an edge from which on each method runs once."""


@dataclass(frozen=True, eq=False)
class CutScene:
    """A structure under one load.

    Attributes
    ----------
    name : str
    structure : LinkSystem or CutProblem, still to be cut, or assembled and cut
    factor : ndarray, shape (1, cases), factors of the load cases
    parts : tuple of int, numbers of substructures of links along x and y
    repeats : int, number of runs of each method
    """

    name: str
    structure: LinkSystem | CutProblem
    factor: np.ndarray
    parts: tuple[int, int] = (1, 1)
    repeats: int = 3

    def cut(self) -> CutProblem:
        """Cut the structure, unless it is cut already."""
        if isinstance(self.structure, CutProblem):
            return self.structure
        return cut_links(self.structure, split_grid(self.structure, self.parts))

    def error(self, value: np.ndarray, reference: np.ndarray) -> float:
        """Relative distance of tensions, or of displacements, in the norm of the energy."""
        if isinstance(self.structure, LinkSystem):
            return distance(self.structure, value, reference)
        K = assemble(self.structure).stiffness
        change, size = (float(u @ (K @ u)) for u in (value - reference, reference))
        return float(np.sqrt(max(change, 0.0) / size))


@dataclass(frozen=True, eq=False)
class CutAnswer:
    """Answer of a method.

    Attributes
    ----------
    value : ndarray, tensions of the links, N, or displacement of the unknowns of the bodies, m
    converged : bool, whether the method says so
    iterations : float, number of iterations
    unknowns : int, number of unknowns
    history : ndarray, shape (samples, 2)
        Seconds and error after each iteration; empty without a reference.
    """

    value: np.ndarray
    converged: bool
    iterations: float
    unknowns: int
    history: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))


def make_scenes(*, quick: bool = False) -> list[CutScene]:
    """Make tensegrity grids with 14 % of slack cables, a plate and a rough joint."""
    scenes = []
    for n in QUICK_MODULES if quick else MODULES:
        parts = n // min(EDGE, n // 2)
        repeats = 1 if quick or n >= ONCE else 3
        name = f"grid, {n} x {n} modules in {parts} x {parts}"
        scenes.append(CutScene(name, scene_grid(n), np.ones((1, 1)), (parts, parts), repeats))
    fine, repeats = (1, 1) if quick else (2, 3)
    clamped = (0.0, 0.0, 0.0)
    plate = Body(
        box_mesh((4.0, 4.0, 0.2), (16 * fine, 16 * fine, fine)),
        Elastic(70e9, 0.3),
        supports={"left": clamped, "right": clamped},
        tractions={"top": (0.0, 0.0, -1e3)},
    )
    cut = cut_assembly(Assembly((plate,)), (4, 4))
    scenes.append(CutScene("plate in 4 x 4", cut, np.ones((1, 1)), repeats=repeats))
    law = Sliders(Exponential(2e9, 0.2e-6), 0.2, pressures=(1e6, 1e8))
    elements = (8 * fine, 4 * fine, 4 * fine)
    blocks = stacked_blocks((0.04, 0.02, 0.02), elements, [Elastic(210e9, 0.3)] * 2, [law])
    load = np.array([[20e6, 3e6]])  # Pa; three fifths of the joint slip
    scenes.append(
        CutScene("rough joint in 2 x 2 x 1", cut_assembly(blocks, (2, 1)), load, repeats=repeats)
    )
    return scenes


def solve_scene(scene: CutScene, method: str, reference: CutAnswer | None = None) -> CutAnswer:
    """Solve a scene by one of ``CUT_METHODS``; with a reference, note the errors on the way."""
    begin, history = perf_counter(), []
    if method == CUT_METHODS[0] and isinstance(scene.structure, LinkSystem):
        result = solve_static(scene.structure, float(scene.factor[0, 0]))
        unknowns = int(np.count_nonzero(~scene.structure.fixed))
        steps = int(result["iterations"]) - 1
        return CutAnswer(result["tension"].values, bool(result["converged"]), steps, unknowns)
    problem = scene.cut()
    if method == CUT_METHODS[0]:
        return _answer(problem, solve_whole(problem, scene.factor))
    latin = method == CUT_METHODS[2]
    order = np.concatenate(
        [part.links.number if part.links else [] for part in problem.substructures]
    )

    def note(_: int, __: float, state: Any) -> None:
        if reference is None:
            return
        if order.size:
            value = np.empty(order.size)
            value[order.astype(int)] = state.tension if latin else state.tension()
        else:
            value = problem.average(state.u) if latin else state.displacement()
        history.append((perf_counter() - begin, scene.error(value, reference.value)))

    solve = solve_latin if latin else solve_schur
    result = solve(problem, scene.factor, tolerance=TOLERANCE, callback=note)
    return _answer(problem, result, history)


def _answer(
    problem: CutProblem, result: Dataset, history: Sequence[tuple[float, float]] = ()
) -> CutAnswer:
    """Tension of the links, or displacement of the unknowns, that a solver of a cut has found."""
    value = (
        result["tension"].values[0]
        if problem.n_links
        else problem.unknowns(result["displacement"].values[0])
    )
    return CutAnswer(
        value,
        bool(result["converged"][0]),
        float(result["iterations"][0]),
        problem.n,
        np.array(history).reshape(-1, 2),
    )


def plan_substructures(*, quick: bool) -> BenchFamily:
    """Plan to solve every scene by LATIN, by Newton-Schur and without a cut.

    If quick, two small grids, coarser bodies, and one run of each method.
    The dataset has histories.

    Notes
    -----
    *Errors* are distances in the norm of the energy: of the tensions, see
    :func:`multiscale.bench.structures_family.distance`, or of the displacements of bodies, with the
    stiffness of the bodies. The whole structure is the reference of the substructured solvers;
    its own error is its distance from the answer of Newton-Schur.

    *Times* begin with the structure of links, or with the assembled substructures of bodies, and
    count the cut of the former; each run has a process of its own, after a small one that takes
    imports and compilation. *Memory* counts the whole process. Each method has one process
    of one thread, so that no substructure is solved beside another.
    """
    small = make_scenes(quick=True)
    trials: dict[Trial, CutScene] = {}
    for scene in make_scenes(quick=quick):
        warm, whole = small[0 if isinstance(scene.structure, LinkSystem) else -1], None
        for method in CUT_METHODS:
            trial = Trial(
                scene.name,
                method,
                partial(solve_scene, scene, method),
                partial(solve_scene, warm, method),
                {"tolerance": TOLERANCE},
                scene.repeats,
                follows=whole,
            )
            trials[trial], whole = scene, whole or trial
    return BenchFamily(
        trials,
        partial(_judge, trials),
        title="cut structures: LATIN, Newton-Schur and the whole structure, in one process",
        packages=("scipy", "pypardiso"),
        threads=THREADS,
    )


def _judge(
    scenes: Mapping[Trial, CutScene], name: str, runs: Runs
) -> Iterator[tuple[Trial, Columns]]:
    """Compare the answers to a scene."""
    answers = {trial.method: run.value for trial, run in runs.items()}
    for trial in runs:
        mine, other = answers[trial.method], answers[CUT_METHODS[trial.method == CUT_METHODS[0]]]
        if mine is None:
            continue
        error = np.nan if other is None else scenes[trial].error(mine.value, other.value)
        yield (
            trial,
            {
                "unknowns": mine.unknowns,
                "iterations": mine.iterations,
                "error": error,
                "converged": int(mine.converged and error <= RIGHT),
                "history": mine.history,
            },
        )
