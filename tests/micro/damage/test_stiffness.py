r"""Effective stiffness of cavities and cracks: closed forms, bounds, and voxels against meshes.

Coefficients of the dilute limits, with :math:`\nu` = .3: a sphere takes
:math:`3(1-\nu)(9+5\nu)/(2(7-5\nu))` = 2.0045 of its volume fraction off Young's modulus; a penny
crack adds :math:`16(1-\nu^2)\rho/3` to the compliance along its normal, and
:math:`16(1-\nu^2)(10-3\nu)\rho/(45(2-\nu))` on the mean over orientations.
"""

import numpy as np
import pytest

from multiscale.convergence import Status
from multiscale.errors import CaseError, ConvergenceError
from multiscale.micro.damage import (
    Cavities,
    Cracks,
    VoxelImage,
    boolean_spheres,
    cylinders,
    effective_stiffness,
    ellipsoids,
    hashin_shtrikman_bound,
    isotropic_stiffness,
    lattice,
    mesh_stiffness,
    penny_cracks,
    plane_damage,
    random_spheres,
    spheres,
    symmetry_class,
    voigt_bound,
    voxelise,
    youngs_modulus_along,
)
from multiscale.micro.damage.directions import sphere_directions
from multiscale.micro.damage.elasticity import rotate_stiffness
from multiscale.micro.damage.mesh import mesh_cavities
from tests.support import observed_rate

E, NU = 200e9, 0.3
CUBE = (1.0, 1.0, 1.0)
MIDDLE = [[0.5, 0.5, 0.5]]
SPHERE = 3.0 * (1.0 - NU) * (9.0 + 5.0 * NU) / (2.0 * (7.0 - 5.0 * NU))
AXES = np.eye(3)


@pytest.fixture
def gmsh():
    try:
        import gmsh
    except OSError as error:
        pytest.skip(f"gmsh lacks a system library ({error}); README, Limits, names the packages")
    return gmsh


def ratio(solution, normals=AXES):
    """Young's modulus along directions over that of the solid."""
    return youngs_modulus_along(solution.unwrap(), normals) / E


# --- voxels ----------------------------------------------------------------------------------


def test_a_solid_box_is_the_solid():
    solid = VoxelImage(np.zeros((3, 4, 5)), (1.0, 2.0, 3.0))
    found = effective_stiffness(solid, E, NU).unwrap()
    np.testing.assert_allclose(found, isotropic_stiffness(E, NU), rtol=1e-12, atol=1e-3)


# validation: through cylinders along n are the only case of E (1 - D) exactly
def test_cylinders_through_the_volume_lose_their_damage_as_stiffness():
    rve = Cavities(CUBE, [cylinders(MIDDLE, (0, 0, 1), 0.3)])
    image = voxelise(rve, (64, 64, 1))
    found = effective_stiffness(image, E, NU, tolerance=1e-9)
    # against the image's own damage to round-off: the stress along the cylinders is uniaxial
    assert ratio(found)[2] == pytest.approx(1.0 - plane_damage(image, (0, 0, 1)), rel=1e-7)
    assert ratio(found)[2] == pytest.approx(1.0 - np.pi * 0.09, rel=0.01)
    # across them it does not hold: the solid between them carries more than its section
    assert ratio(found)[0] > 1.2 * (1.0 - plane_damage(image, (1, 0, 0)))
    assert symmetry_class(found.value)[0] == "tetragonal about z"


def test_layers_have_their_closed_form():
    """Backus: uniform in-plane strain and normal stress."""
    soft = 0.2 * E
    image = VoxelImage(np.arange(10)[None, None, :] >= 6, CUBE)
    found = effective_stiffness(image, E, NU, void_modulus=soft).unwrap()
    share = np.array([0.6, 0.4])
    moduli = np.array([E, soft])
    lame, shear = moduli * NU / ((1 + NU) * (1 - 2 * NU)), moduli / (2 * (1 + NU))
    p_wave = lame + 2 * shear
    c33 = 1.0 / np.sum(share / p_wave)
    c13 = c33 * np.sum(share * lame / p_wave)
    c11 = np.sum(share * (p_wave - lame**2 / p_wave)) + c13**2 / c33
    expected = [c11, c13, c33, 1.0 / np.sum(share / shear), np.sum(share * shear)]
    np.testing.assert_allclose(found[[0, 0, 2, 3, 5], [0, 2, 2, 3, 5]], expected, rtol=1e-9)
    assert symmetry_class(found)[0] == "transversely isotropic about z"


