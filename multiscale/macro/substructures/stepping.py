r"""Follow a path of loads step by step with any method; bolts are tightened, then locked.

With the distance :math:`\delta` of the washers, :math:`\delta_0` when the force was F, the pair of
forces is :math:`F - k \delta_0` on the shank, a substructure, while a bolt is locked:

.. math:: N = (F - k \delta_0) + k \delta.    \tag{1}
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from multiscale.convergence import check_limits
from multiscale.errors import CaseError, require
from multiscale.laws.interface_law import InterfaceLaw, Sliding
from multiscale.macro.monolithic import LinearSolver, factorise_joined
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.problem import CutProblem
from multiscale.schema import COMPONENTS, MACRO_RESULT, Dataset

ALONG = np.array([[0.0], [1.0], [1.0]])
"""Picks the tangential components of a jump."""

NO_FORCE = 1e-9
"""Force of a bolt, relative to the largest of its path, up to which it is zero."""

ALIKE = 0.1
"""Difference of the slipping share of a first loading and of the slabs that slip in a step up to
which the former counts, because it is continuous."""

NOT_TRIED = {
    "iterations": 0,
    "krylov_iterations": 0,
    "condition_number": np.nan,
    "wall_time": 0.0,
}
"""Cost of a step after a failure."""

FIELDS = ("displacement", "tension", "slack", "jump", "traction", "bolt_force")
"""Fields that are NaN in a step that failed."""


@dataclass(frozen=True, eq=False)
class JointState:
    """Committed state at the end of a step.

    Tangential jumps of the next step count from here: on a stiff law, the change in a step would
    be rounded away in sums of long slips.

    Attributes
    ----------
    unknowns : ndarray, shape (n,), displacement, m
    jump : ndarray, shape (3, points), normal jump, m; both tangential rows are zero
    slid : ndarray, shape (3, points), tangential jumps of all steps, m; the normal row is zero
    history : ndarray, shape (law.n_state, points), internal variables of the laws
    traction : ndarray, shape (3, points), Pa
    tightening : float, factor of the load case that tightens the bolts
    pull : ndarray, shape (bolts,)
        Tension of each bolt less the force of the stretch of its shank, N, while it is locked.
    """

    unknowns: np.ndarray
    jump: np.ndarray
    slid: np.ndarray
    history: np.ndarray
    traction: np.ndarray
    tightening: float = 0.0
    pull: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def at_rest(cls, problem: CutProblem) -> "JointState":
        """State without displacement, jumps and tractions."""
        nothing = np.zeros((3, problem.weight.size))
        history = np.zeros((problem.law.n_state, problem.weight.size))
        return cls(
            np.zeros(problem.n),
            nothing,
            nothing,
            history,
            nothing,
            pull=np.zeros(len(problem.bolts)),
        )

    @property
    def whole_jump(self) -> np.ndarray:
        """Jump since the beginning of the path, shape (3, points), m."""
        return np.asarray(self.jump + self.slid)

    @property
    def pressure(self) -> np.ndarray:
        """Contact pressure, shape (points,), Pa."""
        return np.asarray(-self.traction[0])

    def advance(
        self, law: InterfaceLaw, unknowns: np.ndarray, jump: np.ndarray, traction: np.ndarray
    ) -> tuple["JointState", Sliding]:
        """Commit a step to a jump with tangential components that count from this state.

        Raises
        ------
        ConvergenceError
            If the step gains energy; see :func:`~multiscale.laws.interface_law.advance_state`.
        """
        account = law.sliding(jump, self.history)
        along = ALONG * jump
        following = replace(
            self,
            unknowns=unknowns,
            jump=jump - along,
            slid=self.slid + along,
            history=law.from_here(account.state),
            traction=traction,
        )
        return following, account


class StepAnswer(NamedTuple):
    """End of a step; tangential jumps count from the state before the step."""

    unknowns: np.ndarray  # displacement, (n,), m
    jump: np.ndarray  # (3, points), m
    traction: np.ndarray  # (3, points), Pa
    # converged, failure, residual, iterations, wall_time and further fields of the dataset
    report: dict[str, Any]


class StepSolver(Protocol):
    """A method prepared for a structure, without the path."""

    @property
    def attributes(self) -> Mapping[str, int | str]:
        """Attributes of the method in a dataset."""

    def step(
        self,
        state: JointState,
        factor: np.ndarray,
        near: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> StepAnswer:
        """Solve a step from a committed state to factors of the load cases."""


@dataclass(frozen=True)
class Method:
    """Method for an assembly.

    Parameters
    ----------
    parts : tuple of int, substructures of every body along x and y
    max_iterations : int, limit of a step
    after_step : callable, optional, called after every step that converged
    """

    name: ClassVar[str]
    condensed: ClassVar[int] = 0
    """Boundary unknowns up to which bodies are condensed onto their joints before a path."""

    parts: tuple[int, int] = (1, 1)
    tolerance: float = 1e-10
    max_iterations: int = 100
    after_step: Callable[[], object] | None = None

    def __post_init__(self) -> None:
        check_limits(self.tolerance, self.max_iterations)
        for number in self.parts:
            require("parts along an axis", number, "[1, inf)", integer=True)

    @property
    def coarse(self) -> bool:
        """Whether a coarse problem balances the resultants of interfaces."""
        return True

    def linear(self, problem: CutProblem) -> LinearSolver:
        """Return the solver of the matrices of a whole structure."""
        return factorise_joined

    def start(self, problem: CutProblem) -> StepSolver:
        """Prepare a structure."""
        raise NotImplementedError

    def solve(self, problem: CutProblem, load_factor: float | np.ndarray = 1.0) -> Dataset:
        """Solve at factors of the load cases, from rest; see :func:`solve_latin`."""
        return follow(PreparedStructure(problem, self), load_factor).result


@dataclass(frozen=True, eq=False)
class PreparedStructure:
    """A structure and the method that solves it, prepared once for all paths."""

    problem: CutProblem
    method: Method

    @cached_property
    def tightened(self) -> StepSolver:
        """Solver of the structure with given forces of its bolts, if any."""
        return self.method.start(self.problem)

    @cached_property
    def locked(self) -> StepSolver:
        """Solver of the structure with the shanks of its bolts."""
        return self.method.start(self.problem.with_locked_bolts())


@dataclass(frozen=True, eq=False)
class FollowedPath:
    """A solved path. All arrays are NaN from the first failed step on.

    Attributes
    ----------
    start, end : JointState, before the first step, and after the last step that converged
    result : Dataset, follows ``MACRO_RESULT``
    unknowns : ndarray, shape (steps, n), m
    slipping : ndarray, shape (steps, points), share of the pressure that slips in the step
    dissipated : ndarray, shape (steps, points), loss by slip, J/m²
    """

    problem: CutProblem
    start: JointState
    end: JointState
    result: Dataset
    unknowns: np.ndarray
    slipping: np.ndarray
    dissipated: np.ndarray

    def changes(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Change of unknowns, (n,), and jump, (3, points), m, in every step that converged."""
        count = int(np.count_nonzero(self.result["converged"].values == 1))
        u = np.diff(self.unknowns[:count], axis=0, prepend=self.start.unknowns[None])
        if not self.problem.joints:
            return [(moved, self.start.jump) for moved in u]
        jump = np.swapaxes(self.result["jump"].values[:count], 1, 2)
        opened = np.diff(jump, axis=0, prepend=self.start.whole_jump[None])
        return list(zip(u, opened, strict=True))


