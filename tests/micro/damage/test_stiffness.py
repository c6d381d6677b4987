r"""Effective stiffness of cavities: closed forms, bounds, and references of another method.

In the dilute limit, with :math:`\nu` = .3, a sphere takes
:math:`3(1-\nu)(9+5\nu)/(2(7-5\nu))` = 2.0045 of its volume fraction off Young's modulus.
"""

import numpy as np
import pytest

from multiscale.convergence import Status
from multiscale.errors import ConvergenceError
from multiscale.laws.bulk.bulk_law import VOIGT
from multiscale.micro.damage import (
    Cavities,
    VoxelImage,
    boolean_spheres,
    effective_stiffness,
    penny_cracks,
    plane_damage,
    random_spheres,
    spheres,
    voxelise,
    youngs_modulus_along,
)
from multiscale.micro.damage.rve import SIDES
from tests.closed_forms.elastic_solids import (
    isotropic_stiffness,
)
from tests.micro.damage.solid import CUBE, MIDDLE, NU, E, channels, ellipsoids, lattice, ratio
from tests.support import observed_rate

# --- voxels ----------------------------------------------------------------------------------


def rotate_stiffness(stiffness, Q):
    """Stiffness of the material that Q has turned."""
    place = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
    full = stiffness[place[:, :, None, None], place]
    turned = np.einsum("ia,jb,kc,ld,abcd->ijkl", Q, Q, Q, Q, full, optimize=True)
    i, j = np.array(VOIGT).T
    return turned[i[:, None], j[:, None], i, j]


# validation: through channels along n are the only case of E (1 - D) exactly
def test_channels_through_the_volume_reduce_the_stiffness_by_their_damage():
    image = voxelise(channels(MIDDLE, [0.3]), (64, 64, 1))
    stiffness = effective_stiffness(image, E, NU, tolerance=1e-9)
    # against the damage of the image to round-off: the stress along the channels is uniaxial
    assert ratio(stiffness)[2] == pytest.approx(1.0 - plane_damage(image, (0, 0, 1)), rel=1e-7)
    assert ratio(stiffness)[2] == pytest.approx(1.0 - np.pi * 0.09, rel=0.01)
    # across them it does not hold: the solid between them carries more than its section
    assert ratio(stiffness)[0] > 1.2 * (1.0 - plane_damage(image, (1, 0, 0)))
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = rotate_stiffness(stiffness.value, quarter)
    np.testing.assert_allclose(turned, stiffness.value, atol=1e-6 * E)


def test_layers_have_their_closed_form():
    """Backus: uniform in-plane strain and normal stress."""
    soft = 0.2 * E
    image = VoxelImage(np.arange(10)[None, None, :] >= 6, CUBE)
    value = effective_stiffness(image, E, NU, void_modulus=soft).unwrap()
    share = np.array([0.6, 0.4])
    moduli = np.array([E, soft])
    lame, shear = moduli * NU / ((1 + NU) * (1 - 2 * NU)), moduli / (2 * (1 + NU))
    p_wave = lame + 2 * shear
    c33 = 1.0 / np.sum(share / p_wave)
    c13 = c33 * np.sum(share * lame / p_wave)
    c11 = np.sum(share * (p_wave - lame**2 / p_wave)) + c13**2 / c33
    expected = [c11, c13, c33, 1.0 / np.sum(share / shear), np.sum(share * shear)]
    np.testing.assert_allclose(value[[0, 0, 2, 3, 5], [0, 2, 2, 3, 5]], expected, rtol=1e-9)
    eighth = np.sqrt(0.5) * np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, np.sqrt(2.0)]])
    np.testing.assert_allclose(rotate_stiffness(value, eighth), value, atol=1e-9 * E)


SIDES_OF_A_CUT_SPHERE = {
    "traction": [1.0294, 0.9647, 0.9646, 0.2748, 0.2902, 0.2901],
    "periodic": [1.0397, 1.0479, 1.0478, 0.3044, 0.3038, 0.3037],
    "displacement": [1.0511, 1.0826, 1.0823, 0.3239, 0.3179, 0.3177],
}
"""Diagonal of the stiffness over E, by curved tetrahedra of second order of .3 of the edge."""


@pytest.mark.parametrize("sides", SIDES)
def test_voxels_have_the_stiffness_of_tetrahedra_with_all_sides(sides):
    rve = Cavities(CUBE, [spheres([[0.1, 0.5, 0.5]], 0.3)])  # reaches through a side
    value = effective_stiffness(voxelise(rve, 20), E, NU, sides=sides).unwrap()
    np.testing.assert_allclose(np.diag(value) / E, SIDES_OF_A_CUT_SPHERE[sides], rtol=0.03)


@pytest.mark.slow
def test_voxels_converge_to_tetrahedra_around_a_sphere():
    exact = 0.88595  # E over the solid's by curved tetrahedra of second order, of .5 and .18
    rve = lattice("simple cubic", 0.25, edge=1.0)
    errors = [ratio(effective_stiffness(voxelise(rve, n), E, NU))[0] - exact for n in (12, 24, 48)]
    assert np.all(np.diff(np.abs(errors)) < 0.0)
    assert abs(errors[-1]) < 3e-3


