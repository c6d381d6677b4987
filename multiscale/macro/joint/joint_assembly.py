"""From the two blocks of a joint to matrices: in full, and condensed onto the interface."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import block_array, block_diag, csr_array, eye_array, hstack, vstack

from multiscale.fe.boxes import box_mesh
from multiscale.fe.condensation import compliances
from multiscale.fe.elasticity import displacement_basis, elastic_matrix
from multiscale.fe.faces import face_operator, face_unknowns
from multiscale.macro.joint.geometry import Block, RoughJoint
from multiscale.numerics.factorisation import factorise

if TYPE_CHECKING:
    from skfem import CellBasis

__all__ = ["CondensedJoint", "assemble_joint", "condense_joint"]


@dataclass(frozen=True)
class CondensedJoint:
    """Joint condensed onto the normal jump of its interface, equations (1)-(3)."""

    compliance: np.ndarray  # C, m/N
    motion: np.ndarray  # R
    operator: np.ndarray  # N
    weight: np.ndarray  # omega, m²
    arm: np.ndarray  # l
    area: float  # m²
    solid_stiffness: float  # Pa/m

    def split(self, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Jump j (m), motion w of the platen (m) and nodal force (N) of a solution."""
        n, m = self.motion.shape
        return value[:n], value[n : n + m], value[n + m :]


def assemble_joint(
    joint: RoughJoint,
) -> tuple[csr_array, np.ndarray, csr_array, np.ndarray]:
    """Assemble the joint without condensing it, for :func:`~.monolithic.solve_interface`.

    Parameters
    ----------
    joint : RoughJoint
        Geometry, elasticity and mesh.

    Returns
    -------
    stiffness : csr_array, shape (n, n)
        Of both blocks, N/m. The last unknowns are the motions of the loaded platen: its
        displacement along z and, if it tilts, those of its edges at the largest x and y; all m.
    load : ndarray, shape (n,)
        Force of a unit nominal pressure, N/Pa: multiply by the preload.
    jump_operator : csr_array, shape (3 * points, n)
        Displacement of side 2 minus side 1, normal (z) first, then x and y; dimensionless.
    weight : ndarray, shape (points,)
        Quadrature weights, m².
    """
    lower, upper = _sides(joint)
    motion, arm = _platen_motion(joint, upper, upper.platen), _load_arm(joint)
    operator, weight = _face_quadrature(joint, upper)

    n = lower.basis.N
    held_platen = np.union1d(upper.supports, 3 * upper.platen + 2)
    free = [
        np.setdiff1d(np.arange(3 * n), np.union1d(lower.supports, 3 * lower.platen + 2)),
        np.setdiff1d(np.arange(3 * upper.basis.N), held_platen),
    ]
    place = [
        eye_array(3 * side.basis.N, format="csc")[:, kept]
        for side, kept in zip((lower, upper), free, strict=True)
    ]
    follow = np.zeros((3 * upper.basis.N, arm.size))
    follow[3 * upper.platen + 2] = motion
    expand = block_array([[place[0], None, None], [None, place[1], csr_array(follow)]])

    jump = [
        hstack([-_pick(operator, lower, axis), _pick(operator, upper, axis)]) for axis in (2, 0, 1)
    ]
    stiffness = block_diag([lower.stiffness, upper.stiffness], format="csr")
    load = np.zeros(expand.shape[1])
    load[-arm.size :] = -joint.area * arm
    return (
        csr_array(expand.T @ stiffness @ expand),
        load,
        csr_array(vstack(jump) @ expand),
        weight,
    )


def condense_joint(joint: RoughJoint) -> CondensedJoint:
    """Condense both blocks onto the normal jump."""
    lower, upper = _sides(joint)
    compliance = _face_compliance(lower, "lower") + _face_compliance(upper, "upper")
    motion, arm = _platen_motion(joint, upper, upper.face), _load_arm(joint)
    operator, weight = _face_quadrature(joint, upper)
    # without a jump, (1) and (3) give the approach of the solid joint
    held = motion.T @ np.linalg.solve(compliance, motion)
    solid = 1.0 / (joint.area * float(arm @ np.linalg.solve(held, arm)))
    return CondensedJoint(compliance, motion, operator.toarray(), weight, arm, joint.area, solid)


