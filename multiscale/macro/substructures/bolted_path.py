r"""Paths of structures with bolts: tightened by given forces, then locked.

While a bolt is tightened, a pair of forces F pulls its washers together and the shank is left out.
A locked bolt is a substructure of its own, the shank, which shares the middles of the washers. With
the distance :math:`\delta` of the washers and its value :math:`\delta_0` when the force was F,

.. math:: N = (F - k \delta_0) + k \delta,    \tag{1}

so that the pair of forces is :math:`F - k \delta_0` from then on.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import csr_array

from multiscale.convergence import check_limits
from multiscale.errors import CaseError
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.cut_results import end_path, load_factors
from multiscale.macro.substructures.problem import CutBolt, CutProblem, Substructure
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = ["Method", "bolt_pull", "follow_bolts", "lock_bolts"]

LOOSE = 1e-9
"""Force of a bolt, relative to the largest of its path, up to which it is none."""


@dataclass(frozen=True)
class Method:
    """A way to solve an assembly.

    Parameters
    ----------
    parts : tuple of int, substructures of every body along x and y
    tolerance, max_iterations, after_step : options of its solver
    """

    name: ClassVar[str]
    solver: ClassVar[Callable[..., Dataset]]
    condenses: ClassVar[bool] = False
    """Whether bodies are condensed onto their joints before it follows a path, whose steps may
    begin as the steps of another path do."""

    parts: tuple[int, int] = (1, 1)
    tolerance: float = 1e-10
    max_iterations: int = 100
    after_step: Callable[[], object] | None = None

    def __post_init__(self) -> None:
        check_limits(self.tolerance, self.max_iterations)

    @property
    def coarse(self) -> bool:
        """Whether a coarse problem balances the resultants of interfaces."""
        return not self.condenses

    @property
    def options(self) -> dict[str, Any]:
        """All options of its solver."""
        return {one.name: getattr(self, one.name) for one in fields(self) if one.name != "parts"}

    def solve(
        self,
        problem: CutProblem,
        load_factor: float | np.ndarray,
        after: Dataset | None = None,
        near: Dataset | None = None,
    ) -> Dataset:
        """Solve at factors of the load cases; the earlier steps come first in the result.

        A path of the same steps under other laws may tell where to begin.
        """
        begin = {"near": near} if self.condenses else {}
        return type(self).solver(problem, load_factor, after=after, **begin, **self.options)


def bolt_pull(bolt: CutBolt, n: int) -> np.ndarray:
    """Give the forces, shape (n,), of a bolt under a tension of one on all unknowns."""
    pull = np.zeros(n)
    pull[list(bolt.unknown)] = 1.0, -1.0
    return pull


def lock_bolts(
    problem: CutProblem,
    tension: np.ndarray | None = None,
    stretch: np.ndarray | None = None,
    factor: float = 1.0,
) -> CutProblem:
    """Let the shanks carry what changes; the first load case then stays at its factor."""
    if not problem.bolts:
        return problem
    (position, component), nothing = problem.places(), np.zeros(len(problem.bolts))
    pull, shanks = np.zeros(problem.n), []
    forces, stretches = (nothing if one is None else one for one in (tension, stretch))
    for bolt, force, apart in zip(problem.bolts, forces, stretches, strict=True):
        pull += (force - bolt.stiffness * apart) * bolt_pull(bolt, problem.n)  # (1)
        ends = np.array(bolt.unknown)
        K = csr_array(bolt.stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]]))
        load = np.zeros((2, problem.n_cases))
        shanks.append(Substructure(K, load, ends, position[ends], component[ends]))
    pull /= factor * problem.shares
    parts = [
        replace(part, load=np.column_stack([pull[part.unknown], part.load[:, 1:]]))
        for part in problem.substructures
    ]
    return replace(problem, substructures=(*parts, *shanks), locked=True)


def follow_bolts(
    problem: CutProblem,
    load_factor: float | np.ndarray,
    method: Method,
    after: Dataset | None = None,
    near: Dataset | None = None,
) -> Dataset:
    """Solve step by step; tighten bolts where the first factor changes, lock them elsewhere."""
    if not problem.bolts:
        return method.solve(problem, load_factor, after, near)
    factors = load_factors(problem, load_factor)
    if not np.all(factors[:, 0] > 0.0):
        raise CaseError(
            f"the first load case tightens the bolts, and its factor must be positive at every "
            f"step, got {factors[:, 0].min():g}"
        )
    first = 0 if after is None else after.sizes["step"]
    tightens = np.diff(factors[:, 0], prepend=0.0 if after is None else factors[0, 0]) != 0.0
    stiffness, preload = (
        np.array([getattr(bolt, name) for bolt in problem.bolts])
        for name in ("stiffness", "preload")
    )
    pulls = np.stack([bolt_pull(bolt, problem.n) for bolt in problem.bolts], axis=1)
    result, steps = after, first + len(factors)
    force = np.zeros((0, preload.size)) if after is None else after["bolt_force"].values
    for group in np.split(np.arange(len(factors)), np.flatnonzero(np.diff(tightens)) + 1):
        if tightens[group[0]]:
            result = method.solve(problem, factors[group], result, near)
            new = factors[group, :1] * preload
        else:
            assert result is not None  # the first step tightens, or follows a path
            at = -problem.unknowns(result["displacement"].values[-1]) @ pulls
            locked = lock_bolts(problem, force[-1], at, factors[group[0], 0])
            result = method.solve(locked, factors[group], result, near)
            u = problem.unknowns(result["displacement"].values[first + group])
            new = force[-1] + stiffness * (-u @ pulls - at)  # (1)
        force = np.concatenate([force, new])
        loose = force <= LOOSE * np.nanmax(np.abs(force), initial=0.0)
        failed = np.flatnonzero(loose.any(axis=1) | (result["converged"].values != 1))
        if failed.size:
            step = int(failed[0])
            pairs = zip(problem.bolts, loose[step], strict=True)
            names = " and ".join(bolt.name for bolt, is_loose in pairs if is_loose)
            reason = (
                f"the load leaves {names} loose, as its force falls to zero; tighten it harder, or "
                f"lower the load"
            )
            if not names and not tightens[step - first]:
                before = -result["traction"].to_numpy()[step - 1, :, 0]
                reason = _say_parted(problem, factors[step - first], before, force[step - 1])
            else:
                reason = reason if names else ""
            result = end_path(result, step, steps, reason)
            force = np.concatenate([force[:step], np.full((steps - step, preload.size), np.nan)])
            break
    assert result is not None
    return MACRO_RESULT.assign(result, {"bolt_force": force}).assign_attrs(
        substructures=len(problem.substructures), interfaces=len(problem.interfaces)
    )


def _say_parted(
    problem: CutProblem, factor: np.ndarray, pressure: np.ndarray, tension: np.ndarray
) -> str:
    """Say that a load parts what bolts of given tensions, N, clamp; nothing if it does not."""
    load = problem.load(factor)
    slide = find_slide(problem, load, pressure)
    if slide is None or slide.joints:
        return ""
    component = np.concatenate([part.component for part in problem.substructures])
    force = np.bincount(component, load, minlength=3)  # the pulls of bolts cancel each other
    along = ", ".join(f"{1e-3 * one:.4g}" for one in force)
    bolts = ", ".join(f"{1e-3 * one:.4g}" for one in tension)
    return (
        f"the load opens the faces that the bolts clamp: it is {along} kN along x, y and z, and "
        f"the bolts hold {bolts} kN at the step before; tighten them harder, or lower the load"
    )
