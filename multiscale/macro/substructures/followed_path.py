"""A path of loads that has been solved, with the structure that measures its displacement."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.substructures.assembly_methods import Method
from multiscale.macro.substructures.bolted_path import follow_bolts, lock_bolts
from multiscale.macro.substructures.condensed_problem import CondensedProblem, condense_problem
from multiscale.macro.substructures.cut_bodies import cut_assembly
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.whole_structure import Assembled, assemble

if TYPE_CHECKING:
    import xarray as xr

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
    work : ndarray, shape (steps, cases)
        Of each load at the factor one on the displacement, J.
    """

    problem: CutProblem
    whole: Assembled
    locked: Assembled
    result: "xr.Dataset"
    work: np.ndarray


def solve_path(
    problem: CutProblem, factors: np.ndarray, method: Method, near: "xr.Dataset | None" = None
) -> FollowedPath:
    """Solve a path, maybe near another one, and let the loads measure the displacement."""
    result, whole = follow_bolts(problem, factors, method, near=near), assemble(problem)
    nothing = np.zeros(len(problem.bolts))
    locked = assemble(lock_bolts(problem, nothing, nothing, 1.0)) if problem.bolts else whole
    work = problem.unknowns(result["displacement"].values) @ whole.load
    return FollowedPath(problem, whole, locked, result, work)
