"""Cut structures: error against run time of LATIN, Newton-Schur and the solver of the whole."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from multiscale.bench.measure import BenchFamily, Row, Runner
from multiscale.bench.structures import distance, scene_grid
from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import (
    AssembledNewton,
    Assembly,
    Body,
    LatinMethod,
    LinkSystem,
    NewtonSchur,
    cut_links,
    solve_static,
)
from multiscale.macro.bodies import stacked_blocks
from multiscale.macro.substructures import (
    CutProblem,
    assemble,
    cut_assembly,
    split_grid,
)
from multiscale.schema import Dataset

CUT_METHODS = ("whole structure", "Newton-Schur", "LATIN")
"""Methods: the first is the reference of the others, and the second of the first."""

MODULES, QUICK_MODULES = (16, 32, 64, 128), (8, 16)  # modules along an edge of the grid
EDGE = 8  # modules along an edge of a substructure, at most: half of the smallest grid
TOLERANCE = 1e-8  # tolerance of the substructured solvers
RIGHT = 1e-7
"""Error up to which an answer counts as converged: the stopping test of LATIN is heuristic."""
ONCE = 64  # modules along an edge from which each method runs once


class CutAnswer(NamedTuple):
    """The answer to a scene, by a method."""

    value: np.ndarray  # tensions of the links, N, or displacement of the unknowns of bodies, m
    converged: bool
    iterations: float
    unknowns: int
    history: np.ndarray  # (samples, 2), seconds and errors; empty without a reference
    krylov_iterations: float = np.nan
    condition_number: float = np.nan


@dataclass(frozen=True, eq=False)
class CutScene:
    """A structure under a load: links, still to be cut, or bodies that are assembled and cut."""

    name: str
    structure: LinkSystem | CutProblem
    factor: np.ndarray  # (1, cases), of the load cases
    parts: tuple[int, int] = (1, 1)  # substructures of links along x and y
    repeats: int = 3

    def error(self, value: np.ndarray, reference: np.ndarray) -> float:
        """Return the relative distance of tensions, or displacements, in the norm of the energy."""
        if isinstance(self.structure, LinkSystem):
            return distance(self.structure, value, reference)
        K = assemble(self.structure).stiffness
        change, size = (float(u @ (K @ u)) for u in (value - reference, reference))
        return float(np.sqrt(max(change, 0.0) / size))

    def solve(self, method: str, reference: CutAnswer | None = None) -> CutAnswer:
        """Solve by a method of ``CUT_METHODS``; record errors of iterations from a reference."""
        begin, samples = perf_counter(), []
        whole = self.structure
        if method == CUT_METHODS[0] and isinstance(whole, LinkSystem):
            result = solve_static(whole, float(self.factor[0, 0]))
            unknowns, steps = int(np.count_nonzero(~whole.fixed)), int(result["iterations"]) - 1
            tension, history = result["tension"].values, np.zeros((0, 2))
            return CutAnswer(tension, bool(result["converged"]), steps, unknowns, history)
        problem = (
            cut_links(whole, split_grid(whole, self.parts))
            if isinstance(whole, LinkSystem)
            else whole
        )
        if method == CUT_METHODS[0]:
            return _answer(problem, AssembledNewton().solve(problem, self.factor), [])
        latin = method == CUT_METHODS[2]
        numbers = [body.links.number for body in problem.substructures if body.links]

        def record(_: int, __: float, state: Any) -> None:
            if reference is None:
                return
            if numbers:
                order = np.concatenate(numbers)
                value = np.empty(order.size)
                value[order] = state.tension
            else:
                value = problem.average(state.u) if latin else state.displacement
            samples.append((perf_counter() - begin, self.error(value, reference.value)))

        solver = LatinMethod if latin else NewtonSchur
        chosen = solver(tolerance=TOLERANCE, callback=record)
        result = chosen.solve(problem, self.factor)
        return _answer(problem, result, samples)


def _answer(
    problem: CutProblem, result: Dataset, history: Sequence[tuple[float, float]]
) -> CutAnswer:
    """Collect tension of the links, or displacement of the unknowns, from the solver of a cut."""
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
        *(
            float(result[name][0]) if name in result else np.nan
            for name in ("krylov_iterations", "condition_number")
        ),
    )


def make_scenes(*, quick: bool = False) -> list[CutScene]:
    """Build tensegrity grids with 14 % of slack cables, a plate and a rough joint."""
    scenes, unit = [], np.ones((1, 1))
    for n in QUICK_MODULES if quick else MODULES:
        parts = n // min(EDGE, n // 2)
        repeats = 1 if quick or n >= ONCE else 3
        name = f"grid, {n} x {n} modules in {parts} x {parts}"
        scenes.append(CutScene(name, scene_grid(n), unit, (parts, parts), repeats))
    fine, repeats = (1, 1) if quick else (2, 3)
    clamped = (0.0, 0.0, 0.0)
    plate = Body(
        box_mesh((4.0, 4.0, 0.2), (16 * fine, 16 * fine, fine)),
        Elastic(70e9, 0.3),
        supports={"left": clamped, "right": clamped},
        tractions={"top": (0.0, 0.0, -1e3)},
    )
    cut = cut_assembly(Assembly((plate,)), (4, 4))
    scenes.append(CutScene("plate in 4 x 4", cut, unit, repeats=repeats))
    law = Sliders(Exponential(2e9, 0.2e-6), 0.2, pressures=(1e6, 1e8))
    elements = (8 * fine, 4 * fine, 4 * fine)
    blocks = stacked_blocks((0.04, 0.02, 0.02), elements, [Elastic(210e9, 0.3)] * 2, [law])
    load = np.array([[20e6, 3e6]])  # Pa; three fifths of the joint slip
    name = "rough joint in 2 x 2 x 1"
    scenes.append(CutScene(name, cut_assembly(blocks, (2, 1)), load, repeats=repeats))
    return scenes


@partial(
    BenchFamily,
    "cut structures: LATIN, Newton-Schur and the whole structure, in one process",
    packages=("scipy", "pypardiso"),
    threads=1,
)
def substructures(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Solve every scene by LATIN, by Newton-Schur and without a cut."""
    small = make_scenes(quick=True)
    for scene in make_scenes(quick=quick):
        warm = small[0 if isinstance(scene.structure, LinkSystem) else -1]
        rows, whole = [], None
        for method in CUT_METHODS:
            rows.append(
                run(
                    scene.name,
                    method,
                    *(CutScene.solve, scene, method, whole),
                    warm=(warm, method),
                    repeats=scene.repeats,
                    tolerance=TOLERANCE,
                )
            )
            whole = rows[0]["value"]
        yield judged(rows, scene)


def judged(rows: Sequence[Row], scene: CutScene) -> Sequence[Row]:
    """Compare the answers to a scene."""
    for row, other in zip(rows, (rows[1], rows[0], rows[0]), strict=True):
        answer, reference = row["value"], other["value"]
        if answer is None:
            continue
        error = np.nan if reference is None else scene.error(answer.value, reference.value)
        row |= {
            "unknowns": answer.unknowns,
            "iterations": answer.iterations,
            "error": error,
            "converged": int(answer.converged and error <= RIGHT),
            "history": answer.history,
            "krylov_iterations": answer.krylov_iterations,
            "condition_number": answer.condition_number,
        }
        if isinstance(scene.structure, LinkSystem):
            row["cables"] = scene.structure.n_links
    return rows
