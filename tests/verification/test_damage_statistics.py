r"""Sections of Boolean spheres: mean, variance and maximum over realisations.

The fraction of void in a square section of edge :math:`L` of a periodic volume has the mean
:math:`\phi` (Delesse) and the variance

.. math::
    \frac{1}{L^2} \int_0^{2r} C(s)\, 2\pi s\, \mathrm{d}s, \qquad
    C = (1-\phi)^2 \big[(1-\phi)^{-K} - 1\big], \quad K = 1 - \frac{3s}{4r} + \frac{s^3}{16 r^3},

where K is the overlap of two spheres a distance s apart.
"""

import numpy as np
import pytest
from scipy.integrate import quad

from multiscale.micro.damage import boolean_spheres, plane_damage, voxelise
from tests.support import observed_rate

RADIUS = 1.0
REALISATIONS = 12

# validation: std of the section fraction by the formula; mean over 12 realisations x 3 axes of
# the largest section, and its standard deviation
TABLE = [
    (0.05, 10, 0.0343, 0.114, 0.029),
    (0.10, 10, 0.0469, 0.178, 0.036),
    (0.20, 10, 0.0614, 0.299, 0.036),
]
LARGE = [
    (0.05, 20, 0.0172, 0.088, 0.010),
    (0.10, 20, 0.0234, 0.151, 0.018),
    (0.20, 20, 0.0307, 0.267, 0.017),
]


def section_deviation(porosity, length):
    def integrand(s):
        K = 1.0 - 0.75 * s / RADIUS + s**3 / (16.0 * RADIUS**3)
        return (1.0 - porosity) ** 2 * ((1.0 - porosity) ** -K - 1.0) * 2.0 * np.pi * s

    return np.sqrt(quad(integrand, 0.0, 2.0 * RADIUS)[0]) / length


def sections(porosity, length, *, voxels):
    """Damage of axis sections, shape (realisations, axes, sections)."""
    results = []
    for seed in range(REALISATIONS):
        rve = boolean_spheres((length,) * 3, RADIUS, porosity=porosity, seed=seed)
        if voxels:
            void = voxelise(rve, voxels).void
            results.append([void.mean(axis=axes) for axes in ((1, 2), (0, 2), (0, 1))])
        else:
            offset = length * ((np.arange(6 * length) + 0.5) / (6 * length) - 0.5)
            results.append([plane_damage(rve, axis, offset) for axis in np.eye(3)])
    return np.array(results)


@pytest.mark.parametrize(
    ("porosity", "ratio", "deviation", "largest", "spread"),
    [*TABLE, *(pytest.param(*row, marks=pytest.mark.long) for row in LARGE)],
)
@pytest.mark.parametrize("route", ["bodies", "voxels"])
def test_sections_of_boolean_spheres(porosity, ratio, deviation, largest, spread, route):
    assert section_deviation(porosity, ratio) == pytest.approx(deviation, abs=6e-5)
    damage = sections(porosity, ratio, voxels=6 * ratio if route == "voxels" else 0)
    volume = damage.mean(axis=(1, 2))
    # sections of one realisation depend on each other, realisations do not
    error = volume.std(ddof=1) / np.sqrt(REALISATIONS)
    assert volume.mean() == pytest.approx(porosity, abs=3.0 * error + 1e-3)
    assert damage.std() == pytest.approx(deviation, rel=0.15)
    worst = damage.max(axis=2)
    assert worst.mean() == pytest.approx(largest, abs=3.0 * spread / np.sqrt(REALISATIONS))
    # the size effect: the largest exceeds the mean by 1.6 to 2.2 deviations (.2 for sampling)
    assert 1.4 < (worst.mean() - porosity) / deviation < 2.5


def test_the_largest_section_falls_to_the_porosity_as_the_volume_grows():
    lengths = np.array([5, 10, 20])
    excess = [
        sections(0.1, int(length), voxels=4 * int(length)).max(axis=2).mean() - 0.1
        for length in lengths
    ]
    # 1/L for one section, but a larger volume has more of them to choose from
    assert -1.0 < observed_rate(lengths, excess) < -0.5
    assert np.all(np.diff(excess) < 0.0)
