r"""Eq (1) on geometries with closed forms of their sections, by bodies and by voxels."""

import numpy as np
import pytest

from multiscale.micro.damage import (
    Cavities,
    VoxelImage,
    boolean_spheres,
    max_damage,
    penny_cracks,
    plane_damage,
    random_spheres,
    spheres,
    voxelise,
)
from multiscale.micro.damage.sections import fit_tensor, sphere_directions
from multiscale.numerics.box_sections import box_section, void_section
from multiscale.schema import DAMAGE_SECTIONS
from tests.micro.damage.solid import CUBE, MIDDLE, channels, ellipsoids, lattice
from tests.support import observed_rate


def random_rotation(seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.diag(r)) * np.sign(np.linalg.det(q * np.sign(np.diag(r))))


# --- closed forms ----------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [0.0, 0.3, -0.49])
def test_through_channels_have_their_volume_fraction_as_damage(offset):
    rve = channels([(0.5, 0.5, 0.2), (0.13, 0.13, 0.0)], (0.3, 0.1))
    expected = np.pi * (0.3**2 + 0.1**2)
    assert plane_damage(rve, (0, 0, 1), offset) == pytest.approx(expected, abs=1e-12)
    width = 2.0 * np.sqrt(0.3**2 - 0.1**2)
    assert plane_damage(rve, (1, 0, 0), 0.1) == pytest.approx(width, abs=1e-10)
    tilted = plane_damage(rve, (1, 1e-8, 1e-9), 0.1)  # no plane is special
    assert tilted == pytest.approx(width, abs=1e-7)


@pytest.mark.parametrize("smallest", [0.3, 0.8])
def test_the_worst_plane_cuts_no_corner_smaller_than_asked_for(smallest):
    rve = Cavities(CUBE, [spheres([[0.2, 0.2, 0.2]], 0.3)])
    damage = max_damage(rve, level=1, sections=9, smallest_section=smallest)
    place = np.array([0.0, float(damage["worst_offset"])])
    through_centre, area = box_section(CUBE, damage["worst_normal"].values, place)
    assert area >= smallest * through_centre
    corners = max_damage(rve, level=1, sections=9, smallest_section=0.0)
    assert corners["maximum_damage"] > 1.1 * damage["maximum_damage"]


def test_the_worst_plane_of_a_lattice_is_the_densest_plane():
    damage = max_damage(lattice("simple cubic", 0.3, edge=1.0), closed=True, level=0)
    assert float(damage["maximum_damage"]) == pytest.approx(np.pi * 0.09, rel=1e-9)
    assert np.sort(np.abs(damage["worst_normal"].values)) == pytest.approx([0, 0, 1])
    phi = 4.0 / 3.0 * np.pi * 0.3**3
    assert float(damage["maximum_damage"]) / phi == pytest.approx(2.5, rel=1e-9)
    damage = max_damage(lattice("face-centred cubic", 0.2, edge=1.0), closed=True, level=0)
    densest = 4.0 * np.pi * 0.2**2 / np.sqrt(3.0)
    assert float(damage["maximum_damage"]) == pytest.approx(densest, rel=1e-6)
    assert np.abs(damage["worst_normal"].values) == pytest.approx(np.full(3, 3**-0.5))


@pytest.mark.parametrize("place", [0.0, 0.5, 1.3])
def test_the_place_of_a_void_in_a_periodic_box_does_not_matter(place):
    rve = Cavities((2.0, 2.0, 2.0), [spheres([[place] * 3], 0.4)])
    damage = max_damage(rve, closed=True, level=0)
    assert float(damage["maximum_damage"]) == pytest.approx(np.pi * 0.04, rel=1e-6)


def test_one_sphere_and_one_ellipsoid_in_a_cube():
    rve = Cavities((2.0, 2.0, 2.0), [spheres([[1.0, 1.0, 1.0]], 0.4)])
    assert plane_damage(rve, (1, 0, 0)) == pytest.approx(np.pi * 0.04, abs=1e-14)
    turn = random_rotation(3)
    body = ellipsoids([[1.0, 1.0, 1.0]], [0.5, 0.3, 0.2], turn)
    rve = Cavities((2.0, 2.0, 2.0), [body], periodic=False)
    normal = turn[:, 0]
    area = box_section(rve.size, normal, np.array([0.0]))[0]
    expected = np.pi * 0.3 * 0.2 / area
    assert plane_damage(rve, normal) == pytest.approx(expected, rel=1e-12)
    straight = Cavities(CUBE, [ellipsoids(MIDDLE, [0.4, 0.3, 0.2])])
    damage = plane_damage(straight, (1, 0, 0), [0.0, 0.2])
    assert damage == pytest.approx(np.pi * 0.06 * np.array([1.0, 0.75]), rel=1e-12)


