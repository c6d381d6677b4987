"""A rough wave on a half-space, with a law of its roughness and with all of it."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import circulant
from scipy.sparse import eye_array

from multiscale.errors import ConvergenceError
from multiscale.laws import AreaLaw, NormalLaw
from multiscale.laws.bulk import Elastic
from multiscale.macro.monolithic import solve_interface
from multiscale.micro import FlatCell, Path, Surface, contact_modulus, solve_cell
from multiscale.studies.rough_structure import Answer, RoughStructure

__all__ = ["RoughWave", "half_space_stiffness"]

STEEL = Elastic(210e9, 0.3)


@dataclass(frozen=True)
class RoughWave(RoughStructure):
    r"""An elastic half-space with a rough wave, pressed against a rigid plane.

    The wave :math:`\Delta \cos(2\pi x/\lambda)` with :math:`\Delta = 0.01\,\lambda` carries the
    mean pressure :math:`p^*/2`, half of what closes it when smooth; the roughness has the root
    mean square height :math:`0.002\,\lambda` and waves from :math:`\varepsilon\lambda` to
    :math:`\varepsilon\lambda/4`, Hurst exponent 0.8. Slopes count as small, however large, so the
    answers depend on ratios alone.

    *Resolved*, it is a flat cell of one period with wave and roughness on it; *with a law*, a wave
    in plane strain. There the displacement of the surface is the change of the gap g up to a
    constant, so that with the stiffness K of :func:`half_space_stiffness` and the weights w

    .. math:: K (g - g_0) + w\,t(g) = -w\,p.    \tag{1}
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
        return contact_modulus((STEEL.youngs_modulus, STEEL.poissons_ratio))

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
        return FlatCell(surface, 2.0 * max(surface.size), 8, STEEL)

    def solve(self, law: NormalLaw, area: AreaLaw | None = None, *, refined: int = 1) -> Answer:
        """Solve the wave with a law of its roughness."""
        points = refined * self.points
        x = self.length * np.arange(points) / points
        initial = self.amplitude * (1.0 - np.cos(2.0 * np.pi * x / self.length))
        K = half_space_stiffness(points, self.length, self.modulus)
        weight = np.full(points, self.length / points)
        found = solve_interface(
            K,
            K @ initial - weight * self.pressure,  # (1)
            eye_array(points, format="csr"),
            weight,
            law,
            start=np.full(points, float(law.gap_at(np.array(self.pressure))) - law.gap),
            tolerance=1e-8,
        )
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


def half_space_stiffness(points: int, length: float, contact_modulus: float) -> np.ndarray:
    r"""Return the surface stiffness of a half-space, periodic, in plane strain."""
    q = 2.0 * np.pi * np.abs(np.fft.fftfreq(points, length / points))
    return np.asarray(circulant(np.fft.ifft(0.5 * contact_modulus * q).real) * (length / points))
