"""Search directions: the stiffness by which one stage looks for the other."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.macro.substructures.condensation import condense, split
from multiscale.macro.substructures.parallel import Team
from multiscale.macro.substructures.problem import Interface, Problem
from multiscale.macro.substructures.stack import Factors, Sides, Stack

__all__ = ["SideStiffness", "schur_complements", "side_stiffness"]

STRENGTH = 0.6
"""Stiffness of an interface relative to that of its neighbours."""

SOFTEST = 1e-3
"""Below this share of the stiffest motion of an interface all are taken as equally soft."""

HELD = 1e-9
"""Stiffness lent to the inside of a substructure, relative to its diagonal."""


@dataclass(frozen=True, eq=False)
class SideStiffness:
    """Stiffness :math:`k_0` of all sides and its inverse root, shape (m, m), N/m."""

    matrix: csr_array
    inverse_root: csr_array


def side_stiffness(
    problem: Problem,
    stack: Stack,
    sides: Sides,
    parts: range,
    share: np.ndarray,
    factors: Factors,
    team: Team,
) -> SideStiffness:
    r"""Stiffness that every interface sees in its neighbours.

    Parameters
    ----------
    problem, stack, sides, parts, team
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
    forms = [
        _form(mean[index]) if face.law is None else _law_form(problem, face)
        for index, face in enumerate(problem.interfaces)
    ]
    return SideStiffness(
        *(_on_sides(problem, sides, [form[kind] for form in forms]) for kind in (0, 1))
    )


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


def _law_form(problem: Problem, face: Interface) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness of an interface with a law: one number per area, and its inverse root.

    The diagonal of the bodies is the stiffness of the shortest waves, and that of the longest
    is less by their ratio of lengths; the mean of both is taken.
    """
    weight = np.tile(face.weight, 3)
    touched = sum(
        float(
            np.abs(problem.substructures[owner].stiffness.diagonal()) @ (abs(trace).T @ weight > 0)
        )
        for owner, trace in zip(face.sides, face.trace, strict=True)
    )
    per_area = touched / (2.0 * weight.sum()) / face.weight.size**0.25
    stiffness = STRENGTH * per_area * weight
    return np.diag(stiffness), np.diag(1.0 / np.sqrt(stiffness))


def _on_sides(problem: Problem, sides: Sides, blocks: list[np.ndarray]) -> csr_array:
    """Give every side the matrix of its interface."""
    rows, columns, values = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
    for face, places, block in zip(problem.interfaces, sides.place, blocks, strict=True):
        size = np.arange(face.size)
        if face.law is not None:
            i = j = size
            entries = block.diagonal()
        else:
            i, j = np.repeat(size, face.size), np.tile(size, face.size)
            entries = block.ravel()
        for place in places:
            rows.append(place.start + i)
            columns.append(place.start + j)
            values.append(entries)
    triplets = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return csr_array(triplets, shape=(sides.m, sides.m))
