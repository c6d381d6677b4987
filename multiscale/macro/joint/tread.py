"""Footprint and braking force of a rubber block that slides on the ground under load."""

from dataclasses import dataclass, replace

import numpy as np

from multiscale.convergence import Solution, check_limits
from multiscale.errors import require
from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import RigidContact
from multiscale.laws.bulk import Elastic
from multiscale.laws.friction_laws import SteadySliding
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.bodies.assembly import Assembly, Interface, Platen
from multiscale.macro.continuum.body import Body
from multiscale.macro.monolithic import Assembled
from multiscale.macro.substructures.cut import cut_assembly
from multiscale.macro.substructures.whole import assemble, condense_problem


@dataclass(frozen=True)
class TreadBlock:
    """Elastic block, bonded above to a rigid carcass that is pressed down and does not tilt.

    Parameters
    ----------
    size : tuple of float, lengths along the motion (x), across it (y) and height (z), m
    youngs_modulus, poissons_ratio : float, Pa, and at least 0 and below 1/2
    elements : tuple of int, along x, y and z; 27 nodes each
    """

    size: tuple[float, float, float]
    youngs_modulus: float
    poissons_ratio: float
    elements: tuple[int, int, int] = (10, 6, 3)

    def __post_init__(self) -> None:
        require("youngs_modulus", self.youngs_modulus, "(0, inf)", "Pa")
        require("poissons_ratio", self.poissons_ratio, "[0, 0.5)")

    @property
    def area(self) -> float:
        """Nominal contact area, m²."""
        return self.size[0] * self.size[1]


@dataclass(frozen=True, eq=False)
class CondensedTread:
    """A block condensed once for many laws.

    Attributes
    ----------
    whole : Assembled
        Its unknowns are displacements of the face and, last, of the carcass along z. Side 1 of the
        jump is the ground; the load case is a nominal pressure of 1 Pa.
    lifted : ndarray, shape (n,), unknowns in a unit translation along z, dimensionless
    position : ndarray, shape (2, points), x and y of the points from the centre of the face, m
    """

    block: TreadBlock
    whole: Assembled
    lifted: np.ndarray
    position: np.ndarray

    @property
    def weight(self) -> np.ndarray:
        """Area of the points, m², shape (points,)."""
        return self.whole.weight


@dataclass(frozen=True, eq=False)
class Footprint:
    """Traction between a sliding block and the ground.

    Attributes
    ----------
    traction, jump : ndarray, shape (3, points), normal, along and across the motion; Pa and m
    weight : ndarray, shape (points,), m²
    solution : Solution, with the reason why the solver stopped
    """

    traction: np.ndarray
    jump: np.ndarray
    weight: np.ndarray
    solution: Solution

    @property
    def load(self) -> float:
        """Normal force, N."""
        return float(-self.weight @ self.traction[0])

    @property
    def braking_force(self) -> float:
        """Force of the ground against the motion along x, N."""
        return float(self.weight @ self.traction[1])


def sliding_block(block: TreadBlock, law: InterfaceLaw) -> Assembly:
    """Press a block by its carcass on a rigid ground; the load case is a pressure of 1 Pa."""
    from skfem import ElementHex2

    x, y, _ = block.size
    body = Body(
        box_mesh(block.size, block.elements, origin=(-0.5 * x, -0.5 * y, 0.0)),
        Elastic(block.youngs_modulus, block.poissons_ratio),
        supports={"top": (0.0, 0.0, None)},
        element=ElementHex2(),
    )
    ground = Interface((None, 0), (None, "bottom"), law, quadrature_order=4)
    return Assembly((body,), (ground,), platens=(Platen(0, "top", -block.area),))


def condense_tread(block: TreadBlock) -> CondensedTread:
    """Condense a block onto its face, once for all laws of :func:`slide_tread`."""
    # the matrices do not depend on the law
    problem = cut_assembly(sliding_block(block, RigidContact()))
    small = condense_problem(problem, [problem.n - 1], largest=problem.n).small
    (substructure,), (joint,) = small.substructures, small.joints
    lifted = np.zeros(small.n)
    lifted[substructure.unknown] = substructure.component == 2
    return CondensedTread(block, assemble(small), lifted, joint.position.T[:2])


def slide_tread(
    tread: CondensedTread, law: SteadySliding, pressure: float, *, tolerance: float = 1e-9
) -> Footprint:
    r"""Solve the steady sliding of a block under a mean pressure.

    Parameters
    ----------
    law : SteadySliding, law of the contact, with a velocity along x and y
    pressure : float, nominal, Pa
    tolerance : float, see :func:`~multiscale.macro.monolithic.solve_interface`

    Notes
    -----
    In the frame of the carcass the block is at rest. With its condensed stiffness K, the jump B u
    against the ground and the force :math:`f` on the carcass

    .. math:: K u + B^T (w\, t(B u)) = f.

    Friction bends the block about its leading edge, where the pressure is largest. Where friction
    shears the block by about a third of its height or more, there may be no steady state: see the
    ``detail`` of a solution that did not converge.
    """
    check_limits(tolerance)
    require("the pressure", pressure, "(0, inf)", "Pa")
    closed = float(law.normal.gap_at(np.array(pressure))) - law.normal.gap
    solution = tread.whole.solve(
        law, np.array([pressure]), start=closed * tread.lifted, tolerance=tolerance
    )
    jump = solution.jump
    if not solution.converged:
        solution = replace(solution, detail=_describe_shear(tread.block, law, pressure))
        return Footprint(np.full(jump.shape, np.nan), jump, tread.weight, solution)
    traction = law.respond(jump, np.empty((0, tread.weight.size))).traction
    return Footprint(traction, jump, tread.weight, solution)


def _describe_shear(block: TreadBlock, law: SteadySliding, pressure: float) -> str:
    """Describe the shear of a block by friction at a uniform pressure, Pa."""
    speed = np.array(np.linalg.norm(law.velocity))
    mu = float(law.friction.coefficient(np.array(pressure), speed))
    strain = 2.0 * (1.0 + block.poissons_ratio) * mu * pressure / block.youngs_modulus
    return (
        f"steady sliding did not converge: a friction coefficient of {mu:.3g} at {pressure:.3g} "
        f"Pa would shear the block by {strain:.2g} of its height and bend it over its leading "
        f"edge; reduce friction or pressure, or use stiffer rubber"
    )
