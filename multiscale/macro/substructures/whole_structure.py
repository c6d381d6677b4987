"""The structure that the substructures make, in one piece."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, vstack

from multiscale.macro.substructures.problem import CutProblem, Substructure

__all__ = ["Assembled", "assemble"]


@dataclass(frozen=True, eq=False)
class Assembled:
    """Matrices of a whole structure without links.

    Attributes
    ----------
    stiffness : csr_array, shape (n, n)
        Stiffness of all linear parts, N/m.
    load : ndarray, shape (n, cases)
        N.
    jump : csr_array, shape (3 points, n)
        Normal jump at all points of all joints, then each tangential one.
    weight : ndarray, shape (points,)
        Area of these points, m².
    """

    stiffness: csr_array
    load: np.ndarray
    jump: csr_array
    weight: np.ndarray


def assemble(problem: CutProblem) -> Assembled:
    """Add up the substructures of a problem.

    Parameters
    ----------
    problem : Problem
        Its links, if any, are left out.

    Examples
    --------
    >>> from multiscale.laws.bulk import Elastic
    >>> from multiscale.macro import Body, cut_bodies
    >>> from multiscale.fe.boxes import box_mesh
    >>> body = Body(box_mesh((1.0, 1.0, 1.0), (2, 1, 1)), Elastic(1e9, 0.3))
    >>> assemble(cut_bodies([body], [np.array([0, 1])])).stiffness.shape
    (36, 36)
    """
    K, load = csr_array((problem.n, problem.n)), np.zeros((problem.n, problem.n_cases))
    for part in problem.substructures:
        place = _placement(problem, part)
        K = K + place.T @ part.stiffness @ place
        load += place.T @ part.load
    rows: list[list[csr_array]] = [[], [], []]
    for joint in problem.joints:
        first, second = (
            trace @ _placement(problem, problem.substructures[side])
            for side, trace in zip(joint.sides, joint.trace, strict=True)
        )
        jump = csr_array(second - first)
        for direction, points in enumerate(np.split(np.arange(joint.size), 3)):
            rows[direction].append(jump[points])
    if not problem.joints:
        return Assembled(csr_array(K), load, csr_array((0, problem.n)), np.zeros(0))
    return Assembled(
        csr_array(K),
        load,
        csr_array(vstack([block for direction in rows for block in direction])),
        np.concatenate([joint.weight for joint in problem.joints]),
    )


def _placement(problem: CutProblem, part: Substructure) -> csr_array:
    """Pick the unknowns of a substructure out of all unknowns of the structure."""
    rows = np.arange(part.n)
    return csr_array((np.ones(part.n), (rows, part.unknown)), shape=(part.n, problem.n))
