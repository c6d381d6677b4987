"""Tangent stiffness of a structure under its loads at a state of its path."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from multiscale.errors import MultiscaleError
from multiscale.fe.multigrid import joint_matrix
from multiscale.laws.interface_law import SideBySide
from multiscale.macro.monolithic import FLOOR, NO_JOINT, Assembled, LinearSolver, factorise_joined
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stepping import JointState
from multiscale.macro.substructures.whole import assemble

SMALL = 1e-8
"""Probing change of the traction, relative to the largest pressure, which decides which points
slip."""

SETTLED = 1e-7
"""Relative change of tangents and work at which they have converged."""

DIRECT, ITERATIONS = 8, 60
"""Solves after which directions are averaged, and limit of solves."""


class Tangents:
    """Tangents of a structure, without and with the shanks of its bolts."""

    def __init__(self, problem: CutProblem, linear: LinearSolver = factorise_joined) -> None:
        self.problem, self.whole = problem, assemble(problem, linear)
        cases = list(range(problem.n_cases))
        # bolts are locked under every load but the first, which tightens them
        self.structures = [(self.whole, cases)]
        if problem.bolts:
            locked = assemble(problem.with_locked_bolts(), linear)
            self.structures = [(locked, cases[1:]), (self.whole, cases[:1])]

    def work(self, state: JointState, rise: np.ndarray | None = None) -> np.ndarray:
        """Work of each load at the factor 1, of joints and of bodies, J, shape (2, 3, cases)."""
        # bodies and interfaces are in series, (K + B^T w k B) u = f: f·u = B u·w k B u + u·K u (1);
        # first without slip, then with slip under a rise of the load by its sign, a fixed-point
        # problem
        work = np.full((2, 3, self.problem.n_cases), np.nan)
        for structure, cases in self.structures:
            load = structure.load[:, cases]
            if not self.problem.joints:
                u = structure.linear(structure.stiffness, structure.jump, NO_JOINT)(load)
                work[..., cases] = _works(structure, 0.0 * structure.stiffness, load, u)
                continue
            at = _Place(structure, self.problem.law, state.jump, state.history)
            u = at.solve(at.stuck, load)
            work[0][:, cases] = at.works(at.stuck, load, u)
            if rise is None:
                continue
            for column, case in enumerate(cases):
                work[1, :, case] = at.rise(load[:, column], u[:, column], float(rise[case]))
        return work

    def changes(self, state: JointState, laws: Sequence[SideBySide]) -> np.ndarray:
        """Change of the work without slip by small changes of the laws, J, (laws, 3, cases)."""
        # with changes t' of the tractions and k' of the tangents at the changed jump, to first
        # order
        #     (K + B^T w k B) U' = -B^T w t',  (K + B^T w k B) u' = -B^T w k' B u,
        #     f·u' = -B u·w k' B u
        law, points = self.problem.law, state.jump.shape[1]
        base = law.respond(state.jump, law.at_rest(state.jump))
        # changed jump of the state
        place = _Place(self.whole, law, state.jump, state.history)
        pushed = [
            (other.respond(state.jump, other.at_rest(state.jump)).traction - base.traction)
            for other in laws
        ]
        forces = self.whole.jump.T @ np.reshape(self.whole.weight * pushed, (len(laws), -1)).T
        opened = (self.whole.jump @ place.solve(place.stuck, -forces))[:points].T
        tangents = list[np.ndarray]()
        for other, normal in zip(laws, opened, strict=True):
            jump = state.jump + np.eye(3)[:, :1] * normal
            tangents.append(other.respond(jump, other.at_rest(jump)).tangent - base.tangent)
        # changed displacement under the loads
        work = np.zeros((len(laws), 3, self.problem.n_cases))
        for structure, cases in self.structures:
            at, B = replace(place, structure=structure), structure.jump
            load = structure.load[:, cases]
            jump = (B @ at.solve(at.stuck, load)).reshape(3, points, len(cases))
            weight = structure.weight[:, None]
            pulled = weight * np.einsum("lijp,jpc->lipc", tangents, jump)
            forces = B.T @ pulled.transpose(1, 2, 0, 3).reshape(3 * points, -1)
            moved = at.solve(at.stuck, -forces)
            apart = (B @ moved).reshape(3, points, len(laws), len(cases))
            carried = weight * np.einsum("ijp,jpc->ipc", at.stuck, jump)
            stored = np.einsum("ipc,lipc->lc", jump, pulled)
            work[:, 0, cases] = -stored
            work[:, 1, cases] = stored + 2.0 * np.einsum("ipc,iplc->lc", carried, apart)
        work[:, 2] = work[:, 0] - work[:, 1]
        return work


@dataclass(frozen=True, eq=False)
class _Place:
    """A structure at a step of its path; tangential jumps count from this step."""

    structure: Assembled
    law: SideBySide
    jump: np.ndarray
    state: np.ndarray

    @cached_property
    def stuck(self) -> np.ndarray:
        """Tangents of the laws without slip, shape (3, 3, points), Pa/m."""
        return self.law.respond(self.jump, self.law.unsheared(self.state)).tangent

    def stiffness(self, tangent: np.ndarray) -> csr_array:
        """Stiffness of all joints for given tangents, N/m."""
        B = self.structure.jump
        return csr_array(B.T @ joint_matrix(self.structure.weight * tangent) @ B)

    def solve(self, tangent: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Displacement under loads, m; if the stiffness is singular, soft points get a little."""
        whole = self.structure
        try:
            return whole.linear(whole.stiffness, whole.jump, whole.weight * tangent)(load)
        except MultiscaleError:
            lent = FLOOR * whole.resistance
            soft = np.abs(np.einsum("iip->ip", tangent)) < lent
            tangent = whole.weight * (tangent + lent * np.eye(3)[:, :, None] * soft)
            return whole.linear(whole.stiffness, whole.jump, tangent)(load)

    def works(self, tangent: np.ndarray, load: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Work of loads, joints and bodies, (1), J; infinite where lent stiffness carries loads."""
        work = _works(self.structure, self.stiffness(tangent), load, u)
        free = work[1] + work[2] < 0.5 * work[0]
        work[:2] = np.where(free, np.inf, work[:2])
        return work

    def rise(self, load: np.ndarray, ahead: np.ndarray, sign: float) -> np.ndarray:
        """Work of a rising load, joints and bodies, J, from its displacement without slip, m."""
        pressure = -self.law.respond(self.jump, self.state).traction[0].min(initial=0.0)
        tangent, u, last = self.stuck, ahead, np.inf
        most = SETTLED * np.abs(self.stuck).max(initial=0.0)
        for iteration in range(ITERATIONS):
            # a small change of the jump along the displacement
            opened = (self.structure.jump @ ahead).reshape(self.jump.shape)
            change = np.abs(np.einsum("ijp,jp->ip", self.stuck, opened)).max(initial=0.0)
            small = sign * SMALL * pressure / change if change > 0.0 else 0.0
            # tangents of sticking, slipping, loading and unloading points
            now = self.law.respond(self.jump + small * opened, self.state).tangent
            work = float(load @ u)
            if np.abs(now - tangent).max(initial=0.0) <= most or abs(work - last) <= SETTLED * work:
                return self.works(tangent, load, u)
            # displacement with these tangents; averages stop cycling
            tangent, last = now, work
            u = self.solve(tangent, load)
            ahead = u if iteration < DIRECT else 0.5 * (ahead + u)
        return np.full(3, np.nan)


def _works(structure: Assembled, tangent: csr_array, load: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Work of loads, joints and bodies, (1), shape (3, cases), J."""
    return np.array(
        [np.sum(force * u, axis=0) for force in (load, tangent @ u, structure.stiffness @ u)]
    )
