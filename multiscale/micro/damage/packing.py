"""Random arrangements of cavities: packings of spheres, Boolean models, recipes with cracks.

The box is periodic, and a parameter outside its range is refused.
"""

from dataclasses import dataclass
from math import ceil, exp, log, pi

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.damage.cavities import Cavities, check_box, penny_cracks, spheres


def random_spheres(
    size: tuple[float, float, float],
    radius: float,
    *,
    porosity: float,
    seed: int,
    spread: float = 0.0,
    max_tries: int = 100_000,
) -> Cavities:
    """Spherical cavities that do not overlap, by random sequential addition.

    Parameters
    ----------
    size : tuple of float, lengths of the box along x, y and z, m
    radius : float, median radius, m
    porosity : float
        Volume fraction, met up to the rounding of the number of spheres; at most about 0.38.
    seed : int
    spread : float
        Standard deviation of the logarithm of the log-normal radii; 0 gives equal radii.
    max_tries : int, largest number of places tried for a sphere
    """
    check_box(size)
    _check(radius, porosity, spread)
    rng, box = np.random.default_rng(seed), np.array(size)
    # radii with volumes that add up to the porosity as closely as a number can
    volume = porosity * float(np.prod(size))
    if spread == 0.0:
        radii = np.full(round(volume / _mean_volume(radius, 0.0)), radius)
    else:
        drawn = np.empty(0)
        while (filled := np.cumsum(4.0 / 3.0 * pi * drawn**3)).max(initial=0.0) < volume:
            drawn = np.append(drawn, radius * np.exp(spread * rng.standard_normal(64)))
        radii = drawn[: int(np.argmin(np.abs(np.append(0.0, filled) - volume)))]
    radii = -np.sort(-radii)
    # places, from the largest sphere on
    if len(radii) and 2.0 * radii[0] > box.min():
        raise CaseError(
            f"spheres of radius {radii[0]:g} m overlap their own images in a box of {size} m; "
            f"make the box larger"
        )
    places = np.empty((0, 3))
    while (done := len(places)) < len(radii):
        for _ in range(ceil(max_tries / 1000)):
            trial = rng.uniform(size=(1000, 3)) * box
            free = np.ones(1000, dtype=bool)
            for place, reach in zip(places, radii[:done] + radii[done], strict=True):
                away = trial - place
                away -= box * np.rint(away / box)
                free &= np.sum(away**2, axis=1) >= reach**2
            if free.any():
                places = np.vstack([places, trial[np.argmax(free)]])
                break
        else:
            raise CaseError(
                f"there is no free place after {done} of {len(radii)} spheres; a "
                f"porosity of {porosity:g} is too much for random addition, so lower it or let "
                f"spheres overlap"
            )
    return Cavities(size, [spheres(places, radii)] if len(radii) else [])


def boolean_spheres(
    size: tuple[float, float, float],
    radius: float,
    *,
    porosity: float,
    seed: int,
    spread: float = 0.0,
) -> Cavities:
    r"""Spherical cavities at independent random places, which may overlap.

    Their number is drawn from Poisson's distribution with the mean :math:`-V \ln(1-\phi) / v` for
    the porosity :math:`\phi` and the mean volume :math:`v` of a sphere, which makes the expected
    volume fraction the porosity, from 0 to below 1. Arguments as for :func:`random_spheres`.
    """
    check_box(size)
    rng = np.random.default_rng(seed)
    _check(radius, porosity, spread)
    mean = -log(1.0 - porosity) * float(np.prod(size)) / _mean_volume(radius, spread)
    count = int(rng.poisson(mean))
    places = rng.uniform(size=(count, 3)) * np.array(size)
    radii = radius * np.exp(spread * rng.standard_normal(count))
    return Cavities(size, [spheres(places, radii)] if count else [])


def _mean_volume(radius: float, spread: float) -> float:
    """Mean volume of spheres with log-normal radii, m³."""
    return 4.0 / 3.0 * pi * radius**3 * exp(4.5 * spread**2)


def _check(radius: float, porosity: float, spread: float) -> None:
    if not 0.0 <= porosity < 1.0:
        raise CaseError(f"the porosity must lie from 0 to below 1, got {porosity:g}")
    if not (radius > 0.0 and np.isfinite(radius)):
        raise CaseError(f"the radius of the spheres must be positive (m), got {radius:g}")
    if not 0.0 <= spread <= 1.0:
        raise CaseError(f"the spread of radii must lie from 0 to 1, got {spread:g}")


@dataclass(frozen=True)
class Recipe:
    r"""Distribution of random volumes with pores and cracks.

    Parameters
    ----------
    porosity : float, volume fraction of the pores, 0 without pores
    pore_radius : float, median radius of the pores, m
    pore_spread : float, standard deviation of the logarithm of the radii of pores
    overlap : bool, whether pores may overlap
    crack_density : float, :math:`\rho = N \langle a^3 \rangle / V` of the cracks, 0 without cracks
    crack_radius : float, median radius a of the cracks, m
    crack_spread : float, standard deviation of the logarithm of the radii of cracks
    crack_normal : tuple of float, optional
        Normal of all cracks; directions are evenly distributed over the sphere if not given.
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
        """Draw a periodic volume of a size, m."""
        place = boolean_spheres if self.overlap else random_spheres
        bodies = []
        if self.porosity:
            pores = place(
                size, self.pore_radius, porosity=self.porosity, seed=seed, spread=self.pore_spread
            )
            bodies += [*pores.bodies]
        rng = np.random.default_rng([seed, 1])  # cracks do not depend on the pores
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
