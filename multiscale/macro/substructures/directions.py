"""Search directions of LATIN: stiffness of the sides of interfaces."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.fe.elasticity import condense, split
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.substructures.problem import CutInterface, CutProblem
from multiscale.macro.substructures.stack import Factors, ProcessGroup, Stack

SOFTEST = 1e-9
"""Stiffness of the softest motions of an interface, relative to the stiffest."""

SETTLED, PASSES = 0.05, 40
"""Relative change at which the stiffness of interfaces has settled, and limit of passes."""

LENT = 1e-9
"""Stiffness lent to the inside of a substructure, relative to its diagonal."""

STRENGTH = 0.6
"""Stiffness of a side relative to the stiffness of body and law in series."""

LEAN = 0.25
"""Exponent of the stiffness of the other side in the stiffness of a side."""

RIGID = 1e4
"""Stiffness of a side on a support, relative to the bodies."""

SOFT, OPEN = 1e-3, 1e-9
"""Least stiffness of a law at a point relative to its mean over the joint, and to the bodies."""


@dataclass(frozen=True, eq=False)
class SideStiffness:
    """Stiffness :math:`k_0` of all sides and its inverse root, shape (m, m), N/m."""

    matrix: csr_array
    inverse_root: csr_array


def interface_stiffness(
    stack: Stack, schur: list[tuple[np.ndarray, np.ndarray]], start: dict[int, np.ndarray]
) -> dict[int, np.ndarray]:
    """Stiffness of the substructures behind every perfect interface."""
    # unknowns of every interface in the Schur complements of this process
    interfaces, sides = stack.problem.interfaces, stack.problem.sides
    local = [
        {
            index: np.searchsorted(unknown, interfaces[index].trace[side].indices)
            for index, side in sides[owner]
            if interfaces[index].law is None
        }
        for owner, (unknown, _) in zip(stack.local, schur, strict=True)
    ]
    counts, team = [len(face.sides) for face in interfaces], stack.team
    fixed = [
        {index: S[np.ix_(at, at)] for index, at in places.items()}
        for places, (_, S) in zip(local, schur, strict=True)
    ]
    # with the stiffness k_o of the other interfaces; the start S_ee is far too stiff where bars are
    # much stiffer than cables
    #     k_e = mean over sides of S_ee - S_eo (S_oo + k_o)^-1 S_oe  (1)
    # fixed-point iteration of (1)
    stiffness = start or _mean(fixed, counts, team)
    for _ in range(PASSES):
        behind = [
            _stiffness_behind(S, places, stiffness)
            for places, (_, S) in zip(local, schur, strict=True)
        ]
        old, stiffness = stiffness, _mean(behind, counts, team)
        change = [np.linalg.norm(old[i] - k) / np.linalg.norm(k) for i, k in stiffness.items()]
        if max(change, default=0.0) <= SETTLED:
            break
    return stiffness


def _stiffness_behind(
    schur: np.ndarray, places: dict[int, np.ndarray], stiffness: dict[int, np.ndarray]
) -> dict[int, np.ndarray]:
    """Evaluate (1) for a substructure: the inverse of its flexibility less its stiffness."""
    whole = schur.copy()
    for index, at in places.items():
        whole[np.ix_(at, at)] += stiffness[index]
    scale = 1.0 / np.sqrt(whole.diagonal())
    flexibility = np.linalg.inv(whole * scale[:, None] * scale) * scale[:, None] * scale
    behind = {}
    for index, at in places.items():
        block = np.linalg.inv(flexibility[np.ix_(at, at)]) - stiffness[index]
        behind[index] = 0.5 * (block + block.T)
    return behind


def _mean(
    blocks: Sequence[dict[int, np.ndarray]], counts: Sequence[int], team: ProcessGroup
) -> dict[int, np.ndarray]:
    shares = [(i, block / counts[i]) for sides in blocks for i, block in sides.items()]
    mean: dict[int, np.ndarray] = {}
    for index, block in team.collect(shares):
        mean[index] = mean.get(index, 0.0) + block
    return mean


def schur_complements(
    stack: Stack, share: np.ndarray, ground: csr_array, factors: Factors
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Condense every substructure onto the unknowns that its neighbours share."""
    matrix = stack.matrix(share * stack.links.stiffness, ground)
    matrix = csr_array(matrix + LENT * diags_array(matrix.diagonal()))
    shared = split(stack.start, stack.shared)
    blocks = condense(matrix, shared, factors).blocks
    local = np.split(shared.edge, shared.edge_start[1:-1])
    return [
        (edge - first, 0.5 * (block + block.T))
        for edge, first, block in zip(local, stack.start[:-1], blocks, strict=True)
    ]


