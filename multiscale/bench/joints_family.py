r"""Rough joints with friction: how far the heuristic indicator of the error may be trusted.

Blocks of steel are pressed unevenly, sheared, sheared further, unloaded and sheared back. In
every iteration of LATIN the indicator stands beside the true error of the same admissible fields,
against the monolithic solution.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from multiscale.bench.record import load_average, record, versions
from multiscale.bench.trials import Report
from multiscale.errors import ConvergenceError
from multiscale.fe.boxes import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import Assembly, Body, Interface
from multiscale.macro.substructures import CutProblem, cut_assembly, solve_whole
from multiscale.macro.substructures.bound import Admissible
from multiscale.macro.substructures.indicator import HeuristicIndicator, JointError
from multiscale.macro.substructures.joint_state import without_slip
from multiscale.macro.substructures.latin import Latin, LatinIterate
from multiscale.macro.substructures.latin_solver import solve_step

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["JOINT_SCENES", "JointScene", "bench_joints", "measure_effectivity"]

EDGE, YOUNG, PRESSURE = 0.02, 210e9, 20e6
"""Edge of the blocks, m, their modulus and the mean pressure, Pa."""

TIMES = (1.0, 2.0, 3.0, 1.5, 0.0)
"""Pressed; sheared by one amplitude and by two; unloaded to a half; sheared back by one."""

DECADES, FINEST = 10.0 ** -np.arange(1.0, 7.0), 1e-7
"""True errors, the first iteration below each of which becomes a run, and the least compared."""

TOLERANCE, LIMIT = 1e-8, 400
"""Of LATIN, and its iterations."""

SOFTEST = 1e-6
"""Least stiffness of a law in the norm of errors, relative to its mean."""


@dataclass(frozen=True)
class JointScene:
    """Two blocks with a rough joint.

    Attributes
    ----------
    ratio : float
        Stiffness of the law at the mean pressure relative to that of a block.
    friction : float
    tilt : float
        Relative change of the pressure from the middle to the edge.
    shear : float
        Amplitude of the shear traction, Pa.
    parts : int
        Substructures of each block along either edge.
    """

    ratio: float
    friction: float
    tilt: float
    shear: float
    parts: int

    @cached_property
    def law(self) -> Sliders:
        """Law of the joint, whose stiffness is its pressure over its decay length."""
        normal = Exponential(PRESSURE, PRESSURE * EDGE / (self.ratio * YOUNG))
        return Sliders(normal, self.friction, pressures=(0.1 * PRESSURE, 10.0 * PRESSURE))

    def cut(self, elements: tuple[int, int, int] = (4, 4, 3)) -> CutProblem:
        """One load case for each of ``TIMES``."""
        size, material = (EDGE, EDGE, EDGE), Elastic(YOUNG, 0.3)
        lower = Body(
            box_mesh(size, elements, origin=(0.0, 0.0, -EDGE)),
            material,
            supports={"bottom": (0.0, 0.0, 0.0)},
        )
        upper = Body(
            box_mesh(size, elements),
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


def measure_effectivity(scene: JointScene) -> Iterator[dict[str, float]]:
    """Solve a scene step by step and compare indicator and true error in every iteration.

    Yields
    ------
    dict
        ``step``, ``iterations``, ``wall_time`` (s), true ``error`` relative to the solution, and
        ``effectivity``, the indicator over the true error, down to errors of 1e-7.
    """
    problem = scene.cut()
    method = Latin(problem)
    admissible = Admissible(method.stack, method.sides, method.k0.matrix, method.own)
    judge = HeuristicIndicator(problem, admissible)
    for step, exact in enumerate(_monolithic(scene, problem)):
        for iteration, (time, estimate) in enumerate(_watch(method, judge, step), 1):
            error, size = exact.distance(estimate), exact.size
            if error >= FINEST * size:
                yield {
                    "step": step,
                    "iterations": iteration,
                    "wall_time": time,
                    "error": error / size,
                    "effectivity": estimate.estimate.error / error,
                }


def _watch(method: Latin, judge: HeuristicIndicator, step: int) -> list[tuple[float, JointError]]:
    """Solve a step; return time and indicator after every iteration."""
    found: list[tuple[float, JointError]] = []
    clock = perf_counter()

    def note(iteration: int, residual: float, iterate: LatinIterate) -> None:
        error = judge.evaluate(iterate.u, iterate.force, method.states, method.joint_k, method.team)
        found.append((perf_counter() - clock, error))

    solve_step(method, method.stack.load[:, step], None, TOLERANCE, LIMIT, note)
    return found


@dataclass(frozen=True, eq=False)
class _Exact:
    """Solution of a step and the norm in which errors are measured."""

    problem: CutProblem
    u: np.ndarray
    traction: np.ndarray
    weight: np.ndarray
    stiffness: np.ndarray

    def distance(self, found: JointError) -> float:
        """Norm of the error of admissible fields, J^1/2."""
        return self._norm(found.stressed - self.u, found.traction - self.traction)

    @property
    def size(self) -> float:
        """Norm of the solution, J^1/2."""
        return self._norm(self.u, self.traction)

    def _norm(self, u: np.ndarray, traction: np.ndarray) -> float:
        total, first = float(np.sum(self.weight * traction**2 / self.stiffness)), 0
        for part in self.problem.substructures:
            own = u[first : first + part.n]
            total += float(own @ (part.stiffness @ own))
            first += part.n
        return float(np.sqrt(total))


def _monolithic(scene: JointScene, problem: CutProblem) -> Iterator[_Exact]:
    """Solve the structure in one piece, step by step."""
    law, found = scene.law, solve_whole(problem, np.eye(len(TIMES)))
    if "failure" in found.attrs:
        raise ConvergenceError(found.attrs["failure"])
    weight = np.concatenate([joint.weight for joint in problem.joints])
    numbers = np.concatenate([part.unknown for part in problem.substructures])
    for displacement, jump, traction in zip(
        *(found[name].values for name in ("displacement", "jump", "traction")), strict=True
    ):
        u = problem.unknowns(displacement)
        k = without_slip(law, jump.T)
        k = np.maximum(k, SOFTEST * k.mean(axis=1, keepdims=True))
        yield _Exact(problem, u[numbers], traction.T, weight, k)


def bench_joints(*, quick: bool, report: Report) -> "xr.Dataset":
    """Tabulate the effectivity of the heuristic indicator over scenes, steps and iterations.

    If quick, two scenes only.
    There is one run for each step and decade of the true error, at the first iteration below it.
    Times count the iterations and the indicator.
    """
    load = load_average()
    rows: list[dict[str, float | str]] = []
    for name, scene in list(JOINT_SCENES.items())[: 2 if quick else None]:
        values = list(measure_effectivity(scene))
        for step, decade in product(range(len(TIMES)), DECADES):
            mine = (value for value in values if value["step"] == step)
            below = next((value for value in mine if value["error"] <= decade), None)
            if below is not None:
                row: dict[str, float | str] = {key: below[key] for key in below if key != "step"}
                scene_step = {"scene": f"{name}, step {step}", "method": "LATIN"}
                rows.append(row | scene_step | {"converged": 1})
        effectivity = np.array([value["effectivity"] for value in values])
        report(
            f"{name}: effectivity {np.median(effectivity):.2g}, from {effectivity.min():.2g} to "
            f"{effectivity.max():.2g} in {effectivity.size} iterations"
        )
    return record(
        rows,
        title="rough joints with friction: heuristic indicator over true error",
        versions=versions(),
        load_before=load,
        repeats=1,
        wall_time_counts="iterations and indicator, without the preparation",
    )