# validation: 1 - 2.0045 phi within 3 % for phi <= .05
@pytest.mark.parametrize("radius", [0.1, 0.15, 0.2])
def test_few_spherical_voids_have_the_dilute_limit(radius):
    phi = 4.0 / 3.0 * np.pi * radius**3
    image = voxelise(lattice("simple cubic", radius, edge=1.0), 40)
    found = ratio(effective_stiffness(image, E, NU))
    assert found == pytest.approx(np.full(3, 1.0 - SPHERE * phi), rel=0.03)
    # and the loss itself, which is small
    assert 1.0 - found[0] == pytest.approx(SPHERE * phi, rel=0.12)


@pytest.mark.slow
def test_voxels_converge_to_the_mesh_of_a_sphere(gmsh):
    rve = lattice("simple cubic", 0.25, edge=1.0)
    coarse, fine = (ratio(mesh_stiffness(rve, E, NU, element_size=h))[0] for h in (0.4, 0.2))
    assert coarse == pytest.approx(fine, rel=1e-3)
    errors = [ratio(effective_stiffness(voxelise(rve, n), E, NU))[0] - fine for n in (12, 24, 48)]
    assert np.all(np.diff(np.abs(errors)) < 0.0)
    assert abs(errors[-1]) < 3e-3


def test_half_an_image_turned_is_the_tensor_turned():
    rng = np.random.default_rng(2)
    void = rng.uniform(size=(6, 8, 10)) < 0.2
    image = VoxelImage(void, (0.6, 0.8, 1.0))
    turned = VoxelImage(void.transpose(2, 0, 1), (1.0, 0.6, 0.8))
    Q = np.roll(np.eye(3), 1, axis=0)  # x -> y -> z -> x
    one = effective_stiffness(image, E, NU, tolerance=1e-8).unwrap()
    other = effective_stiffness(turned, E, NU, tolerance=1e-8).unwrap()
    np.testing.assert_allclose(other, rotate_stiffness(one, Q), rtol=1e-5, atol=1e-6 * E)


@pytest.mark.slow
@pytest.mark.parametrize("porosity", [0.1, 0.3])
def test_stiffness_stays_within_its_bounds(porosity):
    image = voxelise(random_spheres(CUBE, 0.14, porosity=porosity, seed=3), 32)
    found = effective_stiffness(image, E, NU).unwrap()
    solid = isotropic_stiffness(E, NU)
    assert np.linalg.eigvalsh(voigt_bound(solid, image.porosity) - found).min() > 0.0
    assert np.linalg.eigvalsh(found).min() > 0.0
    bulk, shear = hashin_shtrikman_bound(E, NU, image.porosity)
    assert found[:3, :3].sum() / 9.0 < bulk
    assert np.diag(found)[3:].mean() < shear
    # damage of the weakest section bounds nothing: it is geometric
    assert np.all(ratio(effective_stiffness(image, E, NU)) < 1.0 - image.porosity)


@pytest.mark.slow
def test_iterations_grow_neither_with_the_resolution_nor_with_the_contrast():
    counts = []
    for n, contrast in ((16, 1e2), (32, 1e4), (32, np.inf)):
        image = voxelise(random_spheres(CUBE, 0.2, porosity=0.2, seed=1), n)
        found = effective_stiffness(image, E, NU, void_modulus=E / contrast)
        found.unwrap()
        counts.append(max(int(line.split(": ")[1].split()[0]) for line in found.trail))
    assert max(counts) < 60


@pytest.mark.slow
@pytest.mark.parametrize("contrast", [1e4, np.inf])
def test_percolating_voids_and_high_porosity(contrast):
    image = voxelise(boolean_spheres(CUBE, 0.15, porosity=0.6, seed=1), 32)
    found = effective_stiffness(image, E, NU, void_modulus=E / contrast)
    assert found.status is Status.CONVERGED
    bulk, _ = hashin_shtrikman_bound(E, NU, image.porosity)
    assert 0.0 < ratio(found).min() < ratio(found).max() < bulk / E * 3.0


