r"""Rough joints with friction: how far the heuristic indicator of the error may be trusted.

Blocks of steel are pressed unevenly, sheared, sheared further, unloaded and sheared back. In
every iteration of LATIN the indicator stands beside the true error of the same admissible fields,
against the monolithic solution.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from time import perf_counter

import numpy as np

from multiscale.bench.trials import BenchFamily, Columns, Runs, Trial
from multiscale.errors import ConvergenceError
from multiscale.fe.boxes import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import Assembly, Body, Interface
from multiscale.macro.substructures import CutProblem, LatinMethod, cut_assembly, solve_whole
from multiscale.macro.substructures.error import Admissible, JointError, indicate_error
from multiscale.macro.substructures.latin import LatinIterate
from multiscale.macro.substructures.latin_solver import LatinSolver
from multiscale.macro.substructures.state import JointState

__all__ = ["JOINT_SCENES", "JointScene", "measure_effectivity", "plan_joints"]

EDGE, YOUNG, PRESSURE = 0.02, 210e9, 20e6
"""Edge of the blocks, m, their modulus and the mean pressure, Pa."""

TIMES = (1.0, 2.0, 3.0, 1.5, 0.0)
"""Pressed; sheared by one amplitude and by two; unloaded to a half; sheared back by one."""

DECADES, FINEST = 10.0 ** -np.arange(1.0, 7.0), 1e-7
"""True errors, the first iteration below each of which becomes a run, and the least compared."""

TOLERANCE, LIMIT = 1e-8, 400
"""Tolerance of LATIN, and the largest number of its iterations."""

SOFTEST = 1e-6
"""Least stiffness of a law in the norm of errors, relative to its mean."""


@dataclass(frozen=True)
class JointScene:
    """Two blocks with a rough joint.

    Attributes
    ----------
    ratio : float, stiffness of the law at the mean pressure relative to that of a block
    friction : float, friction coefficient, 1
    tilt : float, relative change of the pressure from the middle to the edge
    shear : float, amplitude of the shear traction, Pa
    parts : int, number of substructures of each block along either edge
    elements : tuple of int, number of elements of each block along its edges
    """

    ratio: float
    friction: float
    tilt: float
    shear: float
    parts: int
    elements: tuple[int, int, int] = (4, 4, 3)

    @cached_property
    def law(self) -> Sliders:
        """Law of the joint, whose stiffness is its pressure over its decay length."""
        normal = Exponential(PRESSURE, PRESSURE * EDGE / (self.ratio * YOUNG))
        return Sliders(normal, self.friction, pressures=(0.1 * PRESSURE, 10.0 * PRESSURE))

    def cut(self) -> CutProblem:
        """Cut the blocks, with one load case for each of ``TIMES``."""
        size, material = (EDGE, EDGE, EDGE), Elastic(YOUNG, 0.3)
        lower = Body(
            box_mesh(size, self.elements, origin=(0.0, 0.0, -EDGE)),
            material,
            supports={"bottom": (0.0, 0.0, 0.0)},
        )
        upper = Body(
            box_mesh(size, self.elements),
            material,
            supports={"front": (None, 0.0, None)},
            tractions={
                "top": (
                    lambda x, t: self.shear * (t - 1.0),
                    0.0,
                    lambda x, t: -PRESSURE * (1.0 + self.tilt * (2.0 * x[0] / EDGE - 1.0)),
                )
            },
        )
        joint = Interface((0, 1), ("top", "bottom"), self.law)
        return cut_assembly(Assembly((lower, upper), (joint,), TIMES), (self.parts, self.parts))


JOINT_SCENES: Mapping[str, JointScene] = {
    "soft law": JointScene(1e-2, 0.2, 0.2, 1.4e6, 2),
    "law like the blocks": JointScene(1.0, 0.2, 0.2, 1.4e6, 1),
    "uneven pressure": JointScene(1.0, 0.2, 1.5, 1.4e6, 2),
    "stiff law": JointScene(1e2, 0.2, 0.2, 1.6e6, 1),
    "stiff law, much friction": JointScene(1e2, 0.6, 1.0, 2e6, 2),
}


WARM_UP = JointScene(1.0, 0.2, 0.2, 1.4e6, 1, (2, 2, 1))
"""Scene that takes the compilation."""


def measure_effectivity(scene: JointScene) -> list[list[Columns]]:
    """Solve a scene step by step and compare indicator and true error in every iteration."""
    problem = scene.cut()
    found: list[tuple[float, JointError]] = []
    clock = perf_counter()

    def note(iteration: int, residual: float, iterate: LatinIterate) -> None:
        error = indicate_error(admissible, iterate)
        found.append((perf_counter() - clock, error))

    options = LatinMethod(tolerance=TOLERANCE, max_iterations=LIMIT, callback=note)
    solver, state = LatinSolver(problem, options, judged=False), JointState.at_rest(problem)
    method = solver.iteration
    admissible = Admissible(method)

    def norm(u: np.ndarray, traction: np.ndarray, compliance: np.ndarray) -> float:
        bodies = u @ (method.stack.stiffness @ u)
        return float(np.sqrt(bodies + np.sum(compliance * traction**2)))  # J^1/2

    steps: list[list[Columns]] = []
    for step, (u, traction, compliance) in enumerate(_solve_whole(scene, problem)):
        size, clock = norm(u, traction, compliance), perf_counter()
        found.clear()
        answer = solver.step(state, np.eye(len(TIMES))[step])
        state, _ = state.advance(problem.law, answer.unknowns, answer.jump, answer.traction)
        steps.append([])
        for iteration, (time, judged) in enumerate(found, 1):
            error = norm(judged.stressed - u, judged.traction - traction, compliance)
            if error >= FINEST * size:
                steps[-1].append(
                    {
                        "iterations": iteration,
                        "wall_time": time,
                        "error": error / size,
                        "effectivity": judged.estimate.error / error,
                    }
                )
    return steps


def _solve_whole(
    scene: JointScene, problem: CutProblem
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Solve the structure in one piece, step by step.

    Yields displacement of the substructures, m, traction of the joint, Pa, and weight of its square
    in the norm of errors, m^3/N, both of shape (3, points).
    """
    found = solve_whole(problem, np.eye(len(TIMES)))
    if "failure" in found.attrs:
        raise ConvergenceError(found.attrs["failure"])
    area = problem.weight
    numbers = np.concatenate([part.unknown for part in problem.substructures])
    for displacement, jump, traction in zip(
        *(found[name].values for name in ("displacement", "jump", "traction")), strict=True
    ):
        u = problem.unknowns(displacement)
        tangent = scene.law.respond(jump.T, scene.law.at_rest(jump.T)).tangent
        k = np.stack([tangent[i, i] for i in range(3)])  # nothing slips
        yield u[numbers], traction.T, area / np.maximum(k, SOFTEST * k.mean(axis=1, keepdims=True))


def plan_joints(*, quick: bool) -> BenchFamily:
    """Plan to measure the effectivity of the heuristic indicator in scenes, steps and iterations.

    If quick, two scenes only. A scene has a row for each step and decade of the true error, at the
    first iteration below it.

    Notes
    -----
    *Times* of a row count the iterations and the indicator of its step. *Memory* counts the whole
    scene.
    """
    return BenchFamily(
        [
            Trial(
                name,
                "LATIN",
                partial(measure_effectivity, scene),
                partial(measure_effectivity, WARM_UP),
            )
            for name, scene in list(JOINT_SCENES.items())[: 2 if quick else None]
        ],
        _judge,
        title="rough joints with friction: heuristic indicator over true error",
        attributes={"wall_time_counts": "iterations and indicator, without the preparation"},
    )


def _judge(name: str, runs: Runs) -> Iterator[tuple[Trial, Columns]]:
    """Find the first iteration below each decade of the true error."""
    for trial, run in runs.items():
        for step, samples in enumerate(run.value or []):
            for decade in DECADES:
                below = next((sample for sample in samples if sample["error"] <= decade), None)
                if below is not None:
                    yield trial, {"scene": f"{name}, step {step}", "converged": 1, **below}
