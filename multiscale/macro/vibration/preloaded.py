"""A structure at rest under its preload: from here on it vibrates."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import block_array, csr_array, diags_array

from multiscale.errors import CaseError, ConvergenceError
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.laws.side_by_side import SideBySide
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.data_range import with_load_shares
from multiscale.macro.substructures.capacity import refuse_free
from multiscale.macro.substructures.cut import cut_assembly
from multiscale.macro.substructures.measures import joint_shares
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stepping import JointState, PreparedStructure, follow
from multiscale.macro.substructures.whole import (
    AssembledNewton,
    CondensedProblem,
    assemble,
    condense_problem,
)
from multiscale.macro.vibration.modes import find_free_motions
from multiscale.schema import Dataset

__all__ = ["Preloaded", "press_structure", "require_joined"]

MOST = 6000
"""Largest number of unknowns that bodies are condensed onto: their full matrix is factorised once,
and a matrix of half its size in every step."""

STIFFEST = 1e5
"""Stiffness of a law, relative to the bodies, above which a joint counts as rigid in modes: a
matrix with stiffer joints could not be factorised."""


@dataclass(frozen=True, eq=False)
class Preloaded:
    """A structure at rest.

    Attributes
    ----------
    free : CutProblem, the structure on its supports, if any
    condensed : CondensedProblem
        The same, with springs against rigid motions of the whole that are free.
    path : Dataset, follows ``MACRO_RESULT``, the steps of the preload on the small problem
    law : SideBySide, laws of all joints for further loads, which flow no more
    state : JointState, at the end of the preload
    """

    free: CutProblem
    condensed: CondensedProblem
    path: Dataset
    law: SideBySide
    state: JointState

    def tangent(self) -> csr_array:
        """Stiffness of the whole against small changes, with locked bolts, no point slipping, N/m.

        Shape (whole unknowns, whole unknowns).
        """
        whole, law = assemble(self.free.with_locked_bolts()), self.law
        tangent = law.respond(self.state.jump, law.unsheared(self.state.history)).tangent
        B, points = whole.jump, whole.weight.size
        if points:
            most = STIFFEST * whole.resistance
            size = np.abs(tangent).max(axis=(0, 1))
            tangent = tangent * np.minimum(1.0, most / np.where(size > 0.0, size, most))
        blocks = [[diags_array(whole.weight * entry) for entry in row] for row in tangent]
        stiffness = whole.stiffness + B.T @ csr_array(block_array(blocks, format="csr")) @ B
        return csr_array(0.5 * (stiffness + stiffness.T))


def press_structure(
    assembly: Assembly,
    factors: np.ndarray,
    *,
    preload_laws: Sequence[InterfaceLaw] | None = None,
    extrapolate: bool = False,
    near: Preloaded | None = None,
) -> Preloaded:
    """Solve for the rest of a structure under its preload.

    Parameters
    ----------
    assembly : Assembly
        Supports, interfaces and bolts hold its bodies to each other; the whole may be free, if its
        loads balance each other.
    factors : ndarray, shape (steps, cases), factors of its loads, with bolts of their preloads
    preload_laws : sequence of InterfaceLaw, optional
        Laws of the interfaces during the preload, such as frictionless ones, with the same states.
    extrapolate : bool
        Whether pressures may lie far outside the data of the laws; see
        :func:`~multiscale.macro.data_range.with_load_shares`.
    near : Preloaded, optional
        The same bodies under other laws and loads; provides the condensed stiffness.

    Raises
    ------
    CaseError
        If a body is free to move by itself, or the structure is refused as by ``cut_assembly``.
    ConvergenceError
        If the preload has no equilibrium, or one far outside the data of a law.
    """
    free = cut_assembly(assembly)
    held = _hold(free)
    refuse_free(assembly, held, "; the structure as a whole may be free")
    known = near.condensed.insides if near else ()
    condensed = condense_problem(held, largest=MOST, insides=known)
    joints = condensed.small.joints
    if joints and condensed.small is held and held.n > MOST:
        raise CaseError(
            f"the interfaces and bolts keep so many of {held.n} unknowns that bodies are not "
            f"condensed onto them, {MOST} at most; mesh the faces of interfaces coarser"
        )
    pressed = condensed.small
    if preload_laws is not None:
        pressed = pressed.with_laws(preload_laws)
    followed = follow(PreparedStructure(pressed, AssembledNewton()), factors)
    path = followed.result
    if not path["converged"].values.all():
        raise ConvergenceError(f"the preload has no equilibrium: {path.attrs['failure']}")
    if joints:
        shares, data = joint_shares(pressed, path)
        loads = ["its preload"] * path.sizes["step"]
        path = with_load_shares(path, shares, data, extrapolate=extrapolate, loads=loads)
        if not (extrapolate or path["known"].values[-1]):
            raise ConvergenceError(f"the preload is unknown: {path.attrs['cautions']}")
    return Preloaded(free, condensed, path, condensed.small.law.shaken_down(), followed.end)


def require_joined(assembly: Assembly) -> None:
    """Refuse bodies that may move against each other; the structure as a whole may be free.

    Raises
    ------
    CaseError
        With the bodies and their motions, or as ``cut_assembly``.
    """
    refuse_free(assembly, _hold(cut_assembly(assembly)), "; the structure as a whole may be free")


def _hold(problem: CutProblem) -> CutProblem:
    """Add springs against the motions that neither supports nor joints with the ground resist."""
    whole = assemble(problem)
    size = whole.stiffness.diagonal().mean()
    k = np.full((3, whole.weight.size), size)
    k[1:] *= np.sign(problem.law.friction_limit(np.ones(whole.weight.size)))
    B = whole.jump
    K = csr_array(whole.stiffness + B.T @ diags_array(k.ravel()) @ B)
    springs = np.zeros(problem.n)
    springs[find_free_motions(problem, K)[1]] = size
    parts = []
    for part in problem.substructures:  # the first that has the unknown has the spring
        added = diags_array(springs[part.unknown])
        springs[part.unknown] = 0.0
        parts.append(replace(part, stiffness=csr_array(part.stiffness + added)))
    return replace(problem, substructures=tuple(parts))
