r"""Effective stiffness of cracks, and of meshes around them: closed forms, and voxels beside.

A penny crack adds :math:`16(1-\nu^2)\rho/3` to the compliance along its normal, and
:math:`16(1-\nu^2)(10-3\nu)\rho/(45(2-\nu))` on the mean over orientations.
"""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.micro.damage import (
    Cavities,
    Cracks,
    VoxelImage,
    cylinders,
    effective_stiffness,
    ellipsoids,
    mesh_stiffness,
    penny_cracks,
    spheres,
    voxelise,
)
from multiscale.micro.damage.cavity_mesh import mesh_cavities
from multiscale.micro.damage.directions import sphere_directions
from tests.closed_forms.elastic_solids import isotropic_stiffness
from tests.micro.damage.solid import CUBE, MIDDLE, NU, E, ratio
from tests.support import observed_rate

# validation: plane strain, bar of height W with a crack of length 2a per width W
COLLINEAR = {0.1: 0.98447, 0.3: 0.87187, 0.5: 0.69383, 0.7: 0.49864}


def collinear(damage, n, height):
    """Plane-strain modulus along z of voxels with one row of them taken out, 2a = damage."""
    void = np.zeros((n, 1, height * n), dtype=bool)
    void[: round(damage * n), 0, 0] = True
    image = VoxelImage(void, (1.0, 1.0 / n, float(height)))
    C = effective_stiffness(image, E, NU, tolerance=1e-5).unwrap()
    S = np.linalg.inv(C[np.ix_([0, 2, 4], [0, 2, 4])])  # no strain along y
    return 1.0 / S[1, 1] / (E / (1.0 - NU**2))


@pytest.mark.slow
@pytest.mark.parametrize("damage", COLLINEAR)
def test_collinear_cracks_are_softer_than_their_damage_says(damage):
    height = 3
    extra = 1.0 / COLLINEAR[damage] - 1.0  # x = (4/pi) (-ln cos(pi a / W)) for the height W
    expected = 1.0 / (1.0 + extra / height)
    assert extra == pytest.approx(-4.0 / np.pi * np.log(np.cos(np.pi * damage / 2.0)), rel=2e-3)
    sizes = np.array([40, 80, 160])
    found = np.array([collinear(damage, n, height) for n in sizes])
    limit = 2.0 * found[-1] - found[-2]  # the error is first order in the thickness of the crack
    assert limit == pytest.approx(expected, rel=0.005)
    assert found[-1] == pytest.approx(expected, rel=0.02)
    assert observed_rate(1.0 / sizes, np.abs(found - expected)) == pytest.approx(1.0, abs=0.35)
    # per cell of height W: far from 1 - D
    cell = 1.0 / (1.0 + height * (1.0 / limit - 1.0))
    assert cell > 1.0 - damage + 0.08 if damage < 0.6 else cell > 1.0 - damage + 0.1


def aligned(density, **options):
    radius = density ** (1.0 / 3.0)
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), radius)])
    return mesh_stiffness(rve, E, NU, **options)


@pytest.mark.slow
def test_few_penny_cracks_have_the_limit_without_interaction(gmsh):
    density = 0.01
    C = aligned(density, element_size=0.3).unwrap()
    S = np.linalg.inv(C) * E
    normal = 16.0 * (1.0 - NU**2) / 3.0 * density
    assert S[2, 2] - 1.0 == pytest.approx(normal, rel=0.02)
    assert S[0, 0] - 1.0 == pytest.approx(0.0, abs=1e-3 * normal)
    shear = normal / (1.0 - NU / 2.0)
    assert S[3, 3] - 2.0 * (1.0 + NU) == pytest.approx(shear, rel=0.02)
    # mean over orientations of the added compliance, from the same tensor
    extra = np.zeros((6, 6))
    extra[2, 2], extra[3, 3], extra[4, 4] = (S - np.linalg.inv(isotropic_stiffness(1, NU)))[
        [2, 3, 4], [2, 3, 4]
    ]
    n = np.random.default_rng(0).normal(size=(20000, 3))
    c = (n[:, 2] / np.linalg.norm(n, axis=1)) ** 2
    mean = np.mean(extra[2, 2] * c**2 + extra[3, 3] * c * (1.0 - c))
    expected = 16.0 * (1.0 - NU**2) * (10.0 - 3.0 * NU) / (45.0 * (2.0 - NU)) * density
    assert mean == pytest.approx(expected, rel=0.02)


# validation: E3/E0 = .8047 and .6732 without interaction at rho = .05 and .10
@pytest.mark.parametrize(
    ("density", "expected", "tolerance"),
    [pytest.param(0.05, 0.8047, 0.025, marks=pytest.mark.slow), (0.10, 0.6732, 0.12)],
)
# a cubic array interacts: the compliance added is 8 % larger at the smaller density
def test_a_cubic_array_of_penny_cracks_is_near_the_limit_without_interaction(
    gmsh, density, expected, tolerance
):
    found = ratio(aligned(density, element_size=0.3))
    assert found[2] == pytest.approx(expected, rel=tolerance)
    assert found[0] == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("middle", [(0.5, 0.5, 0.5), (0.95, 0.5, 0.9)], ids=["inside", "edge"])
