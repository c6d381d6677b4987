r"""A cut structure condensed onto what its joints, bolts and neighbours touch.

With the kept unknowns b of a substructure and those inside it, i, a displacement under loads is

.. math:: u_i = -K_{ii}^{-1} K_{ib} u_b + K_{ii}^{-1} f_i \lambda,    \tag{1}

so that constraint modes and modes of the loads span it for all laws of the joints and forces of the
bolts. Modes of both kinds do no work on each other.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from multiscale.errors import CaseError
from multiscale.fe.condensation import CondensedStiffness, condense_body
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.substructures.cut_bodies import cut_assembly
from multiscale.macro.substructures.problem import CutProblem, Substructure, expand_numbers
from multiscale.macro.substructures.stepping import Method
from multiscale.numerics.factorisation import on_diagonal
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = ["DENSE", "CondensedProblem", "condense_assembly", "condense_problem"]

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
