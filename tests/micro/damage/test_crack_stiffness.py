r"""Effective stiffness of cracks, one voxel thick: closed forms, and references of another method.

A penny crack adds :math:`16(1-\nu^2)\rho/3` to the compliance along its normal, and
:math:`16(1-\nu^2)(10-3\nu)\rho/(45(2-\nu))` on the mean over orientations.
"""

import numpy as np
import pytest

from multiscale.micro.damage import (
    Cavities,
    effective_stiffness,
    penny_cracks,
    spheres,
    voxelise,
)
from tests.micro.damage.solid import CUBE, MIDDLE, NU, E, ellipsoids, ratio

CRACK = penny_cracks(MIDDLE, (0, 0, 1), 0.3)
REFERENCES = {
    "crack": ([CRACK], [0.9999, 0.9999, 0.8819]),
    "tilted crack": ([penny_cracks(MIDDLE, (1, 2, 2), 0.3)], [0.9829, 0.9390, 0.9390]),
    "crossing cracks": ([CRACK, penny_cracks(MIDDLE, (1, 0, 0), 0.3)], [0.8714, 0.9999, 0.8714]),
    "crack and sphere": ([CRACK, spheres(MIDDLE, 0.2)], [0.9373, 0.9373, 0.8678]),
}
"""Bodies, and Young's moduli along the edges over the solid modulus.

They come from tetrahedra of second order that follow both faces of the cracks, with quarter points
at their fronts, by a direct solver; elements of .5, .35 and .25 of the edge agree to 2e-4.
"""


def moduli(bodies, n):
    return ratio(effective_stiffness(voxelise(Cavities(CUBE, bodies), n), E, NU))


@pytest.mark.parametrize("name", REFERENCES)
def test_voxels_of_cracks_converge_to_cracks_without_thickness(name):
    """They are softer by an error of first order, which the change from half of them bounds."""
    bodies, exact = REFERENCES[name]
    coarse, fine = moduli(bodies, 16), moduli(bodies, 32)
    error = np.array(exact) - fine
    assert np.all(error > 0.0)
    assert np.all(error < 0.6 * (exact - coarse))
    assert np.all(error < 1.2 * (fine - coarse))
    assert error.max() < 0.02


def test_an_ellipsoid_has_the_stiffness_of_tetrahedra():
    exact = [0.9468, 0.9311, 0.9091]  # by tetrahedra as above, also where it meets the faces
    inner, corner = (
        moduli([ellipsoids(np.array(MIDDLE) + shift, [0.3, 0.2, 0.15])], 32)
        for shift in (np.zeros(3), np.array([0.4375, 0.375, 0.375]))  # whole voxels
    )
    assert inner == pytest.approx(exact, abs=5e-3)
    assert corner == pytest.approx(inner, abs=1e-6)


@pytest.mark.slow
def test_few_penny_cracks_have_the_limit_without_interaction():
    density = 0.01
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), density ** (1.0 / 3.0))])
    S = np.linalg.inv(effective_stiffness(voxelise(rve, 48), E, NU).unwrap()) * E
    normal = 16.0 * (1.0 - NU**2) / 3.0 * density
    assert S[2, 2] - 1.0 == pytest.approx(normal, rel=0.05)
    # sliding of a layer of voxels adds a quarter more than the crack: .6 % of the compliance
    sliding = normal / (1.0 - NU / 2.0)
    assert S[3, 3] == pytest.approx(2.0 * (1.0 + NU) + sliding, rel=0.01)
