"""Arrangements of spherical cavities: lattices, random packings, Boolean models.

The box is periodic; its lengths ``size``, the ``edge`` of a cubic cell and the ``radius`` of the
spheres are in m. A parameter outside its range is refused.
"""

from math import ceil, log, pi

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.damage.cavities import Cavities, check_box
from multiscale.micro.damage.shapes import spheres

__all__ = ["boolean_spheres", "lattice", "random_spheres"]

LATTICES = {
    "simple cubic": [[0.5, 0.5, 0.5]],
    "body-centred cubic": [[0.25, 0.25, 0.25], [0.75, 0.75, 0.75]],
    "face-centred cubic": [
        [0.25, 0.25, 0.25],
        [0.25, 0.75, 0.75],
        [0.75, 0.25, 0.75],
        [0.75, 0.75, 0.25],
    ],
}
"""Places of the spheres in the cubic cell, relative to its edge."""


def lattice(name: str, radius: float, *, edge: float, cells: int = 1) -> Cavities:
    """Spherical cavities on a cubic lattice.

    Parameters
    ----------
    name : {"simple cubic", "body-centred cubic", "face-centred cubic"}
    radius, edge : float
    cells : int, along each edge of the box
    """
    if name not in LATTICES:
        raise CaseError(f"there is no lattice {name!r}; choose from {sorted(LATTICES)}")
    if cells < 1:
        raise CaseError(f"a lattice needs at least one cell along an edge, got {cells}")
    check_box((edge, edge, edge))
    corner = np.indices((cells, cells, cells)).reshape(3, -1).T
    places = edge * (corner[:, None] + np.array(LATTICES[name])).reshape(-1, 3)
    return Cavities((cells * edge, cells * edge, cells * edge), [spheres(places, radius)])


def random_spheres(
    size: tuple[float, float, float],
    radius: float,
    *,
    porosity: float,
    seed: int,
    max_tries: int = 100_000,
) -> Cavities:
    """Equal spherical cavities that do not overlap, placed one after the other at random.

    Parameters
    ----------
    size, radius
        As of the module.
    porosity : float
        Volume fraction wanted; the number of spheres is rounded. Random addition ends near 0.38.
    seed : int
    max_tries : int, largest number of places tried for one sphere

    Raises
    ------
    CaseError
        If the spheres do not fit.
    """
    check_box(size)
    count = _count(size, radius, porosity)
    rng, box = np.random.default_rng(seed), np.array(size)
    if count and 2.0 * radius > box.min():
        raise CaseError(
            f"spheres of radius {radius:g} m overlap their own images in a box of {size} m; make "
            f"the box larger"
        )
    places = np.empty((0, 3))
    while len(places) < count:
        for _ in range(ceil(max_tries / 1000)):
            trial = rng.uniform(size=(1000, 3)) * box
            free = np.ones(1000, dtype=bool)
            for place in places:
                away = trial - place
                away -= box * np.rint(away / box)
                free &= np.sum(away**2, axis=1) >= 4.0 * radius**2
            if free.any():
                places = np.vstack([places, trial[np.argmax(free)]])
                break
        else:
            raise CaseError(
                f"after {len(places)} of {count} spheres no free place was found for the next; "
                f"a porosity of {porosity:g} is too much for random addition, so lower it or use "
                f"boolean_spheres"
            )
    return Cavities(size, [spheres(places, radius)] if count else [])


def boolean_spheres(
    size: tuple[float, float, float], radius: float, *, porosity: float, seed: int
) -> Cavities:
    r"""Equal spherical cavities at independent places, which may overlap.

    Their number is drawn from Poisson's distribution with the mean :math:`-V \ln(1-\phi) / v` for
    the porosity :math:`\phi` and the volume :math:`v` of a sphere, which makes the expected volume
    fraction the porosity, from 0 to below 1.
    """
    check_box(size)
    _count(size, radius, porosity)
    rng = np.random.default_rng(seed)
    mean = -log(1.0 - porosity) * float(np.prod(size)) / (4.0 / 3.0 * pi * radius**3)
    count = int(rng.poisson(mean))
    places = rng.uniform(size=(count, 3)) * np.array(size)
    return Cavities(size, [spheres(places, radius)] if count else [])


def _count(size: tuple[float, float, float], radius: float, porosity: float) -> int:
    """Find the number of spheres whose volumes add up to the porosity."""
    if not 0.0 <= porosity < 1.0:
        raise CaseError(f"the porosity must lie from 0 to below 1, got {porosity:g}")
    if not (radius > 0.0 and np.isfinite(radius)):
        raise CaseError(f"the radius of the spheres must be positive (m), got {radius:g}")
    return round(porosity * float(np.prod(size)) / (4.0 / 3.0 * pi * radius**3))
