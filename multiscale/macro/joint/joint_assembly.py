"""The two blocks of a joint as an assembly, and condensed onto the normal jump of its interface."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_array, eye_array

from multiscale.errors import MultiscaleError
from multiscale.fe.boxes import box_mesh
from multiscale.fe.condensation import compliances
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.bodies.assembly import Assembly, Interface
from multiscale.macro.bodies.platen import Platen
from multiscale.macro.continuum.body import Body, Pins, Supports
from multiscale.macro.joint.geometry import RoughJoint
from multiscale.macro.substructures.cut_bodies import cut_assembly
from multiscale.numerics.factorisation import factorise

__all__ = ["CondensedJoint", "condense_joint", "pressed_blocks"]


def pressed_blocks(joint: RoughJoint, law: InterfaceLaw) -> Assembly:
    """Press the upper block of a joint on the lower one by a rigid platen.

    The platens are frictionless. Each block is held on its platen at one corner along x and y and
    at another along y, so that an even pressure gives uniaxial stress. The load case is a nominal
    pressure of 1 Pa.

    Parameters
    ----------
    joint : RoughJoint
    law : InterfaceLaw, a law of any kind, with friction too
    """
    x, y = (0.5 * length for length in joint.section)
    stands: Supports = {"bottom": (None, None, 0.0)}
    lifts: Supports = {}
    bodies = []
    for block, base, plate, supports in (
        (joint.lower, -joint.lower.height, -joint.lower.height, stands),
        (joint.upper, 0.0, joint.upper.height, lifts),
    ):
        mesh = box_mesh(
            (*joint.section, block.height), (*joint.elements, block.layers), origin=(-x, -y, base)
        )
        pins: Pins = {(-x, -y, plate): (0.0, 0.0, None), (x, -y, plate): (None, 0.0, None)}
        bodies.append(Body(mesh, block.law, supports, element=joint.element, pins=pins))
    point = None if joint.eccentricity is None else (*joint.eccentricity, joint.upper.height)
    interface = Interface((0, 1), ("top", "bottom"), law, joint.quadrature_order)
    platen_above = Platen(1, "top", -joint.area, point)
    return Assembly(tuple(bodies), (interface,), platens=(platen_above,))


@dataclass(frozen=True, eq=False)
class CondensedJoint:
    r"""Joint condensed onto the elastic jump e of its interface and the motion w of its platen.

    The jump is :math:`j = e + R w`. With the compliance C of both blocks the forces on the nodes
    are :math:`C^{-1} e`, and nothing but the interface resists w.

    Attributes
    ----------
    compliance : ndarray, shape (nodes, nodes), :math:`C`, m/N
    motion : ndarray, shape (nodes, k), :math:`R`, dimensionless
    stiffness : ndarray, shape (nodes + k,) * 2, of e and w, N/m
    load : ndarray, shape (nodes + k,), under a nominal pressure of 1 Pa, N
    jump : csr_array, shape (points, nodes + k), normal jump from e and w, dimensionless
    weight : ndarray, shape (points,), m²
    solid_stiffness : float, of the blocks without a jump between them, Pa/m
    """

    compliance: np.ndarray
    motion: np.ndarray
    stiffness: np.ndarray
    load: np.ndarray
    jump: csr_array
    weight: np.ndarray
    solid_stiffness: float

    @property
    def area(self) -> float:
        """Nominal contact area, m²."""
        return float(self.weight.sum())

    def approach(self, value: np.ndarray) -> float:
        """Approach of the platen where the force acts, m."""
        return float(self.load @ value) / self.area

    def direction(self, B: csr_array, tangent: np.ndarray, force: np.ndarray) -> np.ndarray:
        r"""Newton direction of e and w, m.

        With the stiffness k of the interface between the nodes and the forces out of balance r,

        .. math:: (I + C k)\, j - R w = C r_e, \qquad R^T k j = r_w.    \tag{1}

        Neither bodies nor interface are lost beside the other, however stiff.
        """
        C, R, (n, m) = self.compliance, self.motion, self.motion.shape
        N = B[:, :n].toarray()
        k = N.T @ (tangent[0, 0][:, None] * N)
        reaction = R.T @ k
        scale = 1.0 / (np.abs(reaction).max() or 1.0)  # so that all rows are in metres
        matrix = np.block([[np.eye(n) + C @ k, -R], [scale * reaction, np.zeros((m, m))]])
        right = np.concatenate([C @ force[:n], scale * force[n:]])
        try:
            j, w = np.split(np.linalg.solve(matrix, right), [n])  # (1)
        except np.linalg.LinAlgError as error:
            raise MultiscaleError("the joint is loose: nothing resists its platen") from error
        return np.concatenate([C @ (force[:n] - k @ j), w])


def condense_joint(joint: RoughJoint, law: InterfaceLaw) -> CondensedJoint:
    """Condense both blocks, the platen at rest, onto the normal jump at the nodes.

    The platen moves the upper block as a rigid body, since nothing resists that: no rounding of the
    elasticity enters its motion.
    """
    from scipy.spatial import cKDTree

    assembly = pressed_blocks(joint, law)
    problem, (platen,), (lower, upper) = cut_assembly(assembly), assembly.platens, assembly.bodies
    (interface,), arm = problem.joints, platen.arm(upper)
    found = []
    for place, name, body, first in ((0, "lower", lower, 0), (1, "upper", upper, lower.basis.N)):
        part = problem.substructures[interface.sides[place]]
        nodes = body.nodes(str(assembly.interfaces[0].boundaries[place]))
        number = problem.expansion[3 * (first + nodes) + 2].indices
        face = np.searchsorted(part.unknown, number)
        free = np.flatnonzero(part.unknown < problem.n - arm.size)
        solve = factorise(part.stiffness[free][:, free], name=f"the stiffness of the {name} block")
        rows = eye_array(free.size, format="csr")[np.searchsorted(free, face)]
        values = interface.trace[place][: interface.weight.size, face]  # normal
        found.append((compliances(solve, rows)[0], body.basis.doflocs[:, nodes], values.toarray()))
    (below, beneath, _), (above, position, operator) = found
    order = cKDTree(beneath.T).query(position.T)[1]
    compliance, motion = below[np.ix_(order, order)] + above, platen.motion(upper, position)
    # without a jump, the load moves the platen against the blocks alone
    held = motion.T @ np.linalg.solve(compliance, motion)
    return CondensedJoint(
        compliance,
        motion,
        block_diag(np.linalg.inv(compliance), np.zeros((arm.size,) * 2)),
        np.concatenate([np.zeros(len(motion)), -joint.area * arm]),
        csr_array(np.hstack([operator, operator @ motion])),
        interface.weight,
        1.0 / (joint.area * float(arm @ np.linalg.solve(held, arm))),
    )
