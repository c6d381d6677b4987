"""A path of loads that has been solved, with the structure that measures its displacement."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import block_array, csr_array, diags_array

from multiscale.errors import CaseError, MultiscaleError
from multiscale.laws.side_by_side import SideBySide
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.interface_newton import FLOOR, face_stiffness
from multiscale.macro.substructures.bolted_path import Method, follow_bolts, lock_bolts
from multiscale.macro.substructures.condensed_problem import CondensedProblem, condense_problem
from multiscale.macro.substructures.cut_bodies import cut_assembly
from multiscale.macro.substructures.joint_state import replay
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stack import Factors
from multiscale.macro.substructures.whole_structure import Assembled, assemble
from multiscale.numerics.factorisation import Solve, factorise
from multiscale.schema import Dataset

__all__ = ["FollowedPath", "condense_assembly", "solve_path"]

SMALL = 1e-8
"""Change of the traction, relative to the largest pressure, that shows what slips."""

SETTLED = 1e-7
"""Change of tangents and work, relative to them, up to which they have settled."""

DIRECT, ITERATIONS = 8, 60
"""Solves after which ways are averaged, and their largest number."""


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


@dataclass(frozen=True, eq=False)
class FollowedPath:
    """A path that has been solved.

    Attributes
    ----------
    problem : CutProblem
    whole, locked : Assembled
        Without and with the shanks of the bolts; one object if there are none.
    result : Dataset
    work : ndarray, shape (steps, cases), of each load at the factor one on the displacement, J
    """

    problem: CutProblem
    whole: Assembled
    locked: Assembled
    result: Dataset
    work: np.ndarray

    def tangent_work(self, steps: Sequence[int], rise: np.ndarray | None = None) -> np.ndarray:
        r"""Work of each load at the factor one on what it moves alone, J.

        Locked bolts bear every load but the first, which tightens them.

        Notes
        -----
        With the stiffness :math:`K` of the bodies, the tangents :math:`k` of the laws, the weights
        :math:`w` and the jump :math:`B u`, bodies and interfaces stand in series,

        .. math::
            f \cdot u = B u \cdot w k B u + u \cdot K u, \qquad (K + B^T w k B)\, u = f.    \tag{1}

        The tangents are those at the jump reached or, if a load goes on, a little further along
        :math:`B u`: a fixed point, since what sticks and what slips depends on u.
        """
        found = np.full((2, 3, self.result.sizes["step"], self.whole.load.shape[1]), np.nan)
        law, states = None, dict[int, np.ndarray]()
        if self.problem.joints:
            law = self.problem.law
            states = {step: state for step, state, _ in replay(self.problem, self.result)}
        cholesky = Factors()
        for step in steps:
            if self.result["converged"].values[step] != 1:
                continue
            for structure, cases in self._structures():
                load = structure.load[:, cases]
                if law is None:
                    u = cholesky(structure.stiffness)(load)
                    found[..., step, cases] = _works(structure, 0.0 * structure.stiffness, load, u)
                    continue
                jump = self.result["jump"].values[step].T * np.array([[1.0], [0.0], [0.0]])
                at = _Place(structure, law, jump, law.from_here(states[step]))
                u = at.solve(at.stuck, load, cholesky if at.sticks else factorise)
                found[0][:, step, cases] = at.works(at.stuck, load, u)
                if rise is None:
                    continue
                for column, case in enumerate(cases):
                    found[1, :, step, case] = at.further(
                        load[:, column], u[:, column], float(rise[step, case])
                    )
        return found

    def _structures(self) -> list[tuple[Assembled, list[int]]]:
        """Structures that bear the loads, and which."""
        cases = list(range(self.whole.load.shape[1]))
        if self.locked is self.whole:
            return [(self.whole, cases)]
        return [(self.locked, cases[1:]), (self.whole, cases[:1])]


@dataclass(frozen=True, eq=False)
class _Place:
    """A structure at a step of its path, whose tangential jumps count from there."""

    structure: Assembled
    law: SideBySide
    jump: np.ndarray
    state: np.ndarray

    @cached_property
    def stuck(self) -> np.ndarray:
        """Tangents of the laws with which no point slips, shape (3, 3, points), Pa/m."""
        return self.law.respond(self.jump, self.law.unsheared(self.state)).tangent

    @property
    def sticks(self) -> bool:
        """Whether all interfaces have friction."""
        return bool(np.all(self.law.friction_limit(np.ones(self.structure.weight.size)) > 0.0))

    def stiffness(self, tangent: np.ndarray) -> csr_array:
        """Stiffness of all joints of some tangents, N/m."""
        B = self.structure.jump
        blocks = [[diags_array(self.structure.weight * one) for one in row] for row in tangent]
        return csr_array(B.T @ csr_array(block_array(blocks, format="csr")) @ B)

    def solve(
        self, tangent: np.ndarray, load: np.ndarray, factorise: Callable[[csr_array], Solve]
    ) -> np.ndarray:
        """Displacement under loads, m; where a load moves freely, a little stiffness is lent."""
        K, B, weight = self.structure.stiffness, self.structure.jump, self.structure.weight
        whole = csr_array(K + self.stiffness(tangent))
        try:
            return factorise(whole)(load)
        except MultiscaleError:
            lent = FLOOR * face_stiffness(K.diagonal(), B[: weight.size], weight)
            soft = np.abs(np.einsum("iip->ip", tangent)) < lent
            held = self.stiffness(lent * np.eye(3)[:, :, None] * soft)
            return factorise(csr_array(whole + held))(load)

    def works(self, tangent: np.ndarray, load: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Work of loads, joints and bodies, (1), J; infinite where what is lent bears a load."""
        found = _works(self.structure, self.stiffness(tangent), load, u)
        free = found[1] + found[2] < 0.5 * found[0]
        found[:2] = np.where(free, np.inf, found[:2])
        return found

    def further(self, load: np.ndarray, ahead: np.ndarray, sign: float) -> np.ndarray:
        """Work of one load, joints and bodies, J, from its displacement if nothing slips, m."""
        pressure = -self.law.respond(self.jump, self.state).traction[0].min(initial=0.0)
        tangent, u, last = self.stuck, ahead, np.inf
        most = SETTLED * np.abs(self.stuck).max(initial=0.0)
        for iteration in range(ITERATIONS):
            opened = (self.structure.jump @ ahead).reshape(self.jump.shape)
            change = np.abs(np.einsum("ijp,jp->ip", self.stuck, opened)).max(initial=0.0)
            small = sign * SMALL * pressure / change if change > 0.0 else 0.0
            # what sticks, slips, loads and unloads along the way
            now = self.law.respond(self.jump + small * opened, self.state).tangent
            work = float(load @ u)
            if np.abs(now - tangent).max(initial=0.0) <= most or abs(work - last) <= SETTLED * work:
                return self.works(tangent, load, u)
            tangent, last = now, work
            u = self.solve(tangent, load, factorise)
            # the mean of two ways, where they go round in circles
            ahead = u if iteration < DIRECT else 0.5 * (ahead + u)
        return np.full(3, np.nan)


def _works(structure: Assembled, tangent: csr_array, load: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Work of loads, joints and bodies, (1), shape (3, cases), J."""
    return np.array(
        [np.sum(one * u, axis=0) for one in (load, tangent @ u, structure.stiffness @ u)]
    )


def solve_path(
    problem: CutProblem, factors: np.ndarray, method: Method, near: Dataset | None = None
) -> FollowedPath:
    """Solve a path, maybe near another one, and let the loads measure the displacement."""
    result, whole = follow_bolts(problem, factors, method, near=near), assemble(problem)
    locked = assemble(lock_bolts(problem)) if problem.bolts else whole
    work = problem.unknowns(result["displacement"].values) @ whole.load
    return FollowedPath(problem, whole, locked, result, work)
