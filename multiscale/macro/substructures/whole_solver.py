"""Newton's method for a cut structure of bodies, in one piece."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.interface_law import InterfaceLaw, Response, Sliding
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.condensed_problem import CondensedProblem, condense_problem
from multiscale.macro.substructures.cut_results import assemble_result, load_factors
from multiscale.macro.substructures.joint_state import advance_state, states_after
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.whole_structure import assemble
from multiscale.schema import Dataset

__all__ = ["SideBySide", "solve_whole"]


def solve_whole(
    problem: CutProblem,
    load_factor: float | np.ndarray = 1.0,
    *,
    after: Dataset | None = None,
    near: Dataset | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 100,
    after_step: Callable[[], object] | None = None,
) -> Dataset:
    """Solve elastic bodies in one piece: the slow twin of LATIN and Newton-Schur on large cuts.

    Parameters
    ----------
    problem, load_factor, after
        As of :func:`solve_latin`, without links, which :func:`multiscale.macro.solve_static` takes;
        however it is cut, the answer is the same.
    near : Dataset, optional
        The same steps, and those before, under other laws: each step begins with what this path
        did in it.
    tolerance, max_iterations
        See :func:`~multiscale.macro.monolithic.solve_interface`.
    after_step : callable, optional, called after every step that converged

    Returns
    -------
    Dataset
        As :func:`solve_latin` gives it. A step that did not converge is NaN with ``converged`` 0,
        and the later ones are not tried.

    Raises
    ------
    CaseError
        If load factors do not fit the load cases, there are links, or a joint is one of rigid
        contact.
    ConvergenceError
        If a step wins energy; see :func:`~.joint_state.advance_state`.
    """
    if problem.n_links:
        raise CaseError("links are not solved as bodies in one piece; solve_static takes them")
    if not all(joint.law and joint.law.compliant for joint in problem.joints):
        raise CaseError(
            "a joint needs a law that tells the traction of a jump; solve_latin takes rigid "
            "contact as well"
        )
    factors, bodies = load_factors(problem, load_factor, after), condense_problem(problem)
    whole = assemble(bodies.small)
    law = SideBySide(tuple(joint.law for joint in problem.joints if joint.law), problem.points)
    state, before = law.join(states_after(problem, after)), np.zeros(0)
    u: np.ndarray | None = None
    jump, first = np.zeros((3, law.n_points)), 0
    if after is not None and problem.joints:
        u = bodies.keep(problem.unknowns(after["displacement"].values[-1]))
        jump, before = after["jump"].values[-1].T, -after["traction"].values[-1, :, 0]
        first = after.sizes["step"]
    changes = _changes(problem, bodies, near) if problem.joints else []
    columns: list[dict[str, Any]] = []
    for step, factor in enumerate(factors, start=first):
        clock = perf_counter()
        # tangential jumps of the step alone: sums round away what slides far on a stiff law
        slid, state = jump * np.array([[0.0], [1.0], [1.0]]), law.from_here(state)
        starts = [(u, jump - slid)]
        if step < len(changes):  # as the path that is near, else from where this one stands
            moved, opened = changes[step]
            starts.insert(0, ((0.0 if u is None else u) + moved, jump - slid + opened))
        for start, begin in starts:
            solution = whole.solve(
                law,
                factor,
                start=start,
                jump=begin,
                state=state,
                max_iterations=max_iterations,
                tolerance=tolerance,
            )
            if solution.converged:
                break
        with np.errstate(over="ignore", invalid="ignore"):  # where a failed step may have ended
            response = law.respond(solution.jump, state)
        jump = slid + solution.jump
        failure = ""
        if not solution.converged:
            slide = find_slide(problem, problem.load(factor), before, -response.traction[0])
            failure = str(slide or solution.status.value)
        columns.append(
            {
                "displacement": problem.displacement(bodies.expand(solution.value)),
                **({"jump": jump.T, "traction": response.traction.T} if problem.joints else {}),
                "converged": int(solution.converged),
                "failure": failure,
                "residual": solution.residuals[-1],
                "iterations": len(solution.residuals) - 1,
                "wall_time": perf_counter() - clock,
            }
        )
        if not solution.converged:
            break
        if after_step is not None:
            after_step()
        u, before = solution.value, -response.traction[0]
        state = law.sliding(solution.jump, state).state
    return assemble_result(problem, factors, columns, after)


def _changes(
    problem: CutProblem, bodies: CondensedProblem, near: Dataset | None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Read off how kept unknowns and jumps, (3, points), change in the steps of a path, m."""
    if near is None:
        return []
    solved = near["converged"].values == 1
    u = problem.unknowns(near["displacement"].values[solved])
    jump = np.swapaxes(near["jump"].values[solved], 1, 2)
    pairs = (np.diff(one, axis=0, prepend=np.zeros_like(one[:1])) for one in (u, jump))
    return [(bodies.keep(moved), opened) for moved, opened in zip(*pairs, strict=True)]


