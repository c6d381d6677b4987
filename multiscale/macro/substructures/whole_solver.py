"""Newton's method for a cut structure of bodies, in one piece."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array

from multiscale.convergence import Status
from multiscale.errors import CaseError
from multiscale.fe.condensation import CondensedStiffness, condense_body
from multiscale.laws.interface_law import InterfaceLaw, Response
from multiscale.macro.monolithic import (
    FlexibleBodies,
    InterfaceSolution,
    prepare_flexible,
    solve_interface,
)
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.cut_results import assemble_result, check_after, load_factors
from multiscale.macro.substructures.joint_state import advance_state, states_after
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.whole_structure import Assembled, assemble

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["PreparedBodies", "prepare_bodies", "solve_whole"]

DENSE = 1500
"""Unknowns on joints up to which the bodies are condensed onto them: every Newton step then
factorises a full matrix of this size in place of the sparse one of the whole."""


def solve_whole(
    problem: CutProblem,
    load_factor: float | np.ndarray = 1.0,
    *,
    after: "xr.Dataset | None" = None,
    near: "xr.Dataset | None" = None,
    tolerance: float = 1e-10,
    max_iterations: int = 100,
) -> "xr.Dataset":
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
    factors, whole = load_factors(problem, load_factor), assemble(problem)
    law = _SideBySide(
        tuple(joint.law for joint in problem.joints if joint.law),
        tuple(joint.weight.size for joint in problem.joints),
    )
    bodies = prepare_bodies(whole)
    check_after(problem, after)
    state, before = law.join(states_after(problem.joints, after)), np.zeros(0)
    u: np.ndarray | None = None
    jump, first = np.zeros((3, sum(law.points))), 0
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
            solution = bodies.solve(
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
            loads = np.concatenate([part.load @ factor for part in problem.substructures])
            slide = find_slide(problem, loads, before, -response.traction[0])
            failure = str(slide or solution.status.value)
        columns.append(
            {
                "displacement": problem.displacement(bodies.expand(factor, solution.value)),
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
        u, before = solution.value, -response.traction[0]
        state = law.advance(solution.jump, state)
    return assemble_result(problem, factors, columns, after)


def _changes(
    problem: CutProblem, bodies: "PreparedBodies", near: "xr.Dataset | None"
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Read off how kept unknowns and jumps, (3, points), change in the steps of a path, m."""
    if near is None:
        return []
    solved = near["converged"].values == 1
    u = problem.unknowns(near["displacement"].values[solved])
    jump = np.swapaxes(near["jump"].values[solved], 1, 2)
    pairs = (np.diff(one, axis=0, prepend=np.zeros_like(one[:1])) for one in (u, jump))
    return [(bodies.keep(moved), opened) for moved, opened in zip(*pairs, strict=True)]


@dataclass(frozen=True, eq=False)
class PreparedBodies:
    """Bodies factorised once, for many laws, loads, first displacements and states.

    Attributes
    ----------
    whole : Assembled
    condensed : CondensedStiffness, optional
        Their stiffness on kept unknowns; all are kept if not given.
    jump : csr_array, shape (3 points, kept)
        Jump from the kept unknowns.
    load : ndarray, shape (kept, cases)
        Force on them that each load case amounts to, N.
    """

    whole: Assembled
    condensed: CondensedStiffness | None
    jump: csr_array
    load: np.ndarray

    def solve(
        self,
        law: InterfaceLaw,
        factor: np.ndarray,
        *,
        start: np.ndarray | None = None,
        jump: np.ndarray | None = None,
        state: np.ndarray | None = None,
        max_iterations: int = 100,
        tolerance: float = 1e-10,
    ) -> InterfaceSolution:
        """Find the kept unknowns, m, for factors of the load cases, shape (cases,).

        See :func:`~multiscale.macro.monolithic.solve_interface`.
        """
        whole, condensed = self.whole, self.condensed
        if not whole.weight.size:
            u, load = self.expand(factor, np.zeros(0)), whole.load @ factor
            residual = float(norm(whole.stiffness @ u - load)) / (float(norm(load)) or 1.0)
            return InterfaceSolution(
                np.zeros(0), Status.CONVERGED, (1.0, residual), jump=np.zeros((3, 0))
            )
        return solve_interface(
            condensed.blocks[0] if condensed else whole.stiffness,
            self.load @ factor,
            self.jump,
            whole.weight,
            law,
            start=start,
            jump=jump,
            state=state,
            flexible=self.flexible,
            max_iterations=max_iterations,
            tolerance=tolerance,
        )

    @cached_property
    def flexible(self) -> FlexibleBodies | None:
        """Condensed bodies whose jumps are unknowns; none if springs do not hold them."""
        if self.condensed is None:
            return None
        return prepare_flexible(self.condensed.blocks[0], self.jump, self.whole.weight)

    def keep(self, unknowns: np.ndarray) -> np.ndarray:
        """Kept ones of all unknowns, m."""
        return unknowns[self.condensed.split.edge] if self.condensed else unknowns

    def expand(self, factor: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """All unknowns from the kept ones, m."""
        return self.condensed.expand(self.whole.load @ factor, kept) if self.condensed else kept


def prepare_bodies(whole: Assembled, kept: np.ndarray | None = None) -> PreparedBodies:
    """Condense bodies onto unknowns, which are those that joints touch, if these are few.

    Parameters
    ----------
    whole : Assembled
    kept : ndarray of int, optional
        Other unknowns, with those that joints touch among them.

    Raises
    ------
    MultiscaleError
        If a body can move without force while these unknowns are held.
    """
    if kept is None:
        kept = np.unique(whole.jump.indices)
        if kept.size > DENSE:
            return PreparedBodies(whole, None, whole.jump, whole.load)
    condensed = condense_body(whole.stiffness, kept, name="the stiffness of the structure")
    jump = csr_array(whole.jump[:, kept])
    return PreparedBodies(whole, condensed, jump, condensed.reduce(whole.load))


@dataclass(frozen=True)
class _SideBySide(InterfaceLaw):
    """Laws of interfaces side by side, each at its points, with as many state rows as any has."""

    laws: Sequence[InterfaceLaw]
    points: Sequence[int]

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
        joined = np.zeros((self.n_state, sum(self.points)))
        for state, (law, at) in zip(states, self._places(), strict=True):
            joined[: law.n_state, at] = state
        return joined

    def from_here(self, state: np.ndarray) -> np.ndarray:
        """Let every law count tangential jumps from the last."""
        new = np.zeros_like(state)
        for law, at in self._places():
            new[: law.n_state, at] = law.from_here(state[: law.n_state, at])
        return new

    def advance(self, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return the state after a step, which may not win energy."""
        new = np.zeros_like(state)
        for law, at in self._places():
            new[: law.n_state, at], _ = advance_state(law, jump[:, at], state[: law.n_state, at])
        return new

    def _places(self) -> list[tuple[InterfaceLaw, slice]]:
        """Every law and its points."""
        ends = pairwise(np.cumsum([0, *self.points]))
        return [(law, slice(a, b)) for law, (a, b) in zip(self.laws, ends, strict=True)]
