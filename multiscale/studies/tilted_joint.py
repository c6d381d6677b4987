"""Two blocks in plane strain between platens: joined by a law, or with their roughness resolved."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_array, hstack, kron, vstack

from multiscale.fe.boxes import plane_block
from multiscale.fe.elasticity import elastic_matrix
from multiscale.fe.faces import face_operator
from multiscale.laws import AreaLaw, NormalLaw
from multiscale.laws.bulk import Elastic
from multiscale.macro.continuum.body import Body, fixed_motion
from multiscale.macro.continuum.contact import Contact
from multiscale.macro.continuum.contact_steps import solve_contact
from multiscale.macro.continuum.finite_assembly import FiniteAssembly
from multiscale.macro.monolithic import solve_interface
from multiscale.micro import FlatCell, Surface, contact_modulus
from multiscale.numerics.factorisation import on_diagonal
from multiscale.studies.rough_structure import Answer, RoughStructure

__all__ = ["TiltedJoint"]


@dataclass(frozen=True)
class TiltedJoint(RoughStructure):
    r"""Two steel blocks in plane strain between platens, one of which comes down tilted.

    Each block is as wide as :math:`\ell` and half as high, and the origin is the middle of the
    interface. The platens hold the far faces; the upper one comes down by

    .. math:: \delta(x) = \delta_0 \left(1 + a\,\frac{2x}{\ell}\right), \qquad
        \delta_0 = 10^{-3} \ell    \tag{1}

    from where the mean planes of the interface coincide. The pressure varies from a fifth to nine
    fifths of its mean, about :math:`10^{-3} E^*`. The profile of the composite roughness has the
    root mean square height :math:`2\cdot 10^{-4}\,\ell`.

    *Resolved*, the face of the upper block is meshed with the profile; *with a law*, both blocks
    are plane. Cells are profiles whose contact modulus is that of both blocks. In two dimensions
    there is no assembly: the matrices go to :func:`solve_interface` by hand.

    Attributes
    ----------
    bulk : Elastic, of both blocks
    tilt : float, :math:`a` of (1), dimensionless
    """

    length = 0.02  # m
    rms_height = 4e-6  # m
    points = 64  # elements along the interface
    areal = False
    bulk: ClassVar[Elastic] = Elastic(210e9, 0.3)
    tilt: ClassVar[float] = 0.8

    @property
    def moduli(self) -> tuple[float, float]:
        """Young's modulus, Pa, and Poisson's ratio."""
        return float(self.bulk.youngs_modulus), float(self.bulk.poissons_ratio)

    @property
    def approach(self) -> float:
        """Mean of (1), m."""
        return 1e-3 * self.length

    @property
    def pressures(self) -> np.ndarray:
        """Mean pressures of cells, Pa: from the light edge to beyond the heavy one."""
        return 1e-3 * contact_modulus(self.moduli) * np.geomspace(0.03, 4.0, 12)

    def cell(self, surface: Surface) -> FlatCell:
        """Return a flat profile with the contact modulus of both blocks."""
        both = contact_modulus(self.moduli, self.moduli) * (1.0 - self.moduli[1] ** 2)
        return FlatCell(surface, 2.0 * max(surface.size), 8, Elastic(both, self.moduli[1]))

    def solve(self, law: NormalLaw, area: AreaLaw | None = None, *, refined: int = 1) -> Answer:
        """Solve the joint with a law of its roughness; layers grow away from the interface."""
        bodies = self._bodies(np.zeros(refined * self.points))
        K = on_diagonal(elastic_matrix(body.basis, self.bulk) for body in bodies)
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
        start = np.zeros(u.size)
        typical = self.approach / self.length * self.moduli[0]
        start[n + 1 :: 2] = float(law.gap_at(np.array(typical))) - law.gap
        solution = solve_interface(
            csr_array(K[free][:, free]),
            -(K @ u)[free],
            csr_array(B[:, free]),
            weight,
            law,
            start=start[free],
            tolerance=1e-8,
        )
        gap = (B[:, free] @ solution.unwrap())[: weight.size] + law.gap
        pressure = law.pressure(gap)
        local = np.full(gap.size, np.nan) if area is None else area.contact_fraction(pressure)
        return _answer(position[0], gap, pressure, local, weight)

    def resolve(self, seed: int, points_per_wave: int) -> Answer:
        """Solve the joint with the profile on the face of the upper block."""
        return self.mesh_profile(self.surface(seed, points_per_wave).heights[:, 0])

    def mesh_profile(self, profile: np.ndarray) -> Answer:
        """Solve the joint with a periodic profile on the face of the upper block.

        Its heights, m, are at equidistant points from the left edge, positive into the lower block;
        every point is a node.
        """
        # the mesh starts clear of the lower block: the platen comes down by this much more
        lower, upper = self._bodies(profile, float(np.max(profile)))
        problem = FiniteAssembly(
            {"lower": lower, "upper": upper},
            {"interface": Contact(("upper", "face"), ("lower", "face"))},
        )
        step = solve_contact(problem, tolerance=1e-8)[-1].unwrap()
        found = step.contact["interface"]
        closed = found.pressure > 0.0
        return _answer(found.position[0], found.gap, found.pressure, closed, found.area)

    def _bodies(self, profile: np.ndarray, lift: float = 0.0) -> tuple[Body, Body]:
        """Lower block, and upper block with a profile on its face, above by a lift, m."""
        size = self.length, 0.5 * self.length

        def come_down(x: np.ndarray, time: float) -> np.ndarray:
            delta = self.approach * (1.0 + self.tilt * 2.0 * x[0] / self.length)  # (1)
            return np.asarray(-time * (delta + lift))

        lower = plane_block(size, np.zeros(profile.size), upper=False)
        upper = plane_block(size, profile, upper=True, lift=lift)
        return (
            Body(lower, self.bulk, {"back": (0.0, 0.0)}),
            Body(upper, self.bulk, {"back": (0.0, come_down)}),
        )


def _answer(
    x: np.ndarray, gap: np.ndarray, pressure: np.ndarray, closed: np.ndarray, weight: np.ndarray
) -> Answer:
    """Answer with means over points of some weights, m."""
    mean = weight / weight.sum()
    return Answer(float(mean @ gap), float(mean @ closed), x, pressure)
