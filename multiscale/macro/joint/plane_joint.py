r"""Two blocks in plane strain between platens: joined by a law, or with their roughness resolved.

Both blocks have width L and height H, and the origin is the middle of the interface. The platens
hold the far faces; the upper one comes down by

.. math:: \delta(x) = \delta_0 \left(1 + a\,\frac{2x}{L}\right)    \tag{1}

from where the mean planes of the interface coincide. Forces are per metre of width. In two
dimensions there is no assembly: the matrices go to :func:`solve_interface` by hand.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import block_diag, csr_array, hstack, kron, vstack

from multiscale.convergence import Solution
from multiscale.errors import CaseError
from multiscale.fe.elasticity import elastic_matrix
from multiscale.fe.faces import face_operator
from multiscale.laws.bulk import Elastic
from multiscale.laws.interface_law import NormalLaw
from multiscale.macro.continuum.body import Body, fixed_motion
from multiscale.macro.continuum.contact_steps import ContactStep, solve_contact
from multiscale.macro.continuum.finite_assembly import FiniteAssembly
from multiscale.macro.continuum.interface import Contact
from multiscale.macro.monolithic import solve_interface

if TYPE_CHECKING:
    from skfem import Mesh

__all__ = ["PlaneJoint", "PlanePressure", "press_plane_joint", "resolve_plane_joint"]

GROWTH = 1.25
"""Height of a layer of elements over the height of the next one towards the interface."""


@dataclass(frozen=True)
class PlaneJoint:
    r"""Geometry, elasticity and loading of the joint.

    Parameters
    ----------
    width, height : float, L, and H of each block, m
    youngs_modulus, poissons_ratio : float, moduli of both blocks, Pa and 1
    approach : float, :math:`\delta_0` of (1), m
    tilt : float, :math:`a` of (1), dimensionless

    Raises
    ------
    CaseError
        If a length is not positive or the tilt lifts an edge of the platen.
    """

    width: float
    height: float
    youngs_modulus: float
    poissons_ratio: float
    approach: float
    tilt: float = 0.0

    def __post_init__(self) -> None:
        for name in ("width", "height", "approach"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise CaseError(f"{name} must be positive (m), got {getattr(self, name):g}")
        if not abs(self.tilt) <= 1.0:
            raise CaseError(
                f"tilt must lie between -1 and 1, where one edge of the platen stays, got "
                f"{self.tilt:g}"
            )

    @property
    def bulk(self) -> Elastic:
        """Elasticity of both blocks."""
        return Elastic(self.youngs_modulus, self.poissons_ratio)

    def motion(self, x: np.ndarray) -> np.ndarray:
        """Displacement of the upper platen along y, (1), m."""
        return -self.approach * (1.0 + self.tilt * 2.0 * x / self.width)


@dataclass(frozen=True)
class PlanePressure:
    """Interface of a pressed joint.

    Attributes
    ----------
    position : ndarray, shape (points,), x, m
    gap, pressure : ndarray, shape (points,), m and Pa
    weight : ndarray, shape (points,), m
    solution : Solution, why the solver stopped
    """

    position: np.ndarray
    gap: np.ndarray
    pressure: np.ndarray
    weight: np.ndarray
    solution: Solution

    @property
    def mean_gap(self) -> float:
        """Mean over the nominal area, m."""
        return float(self.weight @ self.gap / self.weight.sum())

    @property
    def mean_pressure(self) -> float:
        """Force over the nominal area, Pa."""
        return float(self.weight @ self.pressure / self.weight.sum())


def press_plane_joint(
    joint: PlaneJoint, law: NormalLaw, *, elements: int = 32, tolerance: float = 1e-9
) -> PlanePressure:
    """Press the joint with a law between plane blocks.

    Parameters
    ----------
    joint : PlaneJoint
    law : NormalLaw, law of the interface
    elements : int, along x; the layers grow from there away from the interface
    tolerance : float, see :func:`~multiscale.macro.monolithic.solve_interface`

    Raises
    ------
    ConvergenceError
        If the solver does not converge.
    """
    bodies = _bodies(joint, np.zeros(elements))
    K = csr_array(block_diag([elastic_matrix(body.basis, joint.bulk) for body in bodies]))
    n = bodies[0].basis.doflocs.size
    (below, motion_below), (above, motion_above) = (fixed_motion(body, 1.0) for body in bodies)
    fixed, u = np.append(below, n + above), np.zeros(K.shape[0])
    u[fixed] = np.append(motion_below, motion_above)
    free = np.setdiff1d(np.arange(u.size), fixed)

    (lower, _, _), (upper, weight, position) = (
        face_operator(body.basis, "face") for body in bodies
    )
    axes = np.array([[[0.0, 1.0]], [[1.0, 0.0]]])  # normal first
    B = csr_array(vstack([hstack([-kron(lower, axis), kron(upper, axis)]) for axis in axes]))
    normal = weight.size
    start = np.zeros(u.size)
    typical = 0.5 * joint.approach / joint.height * joint.youngs_modulus
    start[n + 1 :: 2] = float(law.gap_at(np.array(typical))) - law.gap
    solution = solve_interface(
        csr_array(K[free][:, free]),
        -(K @ u)[free],
        csr_array(B[:, free]),
        weight,
        law,
        start=start[free],
        tolerance=tolerance,
    )
    gap = (B[:, free] @ solution.unwrap())[:normal] + law.gap
    return PlanePressure(position[0], gap, law.pressure(gap), weight, solution)


def resolve_plane_joint(
    joint: PlaneJoint, profile: np.ndarray, *, tolerance: float = 1e-8
) -> PlanePressure:
    """Press the joint with the roughness on the face of the upper block, meshed.

    Parameters
    ----------
    joint : PlaneJoint
    profile : ndarray, shape (points,)
        Heights of a periodic profile at equidistant points from the left edge, positive into the
        lower block, m. Every point is a node.
    tolerance : float, see :func:`~multiscale.macro.continuum.solve_contact`

    Raises
    ------
    ConvergenceError
        If the solver does not converge.
    """
    # the mesh starts clear of the lower block: the platen comes down by this much more
    lower, upper = _bodies(joint, profile, float(np.max(profile)))
    problem = FiniteAssembly(
        {"lower": lower, "upper": upper},
        {"interface": Contact(("upper", "face"), ("lower", "face"))},
    )
    step: ContactStep = solve_contact(problem, tolerance=tolerance)[-1].unwrap()
    found = step.contact["interface"]
    return PlanePressure(found.position[0], found.gap, found.pressure, found.area, step.solution)


def _bodies(joint: PlaneJoint, profile: np.ndarray, lift: float = 0.0) -> tuple[Body, Body]:
    """Lower block, and upper block with a profile on its face, which starts above by a lift, m."""
    lower = Body(
        _block(joint, np.zeros(profile.size), upper=False), joint.bulk, {"back": (0.0, 0.0)}
    )
    upper = Body(
        _block(joint, profile, upper=True, lift=lift),
        joint.bulk,
        {"back": (0.0, lambda x, time: time * (joint.motion(x[0]) - lift))},
    )
    return lower, upper


def _block(joint: PlaneJoint, profile: np.ndarray, *, upper: bool, lift: float = 0.0) -> "Mesh":
    """Mesh a block, finest at the interface, whose face bulges by the profile out of it."""
    from skfem import MeshQuad

    n, L, H = profile.size, joint.width, joint.height
    ratio = H * n / L
    layers = max(2, int(np.ceil(np.log1p(ratio * (GROWTH - 1.0)) / np.log(GROWTH))))
    thickness = GROWTH ** np.arange(layers)
    z = np.append(0.0, np.cumsum(thickness) / thickness.sum())  # distance from the face over H
    mesh = MeshQuad.init_tensor(np.arange(n + 1) / n, z).with_boundaries(
        {"face": lambda x: x[1] == 0.0, "back": lambda x: x[1] == 1.0}
    )
    x, y = mesh.p
    column = np.rint(x * n).astype(int) % n
    place = np.stack([L * (x - 0.5), H * y - (1.0 - y) * profile[column] + lift])
    if upper:
        return MeshQuad(place, mesh.t).with_boundaries(mesh.boundaries)
    mirrored = MeshQuad(place * np.array([[1.0], [-1.0]]), np.ascontiguousarray(mesh.t[::-1]))
    # turned elements: their facets have other numbers
    y = mirrored.p[1]
    return mirrored.with_boundaries(
        {"face": lambda x: x[1] == y.max(), "back": lambda x: x[1] == y.min()}
    )
