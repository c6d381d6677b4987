"""The structure that the substructures make, in one piece, and Newton's method for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter
from typing import Any, ClassVar

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array, vstack

from multiscale.convergence import Status
from multiscale.errors import CaseError
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.monolithic import (
    FlexibleBodies,
    InterfaceSolution,
    prepare_flexible,
    solve_interface,
)
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.condensed import condense_problem
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stack import FULL
from multiscale.macro.substructures.state import JointState
from multiscale.macro.substructures.stepping import Method, StepAnswer
from multiscale.numerics.factorisation import Solve, factorise, on_diagonal
from multiscale.schema import Dataset

__all__ = ["Assembled", "AssembledNewton", "assemble", "solve_whole", "stack_jumps"]

FEW = 2000
"""Unknowns up to which the stiffness is taken as a full matrix."""


@dataclass(frozen=True, eq=False)
class Assembled:
    """Matrices of a whole structure without links.

    Attributes
    ----------
    stiffness : csr_array, shape (n, n), stiffness of all linear parts, N/m
    load : ndarray or csr_array, shape (n, cases), N
    jump : csr_array, shape (3 points, n)
        Normal jump at all points of all joints, then each tangential one.
    weight : ndarray, shape (points,), area of these points, m²
    motions : ndarray, shape (n, motions), rigid motions of the bodies, m
    """

    stiffness: csr_array
    load: np.ndarray | csr_array
    jump: csr_array
    weight: np.ndarray
    motions: np.ndarray

    def solve(self, law: InterfaceLaw, factor: np.ndarray, **options: Any) -> InterfaceSolution:
        """Find the unknowns, m, for factors of the load cases, shape (cases,).

        Options are those of :func:`~multiscale.macro.monolithic.solve_interface`.
        """
        K, load = self.stiffness if self._full is None else self._full, self.load @ factor
        if not self.weight.size:
            u = self._solve(load)
            residual = float(norm(K @ u - load)) / (float(norm(load)) or 1.0)
            return InterfaceSolution(u, Status.CONVERGED, (1.0, residual), jump=np.zeros((3, 0)))
        options |= {"flexible": self._flexible}
        return solve_interface(K, load, self.jump, self.weight, law, **options)

    @cached_property
    def _solve(self) -> Solve:
        """Solve with the stiffness."""
        return factorise(self.stiffness, name="the stiffness of the structure")

    @cached_property
    def _full(self) -> np.ndarray | None:
        """Stiffness as a full matrix, if few of its entries are zero or it has few."""
        n = self.load.shape[0]
        few = n <= FEW or self.stiffness.nnz > FULL * n**2
        return self.stiffness.toarray() if few else None

    @cached_property
    def _flexible(self) -> FlexibleBodies | None:
        """Bodies whose jumps are the unknowns; none if sparse, or if parts of them move freely."""
        if self._full is None:
            return None
        return prepare_flexible(self._full, self.jump, self.weight, self.motions)


def assemble(problem: CutProblem) -> Assembled:
    """Add up the substructures of a problem.

    Parameters
    ----------
    problem : CutProblem, its links, if any, are left out

    Examples
    --------
    >>> from multiscale.laws.bulk import Elastic
    >>> from multiscale.macro import Assembly, Body
    >>> from multiscale.macro.substructures import cut_assembly
    >>> from multiscale.fe.boxes import box_mesh
    >>> body = Body(box_mesh((1.0, 1.0, 1.0), (2, 1, 1)), Elastic(1e9, 0.3))
    >>> assemble(cut_assembly(Assembly((body,)), (2, 1))).stiffness.shape
    (36, 36)
    """
    parts, n = problem.substructures, problem.n
    place = _placement(np.concatenate([part.unknown for part in parts]), n)
    K = place.T @ on_diagonal(part.stiffness for part in parts) @ place
    load = place.T @ np.concatenate([part.load for part in parts])
    jumps = []
    for joint in problem.joints:
        first, second = (
            trace @ _placement(parts[side].unknown, n)
            for side, trace in zip(joint.sides, joint.trace, strict=True)
        )
        jumps.append(csr_array(second - first))
    return Assembled(csr_array(K), load, stack_jumps(jumps, n), problem.weight, problem.motions)


def stack_jumps(jumps: Sequence[csr_array], n: int) -> csr_array:
    """Join the normal jumps of all joints, then each tangential one, from n unknowns."""
    parts = [(jump, jump.shape[0] // 3) for jump in jumps]
    blocks = [jump[k * size : (k + 1) * size] for k in range(3) for jump, size in parts]
    return csr_array(vstack([csr_array((0, n)), *blocks]))


def _placement(unknown: np.ndarray, n: int) -> csr_array:
    """Pick some unknowns out of all n unknowns of the structure."""
    return csr_array((np.ones(unknown.size), (np.arange(unknown.size), unknown)), (unknown.size, n))


@dataclass(frozen=True)
class AssembledNewton(Method):
    """Newton's method on the whole, uncut: the fastest where its factors fit into memory.

    It takes all laws but rigid contact, on one process; see :func:`solve_whole`.
    """

    name: ClassVar[str] = "Newton's method on the whole"
    condenses: ClassVar[bool] = True

    def start(self, problem: CutProblem) -> "_WholeSolver":
        """Condense and assemble a structure."""
        return _WholeSolver(problem, self)


def solve_whole(
    problem: CutProblem,
    load_factor: float | np.ndarray = 1.0,
    **options: Any,
) -> Dataset:
    """Solve elastic bodies in one piece, with the same answer for every cut.

    Parameters
    ----------
    problem, load_factor
        As of :func:`solve_latin`; :func:`multiscale.macro.solve_static` takes links.
    options
        Of :class:`AssembledNewton`; see :func:`~multiscale.macro.monolithic.solve_interface`.

    Returns
    -------
    Dataset, as of :func:`solve_latin`

    Raises
    ------
    CaseError
        If load factors do not fit the load cases, there are links, or a joint is one of rigid
        contact.
    """
    return AssembledNewton(**options).solve(problem, load_factor)


class _WholeSolver:
    """Newton's method on a structure whose bodies are condensed onto its joints, if few."""

    def __init__(self, problem: CutProblem, method: AssembledNewton) -> None:
        if problem.n_links:
            raise CaseError("links are not solved as bodies in one piece; solve_static takes them")
        if not all(joint.law and joint.law.compliant for joint in problem.joints):
            raise CaseError(
                "a joint needs a law that gives the traction of a jump; solve_latin takes rigid "
                "contact as well"
            )
        self.problem, self.method = problem, method
        self.bodies = condense_problem(problem)
        self.structure = assemble(self.bodies.small)
        self.attributes: dict[str, int] = {}

    def step(
        self,
        state: JointState,
        factor: np.ndarray,
        near: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> StepAnswer:
        """Solve a step as the path that is near, else from where this one stands."""
        clock, law = perf_counter(), self.problem.law
        starts = [(state.unknowns, state.jump)]
        if near is not None:
            starts.insert(0, (state.unknowns + near[0], state.jump + near[1]))
        for start, jump in starts:
            solution = self.structure.solve(
                law,
                factor,
                start=self.bodies.keep(start),
                jump=jump,
                state=state.history,
                max_iterations=self.method.max_iterations,
                tolerance=self.method.tolerance,
            )
            if solution.converged:
                break
        with np.errstate(over="ignore", invalid="ignore"):  # where a failed step may have ended
            traction = law.respond(solution.jump, state.history).traction
        failure = ""
        if not solution.converged:
            load = self.problem.load(factor)
            slide = find_slide(self.problem, load, state.pressure, -traction[0])
            failure = str(slide or solution.status.value)
        report = {
            "converged": int(solution.converged),
            "failure": failure,
            "residual": solution.residuals[-1],
            "iterations": len(solution.residuals) - 1,
            "wall_time": perf_counter() - clock,
        }
        return StepAnswer(self.bodies.expand(solution.value), solution.jump, traction, report)
