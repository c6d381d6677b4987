"""Rest of a structure under its preload, from which it vibrates."""

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

LARGEST = 6000
"""Limit of the boundary unknowns of condensed bodies: their dense matrix is factorised once, and a
matrix of half its size in every step."""

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
        The same structure with springs against free rigid motions of the whole.
    path : Dataset, follows ``MACRO_RESULT``, the steps of the preload on the small problem
    law : SideBySide, laws of all joints for further loads, without plastic flow
    state : JointState, at the end of the preload
    """

    free: CutProblem
    condensed: CondensedProblem
    path: Dataset
    law: SideBySide
    state: JointState

    def tangent(self) -> csr_array:
        """Stiffness of the whole against small changes, N/m, shape (whole.n, whole.n).

        Bolts are locked, and no point slips.
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
        Supports, interfaces and bolts connect its bodies; the whole may be free if its loads are in
        equilibrium.
    factors : ndarray, shape (steps, cases), factors of its loads, with bolts first of the preloads
    preload_laws : sequence of InterfaceLaw, optional
        Laws of the interfaces during the preload, such as frictionless laws, with the same states.
    extrapolate : bool
        Whether pressures may lie far outside the data of the laws; see
        :func:`~multiscale.macro.data_range.with_load_shares`.
    near : Preloaded, optional
        The same bodies under other laws and loads; provides the condensed stiffness.

    Raises
    ------
    CaseError
        If a body is free to move separately, or as :func:`cut_assembly`.
    ConvergenceError
        If the preload has no equilibrium, or is far outside the data of a law.
    """
    # condensed structure, with springs against its free rigid motions
    free = cut_assembly(assembly)
    supported = _add_springs(free)
    refuse_free(assembly, supported, "; the structure as a whole may be free")
    insides = near.condensed.insides if near else ()
    condensed = condense_problem(supported, largest=LARGEST, insides=insides)
    joints = condensed.small.joints
    if joints and condensed.small is supported and supported.n > LARGEST:
        raise CaseError(
            f"interfaces and bolts have too many of {supported.n} unknowns to condense the bodies "
            f"onto them, {LARGEST} at most; mesh the faces of interfaces coarser"
        )

    # path of the preload
    pressed = condensed.small
    if preload_laws is not None:
        pressed = pressed.with_laws(preload_laws)
    followed = follow(PreparedStructure(pressed, AssembledNewton()), factors)
    path = followed.result
    if not path["converged"].values.all():
        raise ConvergenceError(f"the preload has no equilibrium: {path.attrs['failure']}")

    # pressures outside the data of the laws
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
    supported = _add_springs(cut_assembly(assembly))
    refuse_free(assembly, supported, "; the structure as a whole may be free")


def _add_springs(problem: CutProblem) -> CutProblem:
    """Add springs against the free rigid motions of the whole structure."""
    # stiffness with bonded joints, without tangential stiffness where they are frictionless
    whole = assemble(problem)
    size = whole.stiffness.diagonal().mean()
    k = np.full((3, whole.weight.size), size)
    k[1:] *= np.sign(problem.law.friction_limit(np.ones(whole.weight.size)))
    B = whole.jump
    K = csr_array(whole.stiffness + B.T @ diags_array(k.ravel()) @ B)

    # a spring goes to the first substructure with its unknown
    springs = np.zeros(problem.n)
    springs[find_free_motions(problem, K)[1]] = size
    substructures = []
    for each in problem.substructures:
        added = diags_array(springs[each.unknown])
        springs[each.unknown] = 0.0
        substructures.append(replace(each, stiffness=csr_array(each.stiffness + added)))
    return replace(problem, substructures=tuple(substructures))
