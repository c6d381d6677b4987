"""The two blocks of a joint as an assembly, and condensed onto the normal jump of its interface."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import eye_array

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
    # without a jump, (1) and (3) give the approach of the solid joint
    held = motion.T @ np.linalg.solve(compliance, motion)
    solid = 1.0 / (joint.area * float(arm @ np.linalg.solve(held, arm)))
    return CondensedJoint(compliance, motion, operator, interface.weight, arm, joint.area, solid)
