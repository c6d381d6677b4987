"""Newton's method for a cut structure of bodies, in one piece."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array

from multiscale.convergence import Solution, Status
from multiscale.errors import CaseError
from multiscale.fe.condensation import condense_body
from multiscale.laws.interface_law import InterfaceLaw, Response
from multiscale.macro.monolithic import solve_interface
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.cut_results import assemble_result, load_factors
from multiscale.macro.substructures.joint_state import advance_state
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.whole_structure import Assembled, assemble
from multiscale.numerics.factorisation import factorise

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["solve_whole"]

DENSE = 1500
"""Unknowns on joints up to which the bodies are condensed onto them: every Newton step then
factorises a full matrix of this size in place of the sparse one of the whole."""


def solve_whole(
    problem: CutProblem,
    load_factor: float | np.ndarray = 1.0,
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 100,
) -> "xr.Dataset":
    """Solve elastic bodies in one piece: the slow twin of LATIN and Newton-Schur on large cuts.

    Parameters
    ----------
    problem, load_factor
        As of :func:`solve_latin`, without links, which :func:`multiscale.macro.solve_static` takes;
        however it is cut, the answer is the same.
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
    solve = _prepare(whole, law, max_iterations=max_iterations, tolerance=tolerance)
    state, before = np.zeros((law.n_state, whole.weight.size)), np.zeros(0)
    u: np.ndarray | None = None
    columns: list[dict[str, Any]] = []
    for factor in factors:
        clock = perf_counter()
        solution = solve(whole.load @ factor, u, state)
        jump = (whole.jump @ solution.value).reshape(3, -1)
        response = law.respond(jump, state)
        failure = ""
        if not solution.converged:
            loads = np.concatenate([part.load @ factor for part in problem.substructures])
            slide = find_slide(problem, loads, before, -response.traction[0])
            failure = str(slide or solution.status.value)
        columns.append(
            {
                "displacement": np.append(solution.value, 0.0)[problem.number[:, :3]],
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
        u, before, state = solution.value, -response.traction[0], law.advance(jump, state)
    return assemble_result(problem, factors, columns)


def _prepare(
    whole: Assembled, law: InterfaceLaw, **limits: Any
) -> Callable[[np.ndarray, np.ndarray | None, np.ndarray], Solution]:
    """Choose how a step is solved: from load, first displacement and state of the joints."""
    K, B = whole.stiffness, whole.jump
    if not whole.weight.size:
        inverse = factorise(K, name="the stiffness of the structure")

        def linear(load: np.ndarray, start: np.ndarray | None, state: np.ndarray) -> Solution:
            u, size = inverse(load), float(norm(load)) or 1.0
            return Solution(u, Status.CONVERGED, (1.0, float(norm(K @ u - load)) / size))

        return linear
    touched = np.unique(B.indices)
    if touched.size > DENSE:
        return lambda load, start, state: solve_interface(
            K, load, B, whole.weight, law, start=start, state=state, **limits
        )
    condensed = condense_body(K, touched, name="the stiffness")
    edge, S = condensed.split.edge, condensed.blocks[0]
    B = csr_array(B[:, edge])

    def on_joints(load: np.ndarray, start: np.ndarray | None, state: np.ndarray) -> Solution:
        begin, force = None if start is None else start[edge], condensed.reduce(load)
        solution = solve_interface(
            S, force, B, whole.weight, law, start=begin, state=state, **limits
        )
        return replace(solution, value=condensed.expand(load, solution.value))

    return on_joints


@dataclass(frozen=True)
class _SideBySide(InterfaceLaw):
    """Laws of interfaces side by side, each with its own points; state rows are those of most."""

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
