"""Two structures that can be solved in three ways: a rough wave and a joint of two blocks."""

from dataclasses import dataclass

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.laws import AreaLaw, NormalLaw
from multiscale.laws.bulk import Elastic
from multiscale.macro.half_space import press_profile
from multiscale.macro.joint.plane_joint import (
    PlaneJoint,
    PlanePressure,
    press_plane_joint,
    resolve_plane_joint,
)
from multiscale.micro import FlatCell, Path, Surface, contact_modulus, solve_cell
from multiscale.studies.rough_structure import Answer, RoughStructure

__all__ = ["RoughWave", "TiltedJoint"]

MODULUS, NU = 210e9, 0.3  # steel


@dataclass(frozen=True)
class RoughWave(RoughStructure):
    r"""An elastic half-space with a rough wave, pressed against a rigid plane.

    The wave :math:`\Delta \cos(2\pi x/\lambda)` with :math:`\Delta = 0.01\,\lambda` carries the
    mean pressure :math:`p^*/2`, half of what closes it when smooth; the roughness has the root
    mean square height :math:`0.002\,\lambda` and waves from :math:`\varepsilon\lambda` to
    :math:`\varepsilon\lambda/4`, Hurst exponent 0.8. Slopes count as small, however large, so the
    answers depend on ratios alone.

    *Resolved*, it is a flat cell of one period with wave and roughness on it; *with a law*, a wave
    in plane strain, :func:`~multiscale.macro.half_space.press_profile`.
    """

    length = 1e-3  # m
    rms_height = 2e-6  # m
    points = 256

    @property
    def amplitude(self) -> float:
        """Of the wave, m."""
        return 0.01 * self.length

    @property
    def modulus(self) -> float:
        """Contact modulus, Pa."""
        return contact_modulus((MODULUS, NU))

    @property
    def pressure(self) -> float:
        """Nominal pressure, Pa."""
        return 0.5 * np.pi * self.modulus * self.amplitude / self.length

    @property
    def pressures(self) -> np.ndarray:
        """Mean pressures of cells, Pa: from the rim of the contact to beyond its crest."""
        return self.pressure * np.geomspace(0.05, 4.0, 10)

    def cell(self, surface: Surface) -> FlatCell:
        """Return a flat cell, deep enough for a half-space."""
        return FlatCell(surface, 2.0 * max(surface.size), 8, Elastic(MODULUS, NU))

    def solve(self, law: NormalLaw, area: AreaLaw | None = None, *, refined: int = 1) -> Answer:
        """Solve the wave with a law of its roughness."""
        points = refined * self.points
        x = self.length * np.arange(points) / points
        gap = self.amplitude * (1.0 - np.cos(2.0 * np.pi * x / self.length))
        found = press_profile(gap, self.length, self.modulus, self.pressure, law, tolerance=1e-8)
        g = found.unwrap() + law.gap
        pressure = law.pressure(g)
        fraction = np.nan if area is None else float(np.mean(area.contact_fraction(pressure)))
        return Answer(float(np.mean(g)), fraction, x, pressure)

    def resolve(self, seed: int, points_per_wave: int) -> Answer:
        """Solve the wave with its roughness on it."""
        rough = self.surface(seed, points_per_wave)
        n = rough.heights.shape[0]
        x = self.length * np.arange(n) / n
        wave = self.amplitude * np.cos(2.0 * np.pi * x / self.length)
        surface = Surface(rough.heights + wave[:, None], rough.size)
        path = Path(pressure=(self.pressure,))
        found = solve_cell(self.cell(surface), path, keep_fields=True)
        if not found["converged"].values.all():
            raise ConvergenceError(
                f"the wave with its roughness resolved by {n} x {n} points did not converge; "
                f"lower points_per_wave"
            )
        one = found.isel(realisation=0, step=0)
        return Answer(
            float(one["mean_gap"]),
            float(one["contact_fraction"]),
            x,
            one["pressure"].values.mean(axis=0),
        )


@dataclass(frozen=True)
class TiltedJoint(RoughStructure):
    r"""Two steel blocks in plane strain between platens, one of which comes down tilted.

    Each block is as wide as :math:`\ell` and half as high; see :class:`PlaneJoint`. The pressure
    varies from a fifth to nine fifths of its mean, about :math:`10^{-3} E^*`. The profile of the
    composite roughness has the root mean square height :math:`2\cdot 10^{-4}\,\ell`.

    *Resolved*, the face of the upper block is meshed with the profile; *with a law*, both blocks
    are plane. Cells are profiles whose contact modulus is that of both blocks.
    """

    length = 0.02  # m
    rms_height = 4e-6  # m
    points = 64  # elements along the interface
    areal = False

    @property
    def joint(self) -> PlaneJoint:
        """Return blocks and motion of the platens."""
        mean = 1e-3 * self.length  # of a solid of both blocks, in plane strain, at 1e-3 E*
        return PlaneJoint(self.length, 0.5 * self.length, MODULUS, NU, mean, tilt=0.8)

    @property
    def pressures(self) -> np.ndarray:
        """Mean pressures of cells, Pa: from the light edge to beyond the heavy one."""
        return 1e-3 * contact_modulus((MODULUS, NU)) * np.geomspace(0.03, 4.0, 12)

    def cell(self, surface: Surface) -> FlatCell:
        """Return a flat profile with the contact modulus of both blocks."""
        both = contact_modulus((MODULUS, NU), (MODULUS, NU)) * (1.0 - NU**2)
        return FlatCell(surface, 2.0 * max(surface.size), 8, Elastic(both, NU))

    def solve(self, law: NormalLaw, area: AreaLaw | None = None, *, refined: int = 1) -> Answer:
        """Solve the joint with a law of its roughness."""
        found = press_plane_joint(self.joint, law, elements=refined * self.points, tolerance=1e-8)
        fraction = np.nan
        if area is not None:
            local = area.contact_fraction(found.pressure)
            fraction = float(found.weight @ local / found.weight.sum())
        return _answer(found, fraction)

    def resolve(self, seed: int, points_per_wave: int) -> Answer:
        """Solve the joint with the profile on the face of the upper block."""
        profile = self.surface(seed, points_per_wave).heights[:, 0]
        found = resolve_plane_joint(self.joint, profile)
        closed = float(found.weight @ (found.pressure > 0.0) / found.weight.sum())
        return _answer(found, closed)


def _answer(found: PlanePressure, fraction: float) -> Answer:
    return Answer(found.mean_gap, fraction, found.position, found.pressure)