def follow(
    prepared: PreparedStructure,
    load_factor: float | np.ndarray,
    *,
    after: JointState | None = None,
    near: FollowedPath | None = None,
    note: Callable[[int, JointState], object] | None = None,
) -> FollowedPath:
    """Follow factors of the load cases, a row for each step, from rest or from a state.

    Bolts are tightened where the first factor changes, and locked elsewhere. A path ends with its
    first failure.

    Parameters
    ----------
    load_factor : float or ndarray, shape (steps,) or (steps, cases)
    after : JointState, optional, the end of an earlier path, maybe under other loads
    near : FollowedPath, optional, the same steps under other laws, as initial guesses
    note : callable, optional
        Called as ``note(step, state)`` after every step that converged.

    Raises
    ------
    CaseError
        If load factors do not fit the load cases, or do not tighten the bolts, or the state belongs
        to another structure.
    ConvergenceError
        If a step gains energy; see :func:`~multiscale.laws.interface_law.advance_state`.
    """
    # check factors and state
    problem, method = prepared.problem, prepared.method
    factors, law, bolts = _load_factors(problem, load_factor), problem.law, problem.bolts
    if bolts and not np.all(factors[:, 0] > 0.0):
        raise CaseError(
            f"the first load case tightens the bolts, and its factor must be positive at every "
            f"step, got {factors[:, 0].min():g}"
        )
    start = state = after or JointState.at_rest(problem)
    sizes, expected = (state.unknowns.size, state.jump.shape[1]), (problem.n, problem.weight.size)
    if sizes != expected:
        raise CaseError(
            f"the earlier path has {sizes[0]} unknowns and {sizes[1]} points of joints, where the "
            f"structure has {expected[0]} and {expected[1]}; cut it as before"
        )

    # first guesses, and forces of the bolts
    changes = near.changes() if near else []
    pulls = np.array([bolt.pull(problem.n) for bolt in bolts]).reshape(-1, problem.n)
    stiffness, preload = (
        np.array([getattr(bolt, name) for bolt in bolts]) for name in ("stiffness", "preload")
    )
    force, largest = state.pull - stiffness * (pulls @ state.unknowns), 0.0
    columns: list[dict[str, Any]] = []
    unknowns = np.full((len(factors), problem.n), np.nan)
    slipping, dissipated = np.full((2, len(factors), problem.weight.size), np.nan)
    for step, factor in enumerate(factors):
        # solve the step
        locks = bool(bolts) and factor[0] == state.tightening
        solver = prepared.locked if locks else prepared.tightened
        acting = np.append(factor, state.pull - factor[0] * preload) if locks else factor  # (1)
        answer = solver.step(state, acting, changes[step] if step < len(changes) else None)
        column = answer.report | {"displacement": problem.displacement(answer.unknowns)}
        if problem.joints:
            column |= {"jump": (state.slid + answer.jump).T, "traction": answer.traction.T}

        # forces of the bolts
        if bolts and column["converged"]:
            stretched = -stiffness * (pulls @ answer.unknowns)
            force = state.pull + stretched if locks else factor[0] * preload
            largest = max(largest, float(np.abs(force).max()))
            unloaded = np.flatnonzero(force <= NO_FORCE * largest)
            if unloaded.size:
                names = " and ".join(bolts[place].name for place in unloaded)
                reason = f"the force of {names} falls to zero under the load; tighten it "
                column |= {"converged": 0, "failure": f"{reason}more, or reduce the load"}
        elif locks:
            opened = _explain_opening(problem, factor, state.pressure, force)
            column["failure"] = opened or column["failure"]
        columns.append(column | ({"bolt_force": force} if bolts else {}))
        if not column["converged"]:
            break

        # commit the step
        state, account = state.advance(law, answer.unknowns, answer.jump, answer.traction)
        if bolts and not locks:
            state = replace(state, tightening=float(factor[0]), pull=force - stretched)
        unknowns[step], dissipated[step] = answer.unknowns, account.dissipated
        slipping[step] = sliding_share(law, answer.jump, account)
        if note is not None:
            note(step, state)
        if method.after_step is not None:
            method.after_step()
    result = _assemble_result(problem, factors, columns, solver.attributes)
    return FollowedPath(problem, start, state, result, unknowns, slipping, dissipated)


