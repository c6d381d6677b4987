"""State of a structure that is committed at the end of a step: the next step starts from it."""

from dataclasses import dataclass, field, replace

import numpy as np

from multiscale.laws.interface_law import InterfaceLaw, Sliding
from multiscale.macro.substructures.problem import CutProblem

__all__ = ["JointState"]

ALONG = np.array([[0.0], [1.0], [1.0]])
"""Picks the tangential components of a jump."""


@dataclass(frozen=True, eq=False)
class JointState:
    """Committed state at the end of a step.

    Tangential jumps of the next step count from here: on a stiff law, sums of long slips round
    away what changes.

    Attributes
    ----------
    unknowns : ndarray, shape (n,), displacement, m
    jump : ndarray, shape (3, points), normal jump, m; both tangential rows are zero
    slid : ndarray, shape (3, points), tangential jumps of all steps, m; the normal row is zero
    history : ndarray, shape (law.n_state, points), internal variables of the laws
    traction : ndarray, shape (3, points), Pa
    tightening : float, factor of the load case that tightens the bolts
    pull : ndarray, shape (bolts,)
        Tension of each bolt less that of the stretch of its shank, N, while it is locked.
    """

    unknowns: np.ndarray
    jump: np.ndarray
    slid: np.ndarray
    history: np.ndarray
    traction: np.ndarray
    tightening: float = 0.0
    pull: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def at_rest(cls, problem: CutProblem) -> "JointState":
        """State without displacement, jumps and tractions."""
        nothing = np.zeros((3, problem.weight.size))
        history = np.zeros((problem.law.n_state, problem.weight.size))
        return cls(
            np.zeros(problem.n),
            nothing,
            nothing,
            history,
            nothing,
            pull=np.zeros(len(problem.bolts)),
        )

    @property
    def whole_jump(self) -> np.ndarray:
        """Jump since the beginning of the path, shape (3, points), m."""
        return np.asarray(self.jump + self.slid)

    @property
    def pressure(self) -> np.ndarray:
        """Contact pressure, shape (points,), Pa."""
        return np.asarray(-self.traction[0])

    def advance(
        self, law: InterfaceLaw, unknowns: np.ndarray, jump: np.ndarray, traction: np.ndarray
    ) -> tuple["JointState", Sliding]:
        """Commit a step to a jump whose tangential part counts from this state.

        Raises
        ------
        ConvergenceError
            If the step wins energy; see :func:`~multiscale.laws.side_by_side.advance_state`.
        """
        account = law.sliding(jump, self.history)
        along = ALONG * jump
        following = replace(
            self,
            unknowns=unknowns,
            jump=jump - along,
            slid=self.slid + along,
            history=law.from_here(account.state),
            traction=traction,
        )
        return following, account
