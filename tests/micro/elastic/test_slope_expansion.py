"""The flat cell to second order in the slope: against the conforming cell, and its operator."""

from functools import partial

import numpy as np
import pytest

from multiscale.laws.bulk import Elastic
from multiscale.micro import Cell, Coating, Path, SecondBody, solve_cell
from multiscale.micro.elastic.compliance import expanded_compliance
from multiscale.surfaces import Surface
from tests.support import egg_box, flat, rough_square, wave


def bumps(slope):
    return egg_box(8, slope / (np.sqrt(2.0) * np.pi))


def correction(surface, poissons_ratio):
    """Correction C_1, without C_0, of an elastic body with the shear modulus 1/2."""
    return of_pair((surface, flat(len(surface.heights))), (0.5, np.inf), (poissons_ratio, 0.0))


def of_pair(surfaces, shear, poissons_ratio):
    """Correction C_1, without C_0, of two bodies."""
    nx, ny = surfaces[0].heights.shape
    return expanded_compliance(surfaces, np.zeros((nx, ny // 2 + 1)), shear, poissons_ratio)


def changed_gap(n=32, share=1.0, **kind):
    """Gap over slope, less the one of vanishing slopes, which takes away the error of elements.

    The obstacle carries the heights that the surface leaves.
    """
    gaps = []
    for slope in (1e-5, 0.08, 0.16):
        heights = egg_box(n, slope / (np.sqrt(2.0) * np.pi)).heights
        surface, under = (Surface(part * heights, (1.0, 1.0)) for part in (share, share - 1.0))
        cell = Cell(surface, 1.0, 10, 1.0, 0.3, obstacle=under if share < 1.0 else None, **kind)
        path = Path(pressure=(0.4 * slope,))
        gaps.append(solve_cell(cell, path, tolerance=1e-6)["mean_gap"].values[0] / slope)
    return np.subtract(gaps[1:], gaps[0])


def test_conforming_minus_expanded_is_of_second_order_in_the_slope():
    conforming = changed_gap(geometry="conforming")
    differences = [
        np.abs(conforming - changed_gap(geometry="flat", slope_order=order)) for order in (1, 2)
    ]
    first, second = (np.log2(difference[1] / difference[0]) for difference in differences)
    np.testing.assert_allclose(first, 0.85, atol=0.1)
    np.testing.assert_allclose(second, 2.0, atol=0.4)
    assert np.all(differences[1] < 0.25 * differences[0])


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_slopes_of_a_rough_obstacle_are_expanded_too(share):
    conforming = changed_gap(64, share)
    first, second = (
        np.abs(conforming - changed_gap(64, share, geometry="flat", slope_order=order))
        for order in (1, 2)
    )
    assert np.log2(second[1] / second[0]) == pytest.approx(2.0, abs=0.1)
    assert second[0] < 0.4 * first[0]


def test_two_bodies_comply_as_each_of_them_under_the_surface_between():
    h = [rough_square(24, 0.5, 0.25, slope, seed=seed) for seed, slope in enumerate((0.1, 0.3))]
    shear, nu, force = (0.5, 2.0), (0.1, 0.3), np.random.default_rng(3).random((24, 24))
    k = [(1.0 - ratio) / modulus for modulus, ratio in zip(shear, nu, strict=True)]
    between = (k[1] * h[0].heights - k[0] * h[1].heights) / sum(k)
    rigid = [Surface(sign * between, (1.0, 1.0)) for sign in (-1.0, 1.0)]
    apart = [of_pair((h[i], rigid[i]), (shear[i], np.inf), (nu[i], 0.0)) for i in (0, 1)]
    both = of_pair(h, shear, nu)
    for vertical in (False, True):
        expected = sum(item(force, vertical=vertical) for item in apart)
        np.testing.assert_allclose(both(force, vertical=vertical), expected, rtol=1e-9)
    other = np.random.default_rng(4).random((24, 24))
    assert np.vdot(other, both(force)) == pytest.approx(np.vdot(force, both(other)), rel=1e-12)
    assert np.vdot(other, both(force, vertical=True)) != pytest.approx(np.vdot(other, both(force)))


def test_the_energy_of_the_correction_is_stress_and_strain_of_the_flat_top_times_the_height():
    n, nu = 32, 0.2
    surface = rough_square(n, 1.0, 0.25, 0.3)
    x = np.broadcast_to(np.cos(2.0 * np.pi * np.arange(n) / n)[:, None], (n, n))
    force = x + 2.0 * x.T + 0.5
    f = force * n**2  # Pa
    direct = (1.0 - 2.0 * nu) * np.stack([x, 2.0 * x.T]) * n**2  # strains along x and along y
    in_plane = np.sum(direct, axis=0)
    lame = nu / (1.0 - 2.0 * nu)
    normal = (f - lame * in_plane) / (lame + 1.0)
    stresses = lame * (in_plane + normal) + direct
    expected = np.mean(surface.heights * (f * normal - np.sum(stresses * direct, axis=0)))  # (2)
    assert np.vdot(force, correction(surface, nu)(force)) == pytest.approx(expected, rel=1e-10)


def test_slopes_change_nothing_where_volume_stays_and_only_the_mean_in_plane_strain():
    force = np.random.default_rng(2).random((24, 24))
    still = correction(rough_square(24, 0.5, 0.25, 0.3), 0.5)(force)
    np.testing.assert_allclose(still, 0.0, atol=1e-12)
    ridge, along = wave((24, 24), 0.01), force[:, :1] + np.zeros((24, 24))
    mean = np.mean(along) * ridge.heights + np.mean(ridge.heights * along)
    np.testing.assert_allclose(correction(ridge, 0.2)(along), 0.6 * 24**2 * mean, rtol=1e-10)


steep = partial(Cell, geometry="flat", slope_order=2)


thin, film = SecondBody(0.2, 4, Elastic(1.0, 0.3)), (Coating(0.1, 2.0, 0.3),)