def test_bodies_that_overlap_are_counted_once():
    rve = Cavities(CUBE, [spheres([[0.4, 0.5, 0.5], [0.6, 0.5, 0.5]], 0.2)])
    lens = 0.08 * (np.arccos(0.5) - 0.5 * np.sqrt(0.75))
    assert plane_damage(rve, (0, 0, 1)) == pytest.approx(np.pi * 0.08 - lens, rel=1e-12)
    twice = Cavities(CUBE, [spheres(MIDDLE * 2, 0.2), ellipsoids(MIDDLE, [0.2, 0.2, 0.2])])
    once = Cavities(CUBE, [spheres(MIDDLE, 0.2)])
    assert plane_damage(twice, (1, 2, 3)) == pytest.approx(plane_damage(once, (1, 2, 3)))


def test_a_body_that_only_touches_an_edge_of_the_section_covers_none_of_it():
    """The edge at y = .2 touches the ellipse in its middle."""
    rve = channels(MIDDLE, [0.3])
    damage = plane_damage(rve, (0, -1, 1), -0.2 / np.sqrt(2.0))
    assert damage == pytest.approx(np.pi * 0.09 / 0.8, rel=1e-9)


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 2, 3), (0.1, -1.0, 1e-6)])
def test_sections_add_up_to_the_volume(normal):
    """The integral of the void area along the normal is the volume, in closed form and voxels."""
    bodies = [spheres([[0.3, 0.4, 0.5]], 0.25), ellipsoids([[0.7, 0.7, 0.5]], [0.15, 0.15, 0.3])]
    rve = Cavities(CUBE, bodies)
    n = np.array(normal) / np.linalg.norm(normal)
    half = 0.5 * np.abs(n).sum()
    offset = half * (2.0 * (np.arange(400) + 0.5) / 400 - 1.0)
    area = box_section(CUBE, n, offset)
    assert area.mean() * 2.0 * half == pytest.approx(1.0, rel=1e-4)
    volume = 4.0 / 3.0 * np.pi * (0.25**3 + 0.15**2 * 0.3)
    computed = np.mean(plane_damage(rve, normal, offset) * area) * 2.0 * half
    assert computed == pytest.approx(volume, rel=2e-3)
    image = voxelise(rve, 32)
    computed = void_section(image.void, image.size, n, offset).mean() * 2.0 * half
    assert computed == pytest.approx(image.porosity, rel=5e-3)


def test_a_voxel_image_is_cut_exactly():
    """One void voxel is a separate box and has the section of a box."""
    void = np.zeros((3, 3, 3), dtype=bool)
    void[1, 1, 1] = True
    image = VoxelImage(void, (3.0, 6.0, 1.5))
    for normal in np.random.default_rng(0).normal(size=(5, 3)):
        n = normal / np.linalg.norm(normal)
        whole = Cavities((1.0, 2.0, 0.5))
        offset = np.array([-0.2, 0.0, 0.3])
        polygon = box_section(whole.size, n, offset)
        np.testing.assert_allclose(
            void_section(image.void, image.size, n, offset), polygon, rtol=1e-12
        )


def test_the_section_of_a_box_is_the_polygon_within_it():
    everything = spheres(MIDDLE, 9.0)
    rve = Cavities(CUBE, [everything], periodic=False)
    for normal in np.random.default_rng(1).normal(size=(20, 3)):
        damage = plane_damage(rve, normal, [0.0, 0.3, -0.4])
        np.testing.assert_allclose(damage[np.isfinite(damage)], 1.0, rtol=1e-12)
    assert np.isnan(plane_damage(rve, (0, 0, 1), 0.6))


# --- flat cracks -----------------------------------------------------------------------------


def test_coplanar_penny_cracks():
    places = [[0.2, 0.2, 0.5], [0.7, 0.3, 0.5], [0.4, 0.8, 0.5]]
    rve = Cavities(CUBE, [penny_cracks(places, (0, 0, 1), 0.15)])
    assert plane_damage(rve, (0, 0, 1)) == pytest.approx(3 * np.pi * 0.15**2, abs=1e-12)
    assert plane_damage(rve, (0, 0, 1), 0.01) == 0.0
    assert plane_damage(rve, (0, 0, 1), 0.01, slab=0.03) == pytest.approx(3 * np.pi * 0.15**2)
    assert plane_damage(rve, (1, 0, 0)) == 0.0
    worst = max_damage(rve, level=1, sections=9)
    assert float(worst["maximum_damage"]) == pytest.approx(3 * np.pi * 0.15**2, abs=1e-9)


def test_a_crack_in_a_face_of_the_periodic_box_counts_once():
    rve = Cavities(CUBE, [penny_cracks([[0.5, 0.5, 1.0]], (0, 0, 1), 0.3)])
    area = np.pi * 0.3**2
    assert plane_damage(rve, (0, 0, 1), -0.5) == pytest.approx(area, abs=1e-12)
    assert plane_damage(rve, (0, 0, 1), [-0.5, 0.5], closed=True) == pytest.approx(area)
    assert voxelise(rve, 50).void.mean() * 50 == pytest.approx(area, rel=0.03)


def test_the_shadow_of_a_crack_falls_with_the_cosine():
    rve = Cavities((9.0, 9.0, 9.0), [penny_cracks([[4.5, 4.5, 4.5]], (0, 0, 1), 0.5)])
    for angle in (0.1, 0.7, 1.4):
        normal = (np.sin(angle), 0.0, np.cos(angle))
        area = box_section(rve.size, np.array(normal), np.array([0.0]))[0]
        shadow = plane_damage(rve, normal) * area
        assert shadow == pytest.approx(np.pi * 0.25 * np.cos(angle), rel=1e-12)