def test_open_cracks_have_two_sides_and_one_front(gmsh, middle):
    rve = Cavities(CUBE, [penny_cracks([middle], (1, 2, 2), 0.3)])
    mesh = mesh_cavities(rve, 0.2)
    edges = mesh.points[:, mesh.cells]
    volume = np.einsum(
        "ie,ie->e",
        edges[:, 1] - edges[:, 0],
        np.cross(edges[:, 2] - edges[:, 0], edges[:, 3] - edges[:, 0], axis=0),
    )
    assert np.abs(volume).sum() / 6.0 == pytest.approx(1.0, rel=1e-9)
    places, count = np.unique(np.round(mesh.points, 9), axis=1, return_counts=True)
    double = places[:, count == 2]
    assert double.shape[1] > 20
    assert count.max() == 2

    def height_and_radius(points):
        away = points - np.array(middle)[:, None]
        away -= np.rint(away)  # from the nearest image
        above = np.array([1.0, 2.0, 2.0]) / 3.0 @ away
        return above, np.sqrt(np.sum(away**2, axis=0) - above**2)

    above, radius = height_and_radius(double)
    assert np.abs(above).max() < 1e-9
    assert radius.max() < 0.3
    above, radius = height_and_radius(mesh.points[:, mesh.front])
    np.testing.assert_allclose(radius, 0.3, atol=1e-6)
    # periodic images are one, the two sides are two
    moved = np.round(mesh.points - np.floor(mesh.points + 1e-9), 6)
    images = np.unique(np.vstack([moved, mesh.periodic]), axis=1).shape[1]
    assert (
        images
        == mesh.periodic.max() + 1
        == np.unique(moved, axis=1).shape[1]
        + (np.unique(np.round(double - np.floor(double + 1e-9), 6), axis=1).shape[1])
    )


@pytest.mark.parametrize(
    "bodies",
    [
        pytest.param(
            lambda centre: ellipsoids(centre, [0.3, 0.2, 0.15]),
            id="ellipsoid",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            lambda centre: penny_cracks(centre, (1, 2, 2), 0.3), id="crack", marks=pytest.mark.long
        ),
    ],
)
def test_bodies_may_reach_through_the_faces(gmsh, bodies):
    """A shift of the periodic volume changes nothing, and voxels agree with the mesh."""
    inner, face, corner = (
        Cavities(CUBE, [bodies(np.array(MIDDLE) + shift)])
        for shift in ((0.0, 0.0, 0.0), (0.4, 0.0, 0.03), (0.45, 0.4, 0.38))
    )
    found = ratio(mesh_stiffness(inner, E, NU, element_size=0.5))
    for shifted in (face, corner):
        again = ratio(mesh_stiffness(shifted, E, NU, element_size=0.5))
        assert again == pytest.approx(found, abs=2e-3)
    voxels = ratio(effective_stiffness(voxelise(inner, 48), E, NU))
    assert voxels == pytest.approx(found, abs=0.03 if isinstance(inner.bodies[0], Cracks) else 5e-3)


@pytest.fixture(scope="module")
def alone(gmsh):
    """Moduli of a cell with one crack."""
    crack = penny_cracks(MIDDLE, (0, 0, 1), 0.3)
    return ratio(mesh_stiffness(Cavities(CUBE, [crack]), E, NU, element_size=0.4))


@pytest.mark.slow
@pytest.mark.parametrize(
    "others",
    [
        pytest.param([penny_cracks(MIDDLE, (1, 0, 0), 0.3)], id="crossing crack"),
        pytest.param([spheres(MIDDLE, 0.2)], id="sphere"),
    ],
)
def test_cracks_may_meet_what_is_there(alone, others):
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), 0.3), *others])
    found = ratio(mesh_stiffness(rve, E, NU, element_size=0.4))
    # voxels of a crack are a slit of their thickness
    assert found == pytest.approx(ratio(effective_stiffness(voxelise(rve, 33), E, NU)), abs=0.03)
    assert np.all(found < alone + 1e-3)


def test_a_meshed_crack_through_the_whole_section_leaves_no_stiffness(gmsh):
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), 5.0)])
    found = mesh_stiffness(rve, E, NU, element_size=0.5)
    assert "no stiffness against the strains zz, yz, xz: the solid is cut through" in found.detail
    assert ratio(found) == pytest.approx([1.0, 1.0, 0.0], abs=1e-9)


def test_a_mesh_needs_some_solid(gmsh):
    with pytest.raises(CaseError, match="leave no solid"):
        mesh_cavities(Cavities(CUBE, [cylinders(MIDDLE, (0, 0, 1), 0.8)]), 0.2)


@pytest.mark.long
def test_random_penny_cracks_have_the_limit_without_interaction_on_average(gmsh):
    """Validation: E/E0 = .9203 at rho = .05; two cracks at random, through the faces or not.

    Without interaction the mean compliance over directions is the same for every orientation.
    """
    rng, density, count = np.random.default_rng(0), 0.05, 2
    radius = (density / count) ** (1.0 / 3.0)
    places = np.empty((0, 3))
    while len(places) < count:
        trial = rng.uniform(size=3)
        away = trial - places
        if np.all(np.linalg.norm(away - np.rint(away), axis=1) > 1.5 * radius):
            places = np.vstack([places, trial])
    rve = Cavities(CUBE, [penny_cracks(places, rng.normal(size=(count, 3)), radius)])
    along = sphere_directions(2)
    compliance = np.mean(1.0 / ratio(mesh_stiffness(rve, E, NU, element_size=0.5), along))
    assert 1.0 / compliance == pytest.approx(0.9203, rel=0.02)


def test_a_mesh_of_cylinders_through_the_volume(gmsh):
    rve = Cavities((1.0, 1.0, 0.25), [cylinders([[0.5, 0.5, 0.1]], (0, 0, 1), 0.3)])
    found = ratio(mesh_stiffness(rve, E, NU, element_size=0.15))
    assert found[2] == pytest.approx(1.0 - np.pi * 0.09, rel=0.01)