def test_the_stiffness_has_the_square_of_the_tolerance_as_error():
    image = voxelise(random_spheres(CUBE, 0.2, porosity=0.2, seed=1), 16)
    exact = effective_stiffness(image, E, NU, tolerance=1e-10).unwrap()
    tolerances = np.array([1e-1, 1e-2, 1e-3, 1e-4])
    errors = [
        np.abs(effective_stiffness(image, E, NU, tolerance=t).unwrap() - exact).max() / exact.max()
        for t in tolerances
    ]
    assert observed_rate(tolerances, errors) == pytest.approx(2.0, abs=0.15)
    assert errors[-1] < 1e-7


def test_voxels_need_not_be_cubes():
    """An ellipsoid in a flat box, on voxels of three different edges."""
    rve = Cavities((1.0, 2.0, 0.5), [ellipsoids([[0.5, 1.0, 0.25]], [0.3, 0.5, 0.15])])
    cubes = ratio(effective_stiffness(voxelise(rve, (40, 80, 20)), E, NU))
    bricks = ratio(effective_stiffness(voxelise(rve, (32, 40, 40)), E, NU))
    assert bricks == pytest.approx(cubes, abs=1e-2)
    # the same numbers in another unit of length
    image = voxelise(rve, (12, 16, 16))
    small = VoxelImage(image.void, tuple(1e-9 * length for length in image.size))
    one, other = (effective_stiffness(each, E, NU).unwrap() for each in (image, small))
    np.testing.assert_allclose(other, one, rtol=1e-6, atol=1e-9 * E)


def test_a_body_that_touches_nothing_is_no_stiffness():
    ball = np.logical_not(voxelise(Cavities(CUBE, [spheres(MIDDLE, 0.3)]), 16).void)
    found = effective_stiffness(VoxelImage(ball, CUBE), E, NU)
    assert found.status is Status.CONVERGED
    assert "no stiffness against the strains xx, yy, zz, yz, xz, xy" in found.detail
    np.testing.assert_allclose(found.value, 0.0, atol=1e-12 * E)
    np.testing.assert_array_equal(ratio(found), 0.0)


def test_a_soft_filling_is_not_lost():
    """A contrast of 1e8 across a crack through the section: the stiffness is that of a layer."""
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), 5.0)])
    found = effective_stiffness(voxelise(rve, 8), E, NU, void_modulus=1e-8 * E)
    assert found.detail == ""
    assert found.value[2, 2] == pytest.approx(
        1.0 / np.sum(np.array([7.0, 1e8]) / 8.0 / isotropic_stiffness(E, NU)[0, 0]), rel=1e-6
    )


def test_a_loose_island_carries_nothing():
    void = np.zeros((12, 12, 12), dtype=bool)
    void[2:10, 2:10, 2:10] = True
    hollow = VoxelImage(void.copy(), CUBE)
    void[4:8, 4:8, 4:8] = False
    island = VoxelImage(void, CUBE)
    one, other = (effective_stiffness(image, E, NU).unwrap() for image in (hollow, island))
    np.testing.assert_allclose(other, one, rtol=1e-6, atol=1e-8 * E)


def test_a_crack_through_the_whole_section_leaves_no_stiffness():
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), 5.0)])
    image = voxelise(rve, 8)
    assert plane_damage(image, (0, 0, 1)) == pytest.approx(1.0)
    found = effective_stiffness(image, E, NU)
    assert found.status is Status.CONVERGED
    assert "no stiffness against the strains zz, yz, xz: the solid is cut through" in found.detail
    assert ratio(found)[2] == 0.0
    assert ratio(found)[0] == pytest.approx(7.0 / 8.0, rel=1e-6)


def test_what_does_not_converge_says_so():
    image = voxelise(boolean_spheres(CUBE, 0.15, porosity=0.5, seed=1), 16)
    found = effective_stiffness(image, E, NU, max_iterations=3)
    assert found.status is Status.MAX_ITERATIONS
    with pytest.raises(ConvergenceError, match="iteration limit"):
        found.unwrap()


# --- cracks ----------------------------------------------------------------------------------

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
    ("density", "expected", "tolerance"), [(0.05, 0.8047, 0.025), (0.10, 0.6732, 0.12)]
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


