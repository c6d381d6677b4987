"""Search directions of joints, from the bodies on both sides and the law between them."""

import numpy as np

from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.substructures.problem import CutInterface, CutProblem

__all__ = ["body_stiffness", "joint_directions", "law_stiffness"]

STRENGTH = 0.6
"""Stiffness of a side relative to the stiffness of body and law in series."""

LEAN = 0.25
"""How far the stiffness of one side leans towards the stiffness of the other, as an exponent."""

RIGID = 1e4
"""Stiffness of a side that a support holds, relative to the bodies."""

SOFTEST, OPEN = 1e-3, 1e-9
"""Least stiffness of a law at a point relative to its mean over the joint, and to the bodies."""


def body_stiffness(problem: CutProblem, joint: CutInterface) -> tuple[np.ndarray, ...]:
    """Stiffness per area of what either side of a joint stands for, shape (3, points), Pa/m.

    The diagonal of a body is the stiffness of the shortest waves; the stiffness of the longest is
    less by their ratio of lengths; the mean of both is taken. The stiffer side is taken a little
    softer and the softer one stiffer: a stiff body has soft motions too. Where a support holds a
    side it is as good as rigid, whatever the body.
    """
    weight, found, held = np.tile(joint.weight, 3), [], []
    for owner, trace in zip(joint.sides, joint.trace, strict=True):
        touched = abs(trace).T @ weight > 0.0
        total = float(np.abs(problem.substructures[owner].stiffness.diagonal()) @ touched)
        found.append(total / weight.sum() / joint.weight.size**0.25)
        held.append((np.diff(trace.indptr) == 0).reshape(3, -1))
    found = [k or max(found) for k in found]  # of a side that is held as a whole
    lean = [a ** (1.0 - LEAN) * b**LEAN for a, b in (found, found[::-1])]
    return tuple(np.where(rows, RIGID * max(found), k) for rows, k in zip(held, lean, strict=True))


def law_stiffness(law: InterfaceLaw, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Diagonal of the tangent of a law, alike for both tangents, shape (3, points), Pa/m.

    It is infinite for rigid contact, open or closed: nothing lies between none and infinite, and
    directions that go to and fro between both do not converge.
    """
    if not law.compliant:
        return np.full_like(jump, np.inf)
    tangent = law.respond(jump, state).tangent
    shear = np.maximum(tangent[1, 1], tangent[2, 2])
    return np.stack([tangent[0, 0], shear, shear])


def joint_directions(
    joint: CutInterface, bodies: tuple[np.ndarray, ...], law: np.ndarray, mean: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Stiffness of both sides of a joint: the body and half of the law in series, N/m.

    A law that is much stiffer than the bodies does not count then, nor do bodies on a soft law; one
    number for both makes the iterations grow with the root of their ratio or worse.
    """
    law = np.maximum(law, np.maximum(SOFTEST * mean, OPEN * np.minimum(*bodies)))
    return tuple(STRENGTH * (joint.weight / (1.0 / body + 0.5 / law)).ravel() for body in bodies)
