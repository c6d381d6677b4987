"""Give every joint to one of its sides, so that only perfect interfaces remain."""

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from multiscale.errors import CaseError
from multiscale.macro.substructures.problem import CutProblem, Substructure

__all__ = ["move_joints_inside"]


def move_joints_inside(problem: CutProblem) -> tuple[CutProblem, list[tuple[int, csr_array]]]:
    """Add every joint to its second side, and to it the unknowns of the first side on the joint.

    What was a joint between two substructures is then a perfect interface, on the first side of
    the joint, between one of them and the other with the joint: its stiffness, from none to
    rigid, is a stiffness of this substructure.
    """
    parts = list(problem.substructures)
    for joint in problem.joints:
        first, second = joint.sides
        touched = np.unique(joint.trace[0].indices)
        new = ~np.isin(problem.substructures[first].unknown[touched], parts[second].unknown)
        parts[second] = _widen(parts[second], problem.substructures[first], touched[new])
    inner = []
    for joint in problem.joints:
        first, second = joint.sides
        part, lower, upper = parts[second], problem.substructures[first], joint.trace[1]
        order = np.argsort(part.unknown)
        place = np.zeros(lower.n, dtype=int)
        touched = np.unique(joint.trace[0].indices)
        place[touched] = order[np.searchsorted(part.unknown[order], lower.unknown[touched])]
        rows = joint.trace[0].tocoo()
        below = csr_array(
            (rows.data, (rows.coords[0], place[rows.coords[1]])), shape=(joint.size, part.n)
        )
        above = csr_array((upper.data, upper.indices, upper.indptr), shape=(joint.size, part.n))
        if joint.law is None or not joint.law.compliant:
            raise CaseError(
                f"a joint of substructures {joint.sides} needs a law that tells the traction of a "
                f"jump; solve_latin takes rigid contact as well"
            )
        inner.append((second, csr_array(above - below)))
    return CutProblem(tuple(parts), problem.position, problem.expansion), inner


def _widen(part: Substructure, other: Substructure, unknowns: np.ndarray) -> Substructure:
    """Append unknowns of another substructure."""
    n, added = part.n + unknowns.size, unknowns.size
    K = part.stiffness
    start = np.append(K.indptr, np.full(added, K.indptr[-1]))
    links = part.links
    if links is not None:
        B = links.operator
        links = replace(
            links, operator=csr_array((B.data, B.indices, B.indptr), shape=(B.shape[0], n))
        )
    return Substructure(
        csr_array((K.data, K.indices, start), shape=(n, n)),
        np.concatenate([part.load, np.zeros((added, part.load.shape[1]))]),
        np.append(part.unknown, other.unknown[unknowns]),
        np.concatenate([part.position, other.position[unknowns]]),
        np.append(part.component, other.component[unknowns]),
        links,
    )
