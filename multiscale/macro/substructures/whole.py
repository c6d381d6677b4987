r"""The structure in one piece: assembled, condensed onto what its joints touch, and solved.

With the kept unknowns b of a substructure and those inside it, i, a displacement under loads is

.. math:: u_i = -K_{ii}^{-1} K_{ib} u_b + K_{ii}^{-1} f_i \lambda,    \tag{1}

so that constraint modes and modes of the loads span it for all laws of the joints and forces of the
bolts. Modes of both kinds do no work on each other.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import csr_array, vstack

from multiscale.errors import CaseError
from multiscale.fe.condensation import CondensedStiffness, condense_body
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.monolithic import Assembled
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.cut import cut_assembly
from multiscale.macro.substructures.problem import CutProblem, Substructure, expand_numbers
from multiscale.macro.substructures.stepping import JointState, Method, StepAnswer
from multiscale.numerics.factorisation import on_diagonal
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = [
    "DENSE",
    "AssembledNewton",
    "CondensedProblem",
    "assemble",
    "condense_assembly",
    "condense_problem",
    "solve_whole",
    "stack_jumps",
]

DENSE = 1500
"""Kept unknowns up to which bodies are condensed onto them: every Newton step then factorises a
full matrix of this size in place of the sparse one of the whole."""

SAME = 1e-12
"""Work of a combination of loads on itself, relative to the work of each, that is rounding."""

UNMOVED = 3
"""Component of unknowns that do not move with a rigid body."""


@dataclass(frozen=True, eq=False)
class CondensedProblem:
    """A problem of few unknowns, and the way back.

    Attributes
    ----------
    whole, small : CutProblem
        The same joints and bolts; every unknown of the small one is a node, along x. Both are
        one object where nothing is condensed.
    insides : sequence of CondensedStiffness, of each substructure
    modes : sequence of ndarray, shape (unknowns inside, modes)
        Displacement inside each substructure by the modes of its loads, which follow the kept
        unknowns, dimensionless.
    """

    whole: CutProblem
    small: CutProblem
    insides: Sequence[CondensedStiffness] = ()
    modes: Sequence[np.ndarray] = ()

    def keep(self, u: np.ndarray) -> np.ndarray:
        """Unknowns of the small problem, shape (small.n,), from all of them, (whole.n,), m."""
        if self.small is self.whole:
            return u
        small = np.zeros(self.small.n)
        for large, part, inside, modes in self._parts():
            moved, k = u[large.unknown], large.stiffness.diagonal().mean()
            amplitude = modes.T @ (large.stiffness @ moved)[inside.split.inside] / k
            small[part.unknown] = np.concatenate([moved[inside.split.edge], amplitude])
        return small

    def expand(self, small: np.ndarray) -> np.ndarray:
        """All unknowns, shape (whole.n, ...), from the unknowns of the small problem, m."""
        if self.small is self.whole:
            return small
        u = np.zeros((self.whole.n, *small.shape[1:]))
        for large, part, inside, modes in self._parts():
            split = inside.split
            edge, amplitude = np.split(small[part.unknown], [split.edge.size])
            u[large.unknown[split.edge]] = edge
            u[large.unknown[split.inside]] = modes @ amplitude - inside.solve(inside.back @ edge)
        return u

    def with_loads(self, load: np.ndarray) -> "CondensedProblem":
        """Return the problem with further load cases, shape (whole.n, cases), N, after its own."""
        whole = self.whole
        share = load / whole.shares[:, None]
        parts = [
            replace(part, load=np.column_stack([part.load, share[part.unknown]]))
            for part in whole.substructures
        ]
        problem = replace(whole, substructures=tuple(parts))
        condensed = self.small is not whole
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

    def _parts(self) -> Iterator[tuple[Any, ...]]:
        """Each substructure, large and small, its condensation, and its modes."""
        parts = self.whole.substructures, self.small.substructures
        return zip(*parts, self.insides, self.modes, strict=True)


def condense_assembly(assembly: Assembly, method: Method) -> CondensedProblem:
    """Cut an assembly, and condense its bodies once for all paths if its method does so.

    Raises
    ------
    CaseError
        If a law is one of rigid contact, which has no stiffness, or as :func:`cut_assembly`.
    """
    if not all(interface.law.compliant for interface in assembly.interfaces):
        raise CaseError(
            "rigid contact has no stiffness to measure; solve the cut assembly by solve_latin"
        )
    problem = cut_assembly(assembly, method.parts)
    return condense_problem(problem) if method.condenses else CondensedProblem(problem, problem)


def condense_problem(
    problem: CutProblem,
    kept: Sequence[int] = (),
    *,
    largest: int | None = None,
    insides: Sequence[CondensedStiffness] = (),
) -> CondensedProblem:
    """Condense each substructure, unless joints are missing or too many unknowns would be kept."""
    parts, wanted = problem.substructures, problem.shares > 1.0
    wanted[[*kept, *(end for bolt in problem.bolts for end in bolt.unknown)]] = True
    keeps = [wanted[part.unknown] for part in parts]
    for joint in problem.joints:
        for side, trace in zip(joint.sides, joint.trace, strict=True):
            keeps[side][trace.indices] = True
    left = np.unique(
        np.concatenate([part.unknown[keep] for part, keep in zip(parts, keeps, strict=True)])
    )
    little = problem.n - left.size <= problem.n_cases * len(parts)  # modes may be as many
    if not problem.joints or left.size > (DENSE if largest is None else largest) or little:
        return CondensedProblem(problem, problem)
    insides = insides or [
        condense_body(part.stiffness, np.flatnonzero(keep), name="the stiffness of the structure")
        for part, keep in zip(parts, keeps, strict=True)
    ]
    return _reduce(problem, insides)


def _reduce(problem: CutProblem, insides: Sequence[CondensedStiffness]) -> CondensedProblem:
    """Put the condensed substructures and the modes of their loads together."""
    parts = problem.substructures
    edges = [inside.split.edge for inside in insides]
    left = np.unique(
        np.concatenate([part.unknown[edge] for part, edge in zip(parts, edges, strict=True)])
    )
    number = np.full(problem.n, -1)
    number[left] = np.arange(left.size)
    modes, small, last = [], [], left.size
    for part, edge, inside in zip(parts, edges, insides, strict=True):
        motion, load = _load_modes(inside, part)
        stiffness = [inside.blocks[0], np.eye(load.shape[0]) * part.stiffness.diagonal().mean()]
        new = last + np.arange(load.shape[0])
        last += new.size
        nowhere = np.tile(part.position.mean(axis=0), (new.size, 1))
        small.append(
            Substructure(
                on_diagonal(stiffness),
                np.concatenate([inside.reduce(part.load), load]),
                np.concatenate([number[part.unknown[edge]], new]),
                np.concatenate([part.position[edge], nowhere]),
                np.concatenate([part.component[edge], np.full(new.size, UNMOVED)]),
            )
        )
        modes.append(motion)
    position = np.zeros((last, 3))
    for part in small:
        position[part.unknown] = part.position
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
    reduced = CutProblem(tuple(small), position, expand_numbers(place), joints, bolts)
    return CondensedProblem(problem, reduced, insides, modes)


def _load_modes(condensed: CondensedStiffness, part: Substructure) -> tuple[np.ndarray, np.ndarray]:
    """Modes of the loads inside, (inside, modes), and the forces of the loads on them, N.

    Each mode has the mean stiffness of the unknowns of the substructure.
    """
    force = part.load[condensed.split.inside]
    moved = condensed.solve(force)
    work = force.T @ moved
    size = np.sqrt(work.diagonal())
    acts = size > 0.0
    share, vector = np.linalg.eigh(work[np.ix_(acts, acts)] / np.outer(size[acts], size[acts]))
    vector = vector[:, share > SAME] / size[acts, None] / np.sqrt(share[share > SAME])
    vector *= np.sqrt(part.stiffness.diagonal().mean())
    return moved[:, acts] @ vector, vector.T @ work[acts]


def _extend(trace: csr_array, edge: np.ndarray, n: int) -> csr_array:
    """Trace of the kept unknowns, among all of the small substructure."""
    few = csr_array(trace[:, edge])
    return csr_array((few.data, few.indices, few.indptr), shape=(few.shape[0], n))


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
