"""A path of loads that has been solved, with the structure that measures its displacement."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.errors import CaseError
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.substructures.bolted_path import Method, follow_bolts, lock_bolts
from multiscale.macro.substructures.condensed_problem import CondensedProblem, condense_problem
from multiscale.macro.substructures.cut_bodies import cut_assembly
from multiscale.macro.substructures.joint_state import without_slip
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stack import Factors
from multiscale.macro.substructures.whole_structure import Assembled, assemble
from multiscale.schema import Dataset

__all__ = ["FollowedPath", "condense_assembly", "solve_path"]


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

    def tangent_work(self, steps: Sequence[int]) -> np.ndarray:
        r"""Work of each load at the factor one on what it moves alone, no point slipping, J.

        Locked bolts bear every load but the first, which tightens them.

        Parameters
        ----------
        steps : sequence of int, where it is wanted; NaN elsewhere, and where a step failed

        Returns
        -------
        ndarray, shape (3, steps, cases), of the whole, the interfaces and the bodies

        Notes
        -----
        With the stiffness :math:`K` of the bodies, the tangents :math:`k` of the laws, the weights
        :math:`w` and the jump :math:`B u`, bodies and interfaces stand in series,

        .. math::
            f \cdot u = B u \cdot w k B u + u \cdot K u, \qquad (K + B^T w k B)\, u = f.    \tag{1}
        """
        load, factorise = self.whole.load, Factors()
        found = np.full((3, self.result.sizes["step"], load.shape[1]), np.nan)

        def works(structure: Assembled, tangent: csr_array) -> list[np.ndarray]:
            u = factorise(csr_array(structure.stiffness + tangent))(load)
            forces = (load, tangent @ u, structure.stiffness @ u)
            return [np.sum(force * u, axis=0) for force in forces]  # (1)

        for step in steps:
            if self.result["converged"].values[step] == 1:
                tangent = self._tangent(step)
                found[:, step] = works(self.locked, tangent)
                if self.locked is not self.whole:
                    found[:, step, 0] = np.array(works(self.whole, tangent))[:, 0]
        return found

    def _tangent(self, step: int) -> csr_array:
        """Stiffness of all joints about the jump of a step, no point slipping, N/m."""
        if not self.problem.joints:
            return csr_array(self.whole.stiffness.shape)
        k = without_slip(self.problem.law, self.result["jump"].values[step].T)
        B = self.whole.jump
        return csr_array(B.T @ diags_array((self.whole.weight * k).ravel()) @ B)


def solve_path(
    problem: CutProblem, factors: np.ndarray, method: Method, near: Dataset | None = None
) -> FollowedPath:
    """Solve a path, maybe near another one, and let the loads measure the displacement."""
    result, whole = follow_bolts(problem, factors, method, near=near), assemble(problem)
    locked = assemble(lock_bolts(problem)) if problem.bolts else whole
    work = problem.unknowns(result["displacement"].values) @ whole.load
    return FollowedPath(problem, whole, locked, result, work)