def side_stiffness(
    stack: Stack, perfect: dict[int, np.ndarray], joints: np.ndarray
) -> SideStiffness:
    """Stiffness of all sides: a matrix on perfect interfaces, a diagonal on joints."""
    sides, at = stack.sides, stack.sides.joints.ravel()
    rows, columns, values, roots = [at], [at], [joints.ravel()], [1.0 / np.sqrt(joints.ravel())]
    for index, k in perfect.items():  # with the softest motions stiffened
        size, motion = np.linalg.eigh(k)
        size = np.maximum(size, SOFTEST * size[-1])
        row, column = np.indices(k.shape).reshape(2, -1)
        for place in sides.place[index]:
            values.append(((motion * size) @ motion.T).ravel())
            roots.append(((motion / np.sqrt(size)) @ motion.T).ravel())
            rows.append(place.start + row)
            columns.append(place.start + column)
    places = np.concatenate(rows), np.concatenate(columns)
    matrix, root = (
        csr_array((np.concatenate(entries), places), shape=(sides.m, sides.m))
        for entries in (values, roots)
    )
    return SideStiffness(matrix, root)


def body_stiffness(problem: CutProblem, joint: CutInterface) -> np.ndarray:
    """Stiffness per area of the bodies on both sides of a joint, shape (2, 3, points), Pa/m."""
    # geometric mean of the shortest wavelength (the diagonal) and the longest, drawn towards the
    # other side, as a stiff body has soft motions too; a side that a support fixes is rigid
    weight, sizes, fixed = np.tile(joint.weight, 3), [], []
    for owner, trace in zip(joint.sides, joint.trace, strict=True):
        touched = abs(trace).T @ weight > 0.0
        total = float(np.abs(problem.substructures[owner].stiffness.diagonal()) @ touched)
        sizes.append(total / weight.sum() / joint.weight.size**0.25)
        fixed.append((np.diff(trace.indptr) == 0).reshape(3, -1))
    sizes = [k or max(sizes) for k in sizes]  # zero where all of a side is fixed
    lean = [a ** (1.0 - LEAN) * b**LEAN for a, b in (sizes, sizes[::-1])]
    return np.where(np.array(fixed), RIGID * max(sizes), np.reshape(lean, (2, 1, 1)))


def law_stiffness(law: InterfaceLaw, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Diagonal of the tangent of a law, equal in both tangential rows, shape (3, points), Pa/m."""
    if not law.compliant:
        return np.full_like(jump, np.inf)
    tangent = law.respond(jump, state).tangent
    shear = np.maximum(tangent[1, 1], tangent[2, 2])
    return np.stack([tangent[0, 0], shear, shear])


def joint_directions(problem: CutProblem, bodies: np.ndarray, law: np.ndarray) -> np.ndarray:
    """Stiffness of the sides of all joints, (2, 3, points), N/m: body and half of law in series."""
    joint, weight = problem.point_joint, problem.weight
    total = [np.bincount(joint, weight * row)[joint] for row in law]
    mean = np.array(total) / np.bincount(joint, weight)[joint]
    law = np.maximum(law, np.maximum(SOFT * mean, OPEN * bodies.min(axis=0)))
    return np.asarray(STRENGTH * weight / (1.0 / bodies + 0.5 / law))