@dataclass(frozen=True)
class _Side:
    """One block: finite-element space, stiffness (N/m), supports in the plane and faces."""

    basis: "CellBasis"
    stiffness: csr_array
    supports: np.ndarray  # unknowns 3 a + i held in x and y
    face: np.ndarray  # unknowns a on the interface
    platen: np.ndarray  # unknowns a on the platen


def _sides(joint: RoughJoint) -> tuple[_Side, _Side]:
    """Side 1, from z = -height to 0, and side 2, from there to its height."""
    base = -joint.lower.height
    lower = _side(joint, joint.lower, base=base, face="top", platen="bottom")
    return lower, _side(joint, joint.upper, base=0.0, face="bottom", platen="top")


def _side(joint: RoughJoint, block: Block, *, base: float, face: str, platen: str) -> _Side:
    """Mesh and assemble one block, centred on the z axis."""
    length_x, length_y = joint.section
    mesh = box_mesh(
        (length_x, length_y, block.height),
        (*joint.elements, block.layers),
        origin=(-0.5 * length_x, -0.5 * length_y, base),
    )
    basis = displacement_basis(mesh, joint.element)
    stiffness = elastic_matrix(basis, block.law)
    held = face_unknowns(basis, platen)
    first_row = held[: np.intersect1d(held, face_unknowns(basis, "front")).size]
    # statically determinate: corner A in x and y, corner B in y, so that stress is uniaxial
    corner_a, corner_b = first_row[0], first_row[-1]
    supports = np.array([3 * corner_a, 3 * corner_a + 1, 3 * corner_b + 1])
    return _Side(basis, stiffness, supports, face_unknowns(basis, face), held)


def _platen_motion(joint: RoughJoint, side: _Side, unknowns: np.ndarray) -> np.ndarray:
    """Displacement along z that the motions of the platen give to unknowns, dimensionless."""
    x, y, _ = side.basis.doflocs[:, unknowns]
    if joint.eccentricity is None:
        return np.ones((unknowns.size, 1))
    length_x, length_y = joint.section
    return np.stack([np.ones_like(x), 2.0 * x / length_x, 2.0 * y / length_y], axis=1)


def _load_arm(joint: RoughJoint) -> np.ndarray:
    """Displacement of the force along z that the motions of the platen give, dimensionless."""
    if joint.eccentricity is None:
        return np.ones(1)
    tilts = [2.0 * e / length for e, length in zip(joint.eccentricity, joint.section, strict=True)]
    return np.array([1.0, *tilts])


def _face_quadrature(joint: RoughJoint, side: _Side) -> tuple[csr_array, np.ndarray]:
    """Interpolation from the nodes of the interface to its points, and weights in m²."""
    boundary = "bottom"  # of the upper block; the nodes of both faces are numbered alike
    operator, weight, _ = face_operator(side.basis, boundary, order=joint.quadrature_order)
    return csr_array(operator.tocsc()[:, side.face]), weight


def _pick(operator: csr_array, side: _Side, axis: int) -> csr_array:
    """Interpolate one component from all unknowns of a block to the points of its face."""
    columns = 3 * side.face + axis
    select = eye_array(3 * side.basis.N, format="csr")[columns]
    return csr_array(operator @ select)


def _face_compliance(side: _Side, name: str) -> np.ndarray:
    """Condense a block with held platen: normal face displacement per nodal force, m/N."""
    n = 3 * side.basis.N
    held = np.union1d(side.supports, 3 * side.platen + 2)
    free = np.setdiff1d(np.arange(n), held)
    solve = factorise(side.stiffness[free][:, free], name=f"the stiffness of the {name} block")
    rows = np.searchsorted(free, 3 * side.face + 2)
    return compliances(solve, eye_array(free.size, format="csr")[rows])[0]
