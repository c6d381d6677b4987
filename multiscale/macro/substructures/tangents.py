"""Stiffness of a structure against small changes of its loads, at a state of its path."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import block_array, csr_array, diags_array

from multiscale.errors import MultiscaleError
from multiscale.laws.side_by_side import SideBySide
from multiscale.macro.monolithic import FLOOR, Assembled
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stack import Factors
from multiscale.macro.substructures.stepping import JointState
from multiscale.macro.substructures.whole import assemble
from multiscale.numerics.factorisation import Solve, factorise

__all__ = ["Tangents"]

SMALL = 1e-8
"""Change of the traction, relative to the largest pressure, that shows what slips."""

SETTLED = 1e-7
"""Change of tangents and work, relative to them, up to which they have settled."""

DIRECT, ITERATIONS = 8, 60
"""Solves after which ways are averaged, and their largest number."""


class Tangents:
    """Tangents of a structure, without and with the shanks of its bolts."""

    def __init__(self, problem: CutProblem) -> None:
        self.problem, self.whole = problem, assemble(problem)
        cases = list(range(problem.n_cases))
        # locked bolts bear every load but the first, which tightens them
        self.structures = [(self.whole, cases)]
        if problem.bolts:
            locked = assemble(problem.with_locked_bolts())
            self.structures = [(locked, cases[1:]), (self.whole, cases[:1])]
        self.factors = Factors()

    def work(self, state: JointState, rise: np.ndarray | None = None) -> np.ndarray:
        r"""Work of each load at the factor one on the displacement that it makes by itself, J.

        The shape is (2, 3, cases): without slip, then with the sign by which each load rises, if
        given; of loads, joints and bodies.

        Notes
        -----
        With the stiffness :math:`K` of the bodies, the tangents :math:`k` of the laws, the weights
        :math:`w` and the jump :math:`B u`, bodies and interfaces stand in series,

        .. math::
            f \cdot u = B u \cdot w k B u + u \cdot K u, \qquad (K + B^T w k B)\, u = f.    \tag{1}

        The tangents are those at the jump reached or, if a load goes on, a little further along
        :math:`B u`: a fixed point, since what sticks and what slips depends on u.
        """
        work = np.full((2, 3, self.problem.n_cases), np.nan)
        for structure, cases in self.structures:
            load = structure.load[:, cases]
            if not self.problem.joints:
                u = self.factors(structure.stiffness)(load)
                work[..., cases] = _works(structure, 0.0 * structure.stiffness, load, u)
                continue
            at = _Place(structure, self.problem.law, state.jump, state.history)
            u = at.solve(at.stuck, load, self.factors if at.sticks else factorise)
            work[0][:, cases] = at.works(at.stuck, load, u)
            if rise is None:
                continue
            for column, case in enumerate(cases):
                work[1, :, case] = at.further(load[:, column], u[:, column], float(rise[case]))
        return work


@dataclass(frozen=True, eq=False)
class _Place:
    """A structure at a step of its path; tangential jumps count from there."""

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
        blocks = [[diags_array(self.structure.weight * entry) for entry in row] for row in tangent]
        return csr_array(B.T @ csr_array(block_array(blocks, format="csr")) @ B)

    def solve(
        self, tangent: np.ndarray, load: np.ndarray, factorise: Callable[[csr_array], Solve]
    ) -> np.ndarray:
        """Displacement under loads, m; where a load moves freely, a little stiffness is lent."""
        K = self.structure.stiffness
        whole = csr_array(K + self.stiffness(tangent))
        try:
            return factorise(whole)(load)
        except MultiscaleError:
            lent = FLOOR * self.structure.resistance
            soft = np.abs(np.einsum("iip->ip", tangent)) < lent
            held = self.stiffness(lent * np.eye(3)[:, :, None] * soft)
            return factorise(csr_array(whole + held))(load)

    def works(self, tangent: np.ndarray, load: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Work of loads, joints and bodies, (1), J; infinite where what is lent bears a load."""
        work = _works(self.structure, self.stiffness(tangent), load, u)
        free = work[1] + work[2] < 0.5 * work[0]
        work[:2] = np.where(free, np.inf, work[:2])
        return work

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
        [np.sum(force * u, axis=0) for force in (load, tangent @ u, structure.stiffness @ u)]
    )
