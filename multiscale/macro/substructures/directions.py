"""Search directions: the stiffness by which one stage looks for the other."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.macro.substructures.condensation import condense, split
from multiscale.macro.substructures.parallel import Team
from multiscale.macro.substructures.problem import Interface, Problem
from multiscale.macro.substructures.stack import Factors, Sides, Stack

__all__ = ["SideStiffness", "body_stiffness", "interface_forms", "joint_directions", "schur_complements", "side_stiffness"]

STRENGTH = 0.6
"""Stiffness of an interface relative to that of its neighbours."""

SOFTEST = 1e-3
"""Below this share of the stiffest motion of an interface all are taken as equally soft."""

OPEN, LEAN, LEAST, LAW = 1e-9, .25, 1e-3, 2.0

HELD = 1e-9
"""Stiffness lent to the inside of a substructure, relative to its diagonal."""


@dataclass(frozen=True, eq=False)
class SideStiffness:
    """Stiffness :math:`k_0` of all sides and its inverse root, shape (m, m), N/m."""

    matrix: csr_array
    inverse_root: csr_array


def interface_forms(
    problem: Problem, stack: Stack, parts: range, share: np.ndarray, factors: Factors, team: Team
) -> list[tuple[np.ndarray, np.ndarray] | None]:
    r"""Stiffness that every perfect interface sees in its neighbours, and its inverse root.

    Parameters
    ----------
    problem, stack, parts, team
        The structure, and the part of it in this process.
    share : ndarray, shape (rows,)
        Part of the stiffness of every link that counts: less where it is slack.
    factors : Factors
        Of the insides of the substructures.

    Notes
    -----
    The Schur complements of the substructures on their interfaces, restricted to one and
    averaged over its sides, times 0.6: what a side sees behind the interface. Roots of them or
    one number for all motions took up to twice as many iterations.
    """
    schur = schur_complements(stack, share, factors)
    found = []
    for index, face in enumerate(problem.interfaces):
        for owner, trace in zip(face.sides, face.trace, strict=True):
            if owner in parts and face.law is None:
                unknown, matrix = schur[owner - parts.start]
                at = np.searchsorted(unknown, trace.indices)
                found.append((index, matrix[np.ix_(at, at)] / len(face.sides)))
    mean: dict[int, np.ndarray] = {}
    for index, block in team.collect(found):
        mean[index] = mean.get(index, 0.0) + block
    return [
        _form(mean[index]) if face.law is None else None
        for index, face in enumerate(problem.interfaces)
    ]


def schur_complements(
    stack: Stack, share: np.ndarray, factors: Factors
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Condense every substructure onto the unknowns that its neighbours share.

    Returns
    -------
    list of (ndarray, ndarray)
        For every substructure the unknowns, counted in it and rising, and the matrix, N/m.
    """
    matrix = stack.matrix(share * stack.links.stiffness, None)
    matrix = csr_array(matrix + HELD * diags_array(matrix.diagonal()))
    parts = split(stack.start, stack.shared)
    blocks = condense(matrix, parts, factors).blocks
    local = np.split(parts.edge, parts.edge_start[1:-1])
    return [
        (edge - first, 0.5 * (block + block.T))
        for edge, first, block in zip(local, stack.start[:-1], blocks, strict=True)
    ]


def _form(block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness of a perfect interface and its inverse root."""
    size, motion = np.linalg.eigh(block)
    stiffness = STRENGTH * np.maximum(size, SOFTEST * size[-1])
    return (motion * stiffness) @ motion.T, (motion / np.sqrt(stiffness)) @ motion.T


def body_stiffness(problem: Problem, face: Interface) -> list[np.ndarray]:
    """Stiffness of the body behind either side of a joint, one number per area, Pa/m.

    The diagonal of a body is the stiffness of the shortest waves, and that of the longest is
    less by their ratio of lengths; the mean of both is taken.
    """
    weight = np.tile(face.weight, 3)
    found = []
    for owner, trace in zip(face.sides, face.trace, strict=True):
        touched = abs(trace).T @ weight > 0.0
        total = float(np.abs(problem.substructures[owner].stiffness.diagonal()) @ touched)
        found.append(total / weight.sum() / face.weight.size**0.25)
    first, second = found
    return [first**(1-LEAN) * second**LEAN, second**(1-LEAN) * first**LEAN]


def joint_directions(
    face: Interface, bodies: list[float], law: np.ndarray
) -> list[np.ndarray]:
    """Stiffness of the sides of a joint, N/m: that of the body in series with the law's."""
    mean = np.average(law, axis=1, weights=face.weight)[:, None]
    law = np.maximum(law, np.maximum(LEAST * mean, OPEN * min(bodies)))
    return [
        STRENGTH * (face.weight / (1.0 / body + 1.0 / (LAW * law))).ravel() for body in bodies
    ]


def side_stiffness(
    problem: Problem,
    sides: Sides,
    forms: list[tuple[np.ndarray, np.ndarray] | None],
    joints: list[list[np.ndarray] | None],
) -> SideStiffness:
    """Give every side the matrix of its interface."""
    rows, columns = [np.zeros(0, int)], [np.zeros(0, int)]
    stiffness, root = [np.zeros(0)], [np.zeros(0)]
    for face, places, form, diagonals in zip(
        problem.interfaces, sides.place, forms, joints, strict=True
    ):
        size = np.arange(face.size)
        for side, place in enumerate(places):
            if diagonals is not None:
                i = j = size
                stiffness.append(diagonals[side])
                root.append(1.0 / np.sqrt(diagonals[side]))
            else:
                i, j = np.repeat(size, face.size), np.tile(size, face.size)
                stiffness.append(form[0].ravel())
                root.append(form[1].ravel())
            rows.append(place.start + i)
            columns.append(place.start + j)
    at = np.concatenate(rows), np.concatenate(columns)
    shape = (sides.m, sides.m)
    return SideStiffness(
        csr_array((np.concatenate(stiffness), at), shape=shape),
        csr_array((np.concatenate(root), at), shape=shape),
    )
