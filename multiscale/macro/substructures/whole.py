r"""The whole structure: assembled, condensed onto the unknowns of its joints, and solved.

Constraint modes and modes of the loads span the displacement of the inside unknowns i:

.. math:: u_i = -K_{ii}^{-1} K_{ib} u_b + K_{ii}^{-1} f_i \lambda.    \tag{1}
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import csr_array

from multiscale.errors import CaseError
from multiscale.fe.elasticity import CondensedStiffness, condense_body
from multiscale.fe.multigrid import Multigrid
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.monolithic import Assembled, LinearSolver, factorise_joined
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.cut import cut_assembly
from multiscale.macro.substructures.problem import CutProblem, Substructure, expand_numbers
from multiscale.macro.substructures.stepping import JointState, Method, StepAnswer
from multiscale.numerics.factorisation import on_diagonal
from multiscale.schema import MACRO_RESULT, Dataset

DENSE = 1500
"""Boundary unknowns up to which bodies are condensed: every Newton step then factorises a dense
matrix of this size in place of the sparse matrix of the whole."""

SAME = 1e-12
"""Eigenvalue of the work of normalised loads on each other up to which it is rounding."""

UNMOVED = 3
"""Component of unknowns that do not move with a rigid body."""


@dataclass(frozen=True, eq=False)
class CondensedProblem:
    """A problem of few unknowns, and the transformation to the whole problem.

    Attributes
    ----------
    whole, small : CutProblem
        Both have the same joints and bolts; every unknown of the small problem is a node, along x.
        They are the same object if nothing is condensed.
    insides : sequence of CondensedStiffness, of each substructure
    modes : sequence of ndarray, shape (unknowns inside, modes)
        Displacement inside each substructure by the modes of its loads, dimensionless. Their
        amplitudes follow the boundary unknowns.
    """

    whole: CutProblem
    small: CutProblem
    insides: Sequence[CondensedStiffness] = ()
    modes: Sequence[np.ndarray] = ()

    def expand(self, small: np.ndarray) -> np.ndarray:
        """Unknowns of the whole, shape (whole.n, ...), from the small problem, m."""
        if self.small is self.whole:
            return small
        u = np.zeros((self.whole.n, *small.shape[1:]))
        for large, reduced, inside, modes in self._substructures():
            split = inside.split
            edge, amplitude = np.split(small[reduced.unknown], [split.edge.size])
            u[large.unknown[split.edge]] = edge
            u[large.unknown[split.inside]] = modes @ amplitude - inside.solve(inside.back @ edge)
        return u

    def with_loads(self, load: np.ndarray) -> "CondensedProblem":
        """Return the problem with additional load cases at the end, shape (whole.n, cases), N."""
        problem, condensed = self.whole.with_loads(load), self.small is not self.whole
        return _reduce(problem, self.insides) if condensed else CondensedProblem(problem, problem)

    def restore(self, result: Dataset) -> Dataset:
        """Return a result of the small problem with the displacement of all nodes."""
        if self.small is self.whole:
            return result
        solved = result["converged"].values == 1
        u = self.expand(result["displacement"].values[solved, :, 0].T)  # a node for each unknown
        displacement = np.full((solved.size, *self.whole.position.shape), np.nan)
        displacement[solved] = (self.whole.expansion @ u).T.reshape(-1, *self.whole.position.shape)
        values = {"displacement": displacement, "position": self.whole.position}
        restored = MACRO_RESULT.assign(result.drop_dims("node"), values)
        return restored.assign_attrs(unknowns=self.whole.n).assign_coords(
            node=range(len(self.whole.position))
        )

    def _substructures(self) -> Iterator[tuple[Any, ...]]:
        """Iterate over substructures, whole and condensed, their condensations and modes."""
        both = self.whole.substructures, self.small.substructures
        return zip(*both, self.insides, self.modes, strict=True)


def condense_assembly(assembly: Assembly, method: Method) -> CondensedProblem:
    """Cut an assembly, and condense its bodies once for all paths if the method condenses.

    Raises
    ------
    CaseError
        If a law is rigid contact, which has no stiffness, or as :func:`cut_assembly`.
    """
    if not all(interface.law.compliant for interface in assembly.interfaces):
        raise CaseError(
            "rigid contact has no stiffness to measure; solve the cut assembly by solve_latin"
        )
    return condense_problem(cut_assembly(assembly, method.parts), largest=method.condensed)


def condense_problem(
    problem: CutProblem,
    boundary: Sequence[int] = (),
    *,
    largest: int = DENSE,
    insides: Sequence[CondensedStiffness] = (),
) -> CondensedProblem:
    """Condense each substructure onto shared unknowns, joints, bolts and given unknowns."""
    # boundary unknowns of the structure, then of each substructure
    substructures, shared = problem.substructures, problem.shares > 1.0
    shared[[*boundary, *(end for bolt in problem.bolts for end in bolt.unknown)]] = True
    edges = [shared[substructure.unknown] for substructure in substructures]
    for joint in problem.joints:
        for side, trace in zip(joint.sides, joint.trace, strict=True):
            edges[side][trace.indices] = True
    size = _boundary_unknowns(problem, edges).size
    little = problem.n - size <= problem.n_cases * len(substructures)  # modes may be as many
    if not problem.joints or problem.n_links or size > largest or little:
        return CondensedProblem(problem, problem)
    insides = insides or [
        condense_body(each.stiffness, np.flatnonzero(edge), name="the stiffness of the structure")
        for each, edge in zip(substructures, edges, strict=True)
    ]
    return _reduce(problem, insides)


def _boundary_unknowns(problem: CutProblem, edges: Sequence[np.ndarray]) -> np.ndarray:
    """Unknowns of the structure that are boundary unknowns of a substructure, rising."""
    pairs = zip(problem.substructures, edges, strict=True)
    return np.unique(np.concatenate([each.unknown[edge] for each, edge in pairs]))


def _reduce(problem: CutProblem, insides: Sequence[CondensedStiffness]) -> CondensedProblem:
    """Assemble the problem of the condensed substructures and the modes of their loads."""
    # number the boundary unknowns
    edges = [inside.split.edge for inside in insides]
    boundary = _boundary_unknowns(problem, edges)
    number = np.full(problem.n, -1)
    number[boundary] = np.arange(boundary.size)

    # condensed substructures, with the amplitudes of the modes as further unknowns
    modes, small, last = [], [], boundary.size
    for large, edge, inside in zip(problem.substructures, edges, insides, strict=True):
        motion, load = _load_modes(inside, large)
        stiffness = [inside.blocks[0], np.eye(load.shape[0]) * large.stiffness.diagonal().mean()]
        new = last + np.arange(load.shape[0])
        last += new.size
        centre = np.tile(large.position.mean(axis=0), (new.size, 1))
        small.append(
            Substructure(
                on_diagonal(stiffness),
                np.concatenate([inside.reduce(large.load), load]),
                np.concatenate([number[large.unknown[edge]], new]),
                np.concatenate([large.position[edge], centre]),
                np.concatenate([large.component[edge], np.full(new.size, UNMOVED)]),
            )
        )
        modes.append(motion)

    # nodes, joints and bolts
    position = np.zeros((last, 3))
    for reduced in small:
        position[reduced.unknown] = reduced.position
    place = np.full((last, 3), -1)
    place[:, 0] = np.arange(last)
    joints = tuple(
        replace(
            joint,
            trace=tuple(
                _extend(trace, edges[side], small[side].n)
                for side, trace in zip(joint.sides, joint.trace, strict=True)
            ),
        )
        for joint in problem.joints
    )
    bolts = tuple(
        replace(bolt, unknown=tuple(number[list(bolt.unknown)].tolist())) for bolt in problem.bolts
    )
    condensed = CutProblem(tuple(small), position, expand_numbers(place), joints, bolts)
    return CondensedProblem(problem, condensed, insides, modes)


def _load_modes(
    condensed: CondensedStiffness, substructure: Substructure
) -> tuple[np.ndarray, np.ndarray]:
    """Modes of the loads inside, (inside, modes), and the forces of the loads on them, N."""
    force = substructure.load[condensed.split.inside]
    moved = condensed.solve(force)
    work = force.T @ moved
    size = np.sqrt(work.diagonal())
    acts = size > 0.0
    share, vector = np.linalg.eigh(work[np.ix_(acts, acts)] / np.outer(size[acts], size[acts]))
    vector = vector[:, share > SAME] / size[acts, None] / np.sqrt(share[share > SAME])
    vector *= np.sqrt(substructure.stiffness.diagonal().mean())
    return moved[:, acts] @ vector, vector.T @ work[acts]


def _extend(trace: csr_array, edge: np.ndarray, n: int) -> csr_array:
    """Trace of the boundary unknowns in the n unknowns of a condensed substructure."""
    few = csr_array(trace[:, edge])
    return csr_array((few.data, few.indices, few.indptr), shape=(few.shape[0], n))


def assemble(problem: CutProblem, linear: LinearSolver = factorise_joined) -> Assembled:
    """Assemble the substructures of a problem.

    Parameters
    ----------
    problem : CutProblem, without its links, if any
    linear : callable, solver of its matrices

    Examples
    --------
    >>> from multiscale.laws.bulk import Elastic
    >>> from multiscale.macro import Assembly, Body
    >>> from multiscale.macro.substructures import cut_assembly
    >>> from multiscale.fe.mesh_file import box_mesh
    >>> body = Body(box_mesh((1.0, 1.0, 1.0), (2, 1, 1)), Elastic(1e9, 0.3))
    >>> assemble(cut_assembly(Assembly((body,)), (2, 1))).stiffness.shape
    (36, 36)
    """
    substructures, place = problem.substructures, problem.placement
    K = place.T @ on_diagonal(each.stiffness for each in substructures) @ place
    load = place.T @ np.concatenate([each.load for each in substructures])
    return Assembled(csr_array(K), load, problem.jump, problem.weight, problem.motions, linear)


@dataclass(frozen=True)
class AssembledNewton(Method):
    """Newton's method on the whole, uncut: the fastest where its factors fit into memory.

    It supports all laws but rigid contact, on one process, and no links; see
    :func:`~multiscale.macro.monolithic.solve_interface`. The result does not depend on the cut.
    """

    name: ClassVar[str] = "Newton's method on the whole"
    condensed: ClassVar[int] = DENSE

    @property
    def coarse(self) -> bool:
        """False: nothing is cut."""
        return False

    def start(self, problem: CutProblem) -> "_WholeSolver":
        """Assemble a structure."""
        return _WholeSolver(problem, self)

    def solve(self, problem: CutProblem, load_factor: float | np.ndarray = 1.0) -> Dataset:
        """Solve at factors of the load cases, from rest, with the bodies condensed."""
        bodies = condense_problem(problem, largest=self.condensed)
        return bodies.restore(super().solve(bodies.small, load_factor))


@dataclass(frozen=True)
class MultigridNewton(AssembledNewton):
    """Newton's method on the whole with iterative directions, for bodies of 1e5 to 1e6 unknowns.

    The tangent of bodies and joints is preconditioned by smoothed aggregation with the rigid
    motions of the bodies; see :class:`~multiscale.fe.multigrid.Multigrid`. A direction with a
    residual above 1e-10 is not used.
    """

    name: ClassVar[str] = "Newton's method with multigrid"
    condensed: ClassVar[int] = 0

    def linear(self, problem: CutProblem) -> Multigrid:
        """Return the solver of the matrices of a structure."""
        return Multigrid(*problem.places(), problem.motions)


class _WholeSolver:
    """Newton's method on a structure, step by step."""

    def __init__(self, problem: CutProblem, method: AssembledNewton) -> None:
        if problem.n_links:
            raise CaseError("bodies must not have links; solve_static is for structures of links")
        if not all(joint.law and joint.law.compliant for joint in problem.joints):
            raise CaseError(
                "a joint needs a law that gives the traction of a jump; solve_latin supports rigid "
                "contact"
            )
        self.problem, self.method = problem, method
        self.structure = assemble(problem, method.linear(problem))
        self.attributes: dict[str, int] = {}

    def step(
        self,
        state: JointState,
        factor: np.ndarray,
        near: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> StepAnswer:
        """Solve a step from the change in a near path, else from the committed state."""
        clock, law = perf_counter(), self.problem.law
        starts = [(state.unknowns, state.jump)]
        if near is not None:
            starts.insert(0, (state.unknowns + near[0], state.jump + near[1]))
        for start, jump in starts:
            solution = self.structure.solve(
                law,
                factor,
                start=start,
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
        return StepAnswer(solution.value, solution.jump, traction, report)