@dataclass(frozen=True)
class SideBySide(InterfaceLaw):
    """Laws of interfaces side by side, each at its points, with as many state rows as any has.

    Attributes
    ----------
    laws : sequence of InterfaceLaw
    points : sequence of slice, points of each law, among the points of all
    """

    laws: Sequence[InterfaceLaw]
    points: Sequence[slice]

    @property
    def n_state(self) -> int:  # type: ignore[override]
        """Number of internal variables of a point."""
        return max((law.n_state for law in self.laws), default=0)

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Let every law answer at its points."""
        traction, tangent = np.zeros_like(jump), np.zeros((jump.shape[0], *jump.shape))
        new = np.zeros_like(state)
        for law, at in self._places():
            found = law.respond(jump[:, at], state[: law.n_state, at])
            traction[:, at], tangent[..., at] = found.traction, found.tangent
            new[: law.n_state, at] = found.state
        return Response(traction, tangent, new)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Let every law find the jump at its points."""
        jump, k = np.zeros_like(source), np.broadcast_to(stiffness, source.shape)
        for law, at in self._places():
            jump[:, at] = law.resolvent(source[:, at], k[:, at], state[: law.n_state, at])
        return jump

    def join(self, states: Sequence[np.ndarray]) -> np.ndarray:
        """States of the laws side by side."""
        joined = np.zeros((self.n_state, self.n_points))
        for state, (law, at) in zip(states, self._places(), strict=True):
            joined[: law.n_state, at] = state
        return joined

    def from_here(self, state: np.ndarray) -> np.ndarray:
        """Let every law count tangential jumps from the last."""
        new = np.zeros_like(state)
        for law, at in self._places():
            new[: law.n_state, at] = law.from_here(state[: law.n_state, at])
        return new

    def unsheared(self, state: np.ndarray) -> np.ndarray:
        """Let no law have a tangential traction."""
        new = np.zeros_like(state)
        for law, at in self._places():
            new[: law.n_state, at] = law.unsheared(state[: law.n_state, at])
        return new

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Let every law bound the shear at its points."""
        limit = np.zeros_like(pressure)
        for law, at in self._places():
            limit[at] = law.friction_limit(pressure[at])
        return limit

    def sliding(self, jump: np.ndarray, state: np.ndarray) -> Sliding:
        """Let every law say what a step does at its points, which may not win energy."""
        shares, new = np.zeros((3, self.n_points)), np.zeros_like(state)
        for law, at in self._places():
            own = state[: law.n_state, at]
            new[: law.n_state, at], done = advance_state(law, jump[:, at], own)
            shares[:, at] = done.slipping, done.dissipated, done.stored
        return Sliding(shares[0], shares[1], shares[2], new)

    @property
    def n_points(self) -> int:
        """Number of points of all laws."""
        return int(self.points[-1].stop) if self.points else 0

    def _places(self) -> list[tuple[InterfaceLaw, slice]]:
        """Every law and its points."""
        return list(zip(self.laws, self.points, strict=True))