@pytest.mark.slow
@pytest.mark.parametrize(
    "bodies",
    [
        pytest.param(lambda centre: ellipsoids(centre, [0.3, 0.2, 0.15]), id="ellipsoid"),
        pytest.param(lambda centre: penny_cracks(centre, (1, 2, 2), 0.3), id="crack"),
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


@pytest.mark.parametrize(
    "others",
    [
        pytest.param([penny_cracks(MIDDLE, (1, 0, 0), 0.3)], id="crossing crack"),
        pytest.param([spheres(MIDDLE, 0.2)], id="sphere"),
    ],
)
def test_cracks_may_meet_what_is_there(gmsh, others):
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), 0.3), *others])
    found = ratio(mesh_stiffness(rve, E, NU, element_size=0.4))
    # voxels of a crack are a slit of their thickness
    assert found == pytest.approx(ratio(effective_stiffness(voxelise(rve, 33), E, NU)), abs=0.03)
    alone = ratio(mesh_stiffness(Cavities(CUBE, rve.bodies[:1]), E, NU, element_size=0.4))
    assert np.all(found < alone + 1e-3)


def test_a_meshed_crack_through_the_whole_section_leaves_no_stiffness(gmsh):
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), 5.0)])
    found = mesh_stiffness(rve, E, NU, element_size=0.5)
    assert "no stiffness against the strains zz, yz, xz: the solid is cut through" in found.detail
    assert ratio(found) == pytest.approx([1.0, 1.0, 0.0], abs=1e-9)


def test_a_mesh_needs_some_solid(gmsh):
    with pytest.raises(CaseError, match="leave no solid"):
        mesh_cavities(Cavities(CUBE, [cylinders(MIDDLE, (0, 0, 1), 0.8)]), 0.2)


@pytest.mark.slow
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


# --- the tensor ------------------------------------------------------------------------------


def test_directions_of_an_isotropic_solid_are_alike():
    normals = np.random.default_rng(1).normal(size=(2, 5, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        youngs_modulus_along(isotropic_stiffness(E, NU), normals), E, rtol=1e-12
    )


def test_the_symmetry_is_named():
    iso = isotropic_stiffness(1.0, 0.3)
    cubic = iso.copy()
    cubic[3:, 3:] *= 1.5
    quarter = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    ortho = np.diag([1.0, 2.0, 3.0, 0.4, 0.5, 0.6])
    general = iso + 0.1 * np.ones((6, 6))
    assert symmetry_class(iso)[0] == "isotropic"
    assert symmetry_class(cubic)[0] == "cubic"
    assert symmetry_class(rotate_stiffness(cubic, quarter))[0] == "cubic"
    assert symmetry_class(ortho)[0] == "orthotropic"
    assert symmetry_class(general)[0] == "anisotropic"
    name, distances = symmetry_class(rotate_stiffness(iso, quarter))
    assert name == "isotropic"
    assert max(distances.values()) < 1e-12


# --- refusals --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: effective_stiffness(Cavities(CUBE), E, NU), "takes a VoxelImage, got Cavities"),
        (
            lambda: mesh_stiffness(VoxelImage(np.zeros((2, 2, 2)), CUBE), E, NU, element_size=0.1),
            "takes Cavities, got VoxelImage",
        ),
        (
            lambda: effective_stiffness(VoxelImage(np.ones((2, 2, 2)), CUBE), E, NU),
            "holds no solid",
        ),
        (
            lambda: effective_stiffness(VoxelImage(np.zeros((2, 2, 2)), CUBE), -E, NU),
            "youngs_modulus must be positive",
        ),
        (
            lambda: effective_stiffness(VoxelImage(np.zeros((2, 2, 2)), CUBE), E, 0.5),
            "between -1 and 0.5",
        ),
        (
            lambda: effective_stiffness(
                VoxelImage(np.zeros((2, 2, 2)), CUBE), E, NU, void_modulus=-1.0
            ),
            "void_modulus must not be negative",
        ),
        (
            lambda: mesh_stiffness(
                Cavities(CUBE, [penny_cracks([[0.5, 0.5, 1.0]], (0, 0, 1), 0.2)]),
                E,
                NU,
                element_size=0.2,
            ),
            "a crack lies in a face of the box; shift all bodies",
        ),
        (lambda: mesh_stiffness(Cavities(CUBE), E, NU, element_size=0.0), "must be positive"),
        (
            lambda: mesh_stiffness(Cavities(CUBE, periodic=False), E, NU, element_size=0.2),
            "needs a periodic volume",
        ),
    ],
)
def test_what_cannot_be_is_refused_with_a_sentence(call, sentence):
    with pytest.raises(CaseError, match=sentence):
        call()