@pytest.mark.slow
def test_iterations_grow_neither_with_the_resolution_nor_with_the_contrast():
    counts = []
    for n, contrast in ((16, 1e2), (32, 1e4), (32, np.inf)):
        image = voxelise(random_spheres(CUBE, 0.2, porosity=0.2, seed=1), n)
        stiffness = effective_stiffness(image, E, NU, void_modulus=E / contrast)
        stiffness.unwrap()
        counts.append(max(int(line.split(": ")[1].split()[0]) for line in stiffness.trail))
    assert max(counts) < 60


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


def test_the_unit_of_length_does_not_matter():
    """Bricks have the same stiffness in another unit of length."""
    rve = Cavities((1.0, 2.0, 0.5), [ellipsoids([[0.5, 1.0, 0.25]], [0.3, 0.5, 0.15])])
    image = voxelise(rve, (12, 16, 16))
    small = VoxelImage(image.void, tuple(1e-9 * length for length in image.size))
    first, other = (effective_stiffness(each, E, NU).unwrap() for each in (image, small))
    np.testing.assert_allclose(other, first, rtol=1e-6, atol=1e-9 * E)


def test_a_soft_filling_is_not_ignored():
    """A contrast of 1e8 across a crack through the section: the stiffness equals a layer."""
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), 5.0)])
    stiffness = effective_stiffness(voxelise(rve, 8), E, NU, void_modulus=1e-8 * E)
    assert stiffness.detail == ""
    assert stiffness.value[2, 2] == pytest.approx(
        1.0 / np.sum(np.array([7.0, 1e8]) / 8.0 / isotropic_stiffness(E, NU)[0, 0]), rel=1e-6
    )


def test_an_unconnected_island_carries_nothing():
    void = np.zeros((12, 12, 12), dtype=bool)
    void[2:10, 2:10, 2:10] = True
    hollow = VoxelImage(void.copy(), CUBE)
    void[4:8, 4:8, 4:8] = False
    island = VoxelImage(void, CUBE)
    first, other = (effective_stiffness(image, E, NU).unwrap() for image in (hollow, island))
    np.testing.assert_allclose(other, first, rtol=1e-6, atol=1e-8 * E)


def test_a_crack_through_the_whole_section_leaves_no_stiffness():
    rve = Cavities(CUBE, [penny_cracks(MIDDLE, (0, 0, 1), 5.0)])
    image = voxelise(rve, 8)
    assert plane_damage(image, (0, 0, 1)) == pytest.approx(1.0)
    stiffness = effective_stiffness(image, E, NU)
    assert stiffness.status is Status.CONVERGED
    assert "zero stiffness for the strains zz, yz, xz: the solid is cut through" in stiffness.detail
    assert ratio(stiffness)[2] == 0.0
    assert ratio(stiffness)[0] == pytest.approx(7.0 / 8.0, rel=1e-6)


def test_a_solve_that_does_not_converge_is_reported():
    image = voxelise(boolean_spheres(CUBE, 0.15, porosity=0.5, seed=1), 16)
    stiffness = effective_stiffness(image, E, NU, max_iterations=3)
    assert stiffness.status is Status.MAX_ITERATIONS
    with pytest.raises(ConvergenceError, match="iteration limit"):
        stiffness.unwrap()


# --- the tensor ------------------------------------------------------------------------------


def test_directions_of_an_isotropic_solid_are_alike():
    normals = np.random.default_rng(1).normal(size=(2, 5, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        youngs_modulus_along(isotropic_stiffness(E, NU), normals), E, rtol=1e-12
    )


# --- refusals --------------------------------------------------------------------------------


@pytest.mark.parametrize("sides", SIDES)
def test_a_solid_box_has_the_stiffness_of_its_material_with_all_sides(sides):
    bricks = VoxelImage(np.zeros((4, 6, 5), dtype=bool), (1.0, 2.0, 0.5))
    value = effective_stiffness(bricks, E, NU, sides=sides, tolerance=1e-8).unwrap()
    assert value == pytest.approx(isotropic_stiffness(E, NU), abs=1e-9 * E)


@pytest.mark.parametrize(
    "image",
    [
        pytest.param(
            voxelise(boolean_spheres(CUBE, 0.15, porosity=0.4, seed=2), 16), id="porosity .4"
        ),
        pytest.param(
            voxelise(Cavities(CUBE, [penny_cracks([[0.5, 0.5, 0.5]], (1, 2, 3), 0.45)]), 15),
            id="a wide crack",
        ),
        pytest.param(
            VoxelImage(np.random.default_rng(seed=1).random((12, 10, 8)) < 0.3, CUBE), id="noise"
        ),
    ],
)
def test_traction_sides_are_softer_than_periodic_sides_and_those_than_displacement_sides(image):
    soft, periodic, stiff = (
        effective_stiffness(image, E, NU, sides=sides).unwrap() for sides in SIDES
    )
    least = -1e-6 * E
    assert np.linalg.eigvalsh(periodic - soft)[0] > least
    assert np.linalg.eigvalsh(stiff - periodic)[0] > least
    assert np.linalg.eigvalsh(soft)[0] > least
    assert np.trace(soft) < 0.999 * np.trace(periodic) < 0.998 * np.trace(stiff)


def test_a_box_that_is_cut_through_carries_nothing_across_with_traction_sides():
    void = np.zeros((8, 8, 8), dtype=bool)
    void[3] = True
    stiffness = effective_stiffness(VoxelImage(void, CUBE), E, NU, sides="traction")
    assert stiffness.converged
    assert "zero stiffness for the strains xx, xz, xy" in stiffness.detail