def test_shadows_are_half_their_area_on_the_mean_over_the_directions():
    normals = sphere_directions(4)
    assert np.abs(normals @ [0.3, -0.5, 0.8] / np.linalg.norm([0.3, -0.5, 0.8])).mean() == (
        pytest.approx(0.5, abs=2e-3)
    )


def test_a_crack_through_the_whole_section_is_total_damage():
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), 5.0)])
    assert plane_damage(rve, (0, 0, 1)) == pytest.approx(1.0, abs=1e-15)
    image = voxelise(rve, 9)
    assert plane_damage(image, (0, 0, 1)) == pytest.approx(1.0, abs=1e-14)
    assert float(max_damage(image, level=0, sections=9)["maximum_damage"]) == pytest.approx(1.0)


# --- resolution ------------------------------------------------------------------------------


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 1, 0), (1, 1, 1), (1, 2, 3)], ids=str)
def test_voxels_converge_to_the_closed_form(normal):
    # validation: within 2 % at 16 voxels a radius; the place of the spheres is not special
    places = np.array([[0.31, 0.47, 0.52]])
    rve = Cavities(CUBE, [spheres(places, 0.3)])
    offset = float((places[0] - 0.5) @ normal / np.linalg.norm(normal))
    exact = plane_damage(rve, normal, offset)
    shapes, errors = (13, 27, 53, 107, 213), []
    for n in shapes:
        near = offset + np.linspace(-0.5, 0.5, 5) / n  # within a voxel of the place
        errors.append(np.abs(plane_damage(voxelise(rve, n), normal, near) / exact - 1.0).mean())
    assert errors[2] < 0.02
    assert errors[-1] < 3e-3
    assert observed_rate(1.0 / np.array(shapes), np.array(errors)) > 0.8


def test_half_the_resolution_gives_the_error():
    rve = lattice("simple cubic", 0.3, edge=1.0)
    damage = max_damage(voxelise(rve, 48), level=1, sections=48)
    error = abs(float(damage["maximum_damage"]) - np.pi * 0.09)
    assert error <= 2.0 * float(damage["resolution_error"]) + 1e-3
    assert error < 0.02 * np.pi * 0.09


# --- reported values ------------------------------------------------------------------------


def test_the_dataset_follows_its_schema_and_counts_its_planes():
    damage = max_damage(random_spheres(CUBE, 0.12, porosity=0.1, seed=2), level=1, sections=11)
    DAMAGE_SECTIONS.check(damage)
    assert damage.sizes["direction"] >= 21
    assert damage.sizes["section"] == 11
    assert float(damage["maximum_damage"]) >= float(damage["damage"].max())
    assert np.all(np.diff(damage["quantile_damage"]) >= 0.0)
    normal, offset = damage["worst_normal"].values, float(damage["worst_offset"])
    again = plane_damage(random_spheres(CUBE, 0.12, porosity=0.1, seed=2), normal, offset)
    assert again == pytest.approx(float(damage["maximum_damage"]), rel=1e-12)


def test_the_tensor_returns_a_quadratic_form():
    normals = sphere_directions(1)
    T = np.array([[0.3, 0.05, 0.0], [0.05, 0.2, -0.02], [0.0, -0.02, 0.1]])
    np.testing.assert_allclose(
        fit_tensor(normals, np.einsum("ni,ij,nj->n", normals, T, normals)), T, atol=1e-13
    )


def test_the_tensor_of_aligned_cracks_points_along_their_normal():
    places = np.random.default_rng(1).uniform(size=(40, 3))
    rve = Cavities(CUBE, [penny_cracks(places, (0, 0, 1), 0.1)])
    tensor = max_damage(rve, level=2, sections=9, slab=0.3)["anisotropy"].values
    assert tensor[2, 2] > 2.0 * max(tensor[0, 0], tensor[1, 1])
    assert tensor[0, 0] == pytest.approx(tensor[1, 1], abs=0.15 * tensor[2, 2])


# --- random media ----------------------------------------------------------------------------


def test_zero_porosity_gives_zero_damage():
    for rve in (
        boolean_spheres(CUBE, 0.1, porosity=0.0, seed=0),
        VoxelImage(np.zeros((8, 8, 8)), CUBE),
    ):
        damage = max_damage(rve, level=0, sections=5)
        assert float(damage["maximum_damage"]) == 0.0
        assert not damage["anisotropy"].values.any()


def test_a_packing_does_not_overlap_and_has_the_porosity():
    rve = random_spheres((1.0, 2.0, 0.5), 0.08, porosity=0.3, seed=4)
    for kind in rve.images:
        away = np.linalg.norm(kind.centre[:, None] - kind.centre, axis=2)
        assert away[np.triu_indices_from(away, k=1)].min() >= 0.16
    total = sum(kind.volume.sum() for kind in rve.bodies)
    assert total == pytest.approx(0.3, abs=0.5 * 4.0 / 3.0 * np.pi * 0.08**3)