def sliding_share(law: InterfaceLaw, jump: np.ndarray, account: Sliding) -> np.ndarray:
    """Share of the pressure of every point that slips in a step."""
    reached = law.slipping_load(jump, account.state)
    return np.where(np.abs(reached - account.slipping) <= ALIKE, reached, account.slipping)


def _load_factors(problem: CutProblem, load_factor: float | np.ndarray) -> np.ndarray:
    factors = np.asarray(load_factor, dtype=float)
    cases = problem.n_cases
    if factors.ndim < 2 and cases == 1:
        factors = factors.reshape(-1, 1)
    if factors.ndim != 2 or factors.shape[1] != cases or not np.isfinite(factors).all():
        raise CaseError(
            f"load_factor must have a finite column for each of {cases} load cases, got shape "
            f"{np.shape(load_factor)}"
        )
    return factors


def _explain_opening(
    problem: CutProblem, factor: np.ndarray, pressure: np.ndarray, tension: np.ndarray
) -> str:
    """Explain that a load opens faces clamped by bolts of given tensions, N; empty if not."""
    load = problem.load(factor)
    slide = find_slide(problem, load, pressure)
    if slide is None or slide.joints:
        return ""
    force = np.bincount(problem.places()[1], load, minlength=3)  # the forces of bolts cancel
    along = ", ".join(f"{1e-3 * amount:.4g}" for amount in force)
    bolts = ", ".join(f"{1e-3 * amount:.4g}" for amount in tension)
    return (
        f"the load opens the clamped faces: it is {along} kN along x, y and z, and the bolts carry "
        f"{bolts} kN at the step before; tighten the bolts more, or reduce the load"
    )


def _assemble_result(
    problem: CutProblem,
    factors: np.ndarray,
    columns: list[dict[str, Any]],
    attributes: Mapping[str, int | str],
) -> Dataset:
    """Join the columns of all steps in a dataset after ``MACRO_RESULT``; failed steps are NaN."""
    # repeat the column of the failed step
    failure = columns[-1]["failure"]
    columns = [*columns, *[columns[-1] | NOT_TRIED] * (len(factors) - len(columns))]
    values: dict[str, Any] = {
        name: np.array([column[name] for column in columns])
        for name in columns[0]
        if name != "failure"
    }
    for name in values.keys() & set(FIELDS):
        values[name][values["converged"] == 0] = np.nan
    if factors.shape[1] == 1:
        values["load_factor"] = factors[:, 0]

    # places of nodes and points
    values["position"] = problem.position
    if "jump" in values:
        values |= {
            "point_position": np.concatenate([face.position for face in problem.joints]),
            "point_area": problem.weight,
            "point_joint": problem.point_joint,
        }
    result = MACRO_RESULT.build(
        values,
        unknowns=problem.n,
        substructures=len(problem.substructures),
        interfaces=len(problem.interfaces),
        **attributes,
    )
    if "jump" in values:
        result = result.assign_coords(direction=list(COMPONENTS))
    failed = np.flatnonzero(values["converged"] == 0)
    if failed.size:
        result = result.assign_attrs(failure=f"the steps end before step {failed[0]}: {failure}")
    return result.assign_coords(component=["x", "y", "z"])
