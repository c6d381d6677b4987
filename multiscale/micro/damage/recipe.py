r"""Random volumes with spherical pores and penny-shaped cracks."""

from dataclasses import dataclass
from math import exp

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.damage.cavities import Cavities
from multiscale.micro.damage.cavity_packing import boolean_spheres, random_spheres
from multiscale.micro.damage.shapes import penny_cracks

__all__ = ["Recipe"]


@dataclass(frozen=True)
class Recipe:
    r"""Law of random volumes.

    Parameters
    ----------
    porosity : float, volume fraction of the pores, 0 without pores
    pore_radius : float, median radius of the pores, m
    pore_spread : float, standard deviation of the logarithm of the radii of pores
    overlap : bool, whether pores may overlap
    crack_density : float, :math:`\rho = N \langle a^3 \rangle / V` of the cracks, 0 without cracks
    crack_radius : float, median radius a of the cracks, m
    crack_spread : float, standard deviation of the logarithm of their radii
    crack_normal : tuple of float, optional
        Normal of all cracks; directions are evenly distributed over the sphere if not given.

    Raises
    ------
    CaseError
        If the crack density is negative or a length is missing.
    """

    porosity: float = 0.0
    pore_radius: float = 0.0
    pore_spread: float = 0.0
    overlap: bool = False
    crack_density: float = 0.0
    crack_radius: float = 0.0
    crack_spread: float = 0.0
    crack_normal: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.crack_density < 0.0 or self.porosity < 0.0:
            raise CaseError(
                f"porosity and crack density must not be negative, got {self.porosity:g} and "
                f"{self.crack_density:g}"
            )
        for share, radius, name in (
            (self.porosity, self.pore_radius, "pore_radius"),
            (self.crack_density, self.crack_radius, "crack_radius"),
        ):
            if share > 0.0 and not radius > 0.0:
                raise CaseError(f"{name} must be positive (m), got {radius:g}")

    def draw(self, size: tuple[float, float, float], seed: int) -> Cavities:
        """Draw a periodic volume of a size, m.

        Raises
        ------
        CaseError
            If the pores do not fit.
        """
        place = boolean_spheres if self.overlap else random_spheres
        bodies = []
        if self.porosity:
            pores = place(
                size, self.pore_radius, porosity=self.porosity, seed=seed, spread=self.pore_spread
            )
            bodies += [*pores.bodies]
        rng = np.random.default_rng([seed, 1])  # cracks do not change with the pores
        mean_cube = self.crack_radius**3 * exp(4.5 * self.crack_spread**2)
        count = (
            round(self.crack_density * float(np.prod(size)) / mean_cube)
            if self.crack_density
            else 0
        )
        if count:
            centres = rng.uniform(size=(count, 3)) * np.array(size)
            normals = rng.standard_normal((count, 3))
            normals = normals if self.crack_normal is None else np.array(self.crack_normal)
            radii = self.crack_radius * np.exp(self.crack_spread * rng.standard_normal(count))
            bodies.append(penny_cracks(centres, normals, radii))
        return Cavities(size, bodies)
