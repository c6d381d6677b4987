"""Which waves hold a map's height and slope, and where its lay runs."""

import numpy as np
import pytest

from multiscale.surfaces import (
    Surface,
    crop,
    find_lay,
    low_pass,
    mirror,
    rms_height,
    rms_slope,
    self_affine,
    spectrum,
)

SIZE = (1.0e-4, 1.5e-4)
BAND = {"hurst_exponent": 0.8, "long_cutoff": 0.5e-4, "short_cutoff": 0.4e-5}


@pytest.fixture
def rough():
    return self_affine((96, 144), SIZE, 3, rms_height=1e-6, **BAND)


@pytest.mark.parametrize("share", [0.5, 0.9, 0.999])
@pytest.mark.parametrize(
    ("order", "statistic"), [pytest.param(0, rms_height, id="height"), (2, rms_slope)]
)
def test_the_cutoff_for_a_share_is_the_longest_that_leaves_it(rough, share, order, statistic):
    waves = spectrum([rough])
    cutoff = waves.cutoff_holding(share, order=order)
    assert statistic(low_pass(rough, cutoff)) >= share * statistic(rough) * (1.0 - 1e-12)
    longer = 2.0 * np.pi / waves.wavenumber[waves.wavenumber < 2.0 * np.pi / cutoff * (1 - 1e-9)]
    assert statistic(low_pass(rough, longer[-1])) < share * statistic(rough)


def test_the_length_for_a_share_is_the_shortest_with_waves_that_contain_it(rough):
    length = spectrum([rough]).length_holding(0.9)
    longer = low_pass(rough, length * (1.0 + 1e-6))  # the waves beyond that length
    assert 1.0 - rms_height(longer) ** 2 / rms_height(rough) ** 2 >= 0.81 - 1e-9
    longer = low_pass(rough, length)
    assert 1.0 - rms_height(longer) ** 2 / rms_height(rough) ** 2 < 0.81


@pytest.mark.parametrize("order", [0, 2])
def test_two_waves_share_the_roughness_by_their_squares(order):
    n, waves, amplitude = 64, np.array([4, 10]), np.array([3e-6, 1e-6])
    x = np.arange(n) / n
    heights = (amplitude * np.cos(2.0 * np.pi * np.outer(x, waves))).sum(axis=1)
    surface = Surface(np.repeat(heights[:, None], n, axis=1), (1.0, 1.0))
    parts = amplitude * waves ** (order / 2)
    share = spectrum([surface]).share(1.0, 1.0 / 7.0, order=order)
    assert share == pytest.approx(parts[0] / np.hypot(*parts), rel=1e-6)
    assert spectrum([surface]).share(1.0 / 7.0, 0.09, order=order) == pytest.approx(
        parts[1] / np.hypot(*parts), rel=1e-6
    )


def test_the_waves_of_a_map_equal_its_mirror_image(rough):
    whole = crop(rough, (5, 7), (40, 61))
    inside, outside = spectrum([whole], periodic=False), spectrum([mirror(whole)])
    first, other = inside.roughness(), outside.roughness()
    assert first.rms_height == pytest.approx(rms_height(whole), rel=1e-12)
    assert first.rms_height == pytest.approx(other.rms_height, rel=1e-12)
    assert first.rms_slope == pytest.approx(rms_slope(mirror(whole)), rel=1e-3)
    assert first.longest_wave == pytest.approx(other.longest_wave)


def test_longest_and_shortest_wave_are_the_ends_of_the_band(rough):
    roughness = spectrum([rough]).roughness()
    assert 0.8 * BAND["long_cutoff"] <= roughness.longest_wave <= BAND["long_cutoff"] * (1 + 1e-9)
    assert (
        BAND["short_cutoff"] * (1 - 1e-9) <= roughness.shortest_wave <= 1.1 * BAND["short_cutoff"]
    )


def test_filled_points_count_for_nothing(rough):
    filled = np.zeros(rough.heights.shape, dtype=bool)
    filled[20:60, 30:110] = True
    heights = np.where(filled, 5e-6, rough.heights)  # whatever the filling has put there
    roughness = spectrum([Surface(heights, SIZE, filled)], periodic=False).roughness()
    assert roughness.rms_height == pytest.approx(rough.heights[~filled].std(), rel=1e-12)
    whole = spectrum([rough], periodic=False).roughness()
    assert roughness.rms_slope == pytest.approx(whole.rms_slope, rel=0.05)


def ridges(degrees, n=128):
    """Parallel ridges at an angle to the x axis, with a little noise."""
    random = np.random.default_rng(seed=2)
    angle = np.deg2rad(degrees)
    x, y = np.meshgrid(np.arange(n) / n, np.arange(n) / n, indexing="ij")
    across = -np.sin(angle) * x + np.cos(angle) * y
    heights = sum(
        random.standard_normal() * np.cos(2.0 * np.pi * k * across + random.uniform(0.0, 6.0))
        for k in np.arange(3.0, 12.0, 0.37)
    )
    return Surface(heights + 0.1 * random.standard_normal(x.shape), (1.0, 1.0))


@pytest.mark.parametrize("degrees", [0, 30, 45, 90, 120])
def test_the_lay_and_the_share_that_a_mirror_removes_are_read_from_the_spectrum(degrees):
    lay = find_lay(ridges(degrees), 0.05)
    turned = (np.rad2deg(lay.angle) - degrees + 90.0) % 180.0 - 90.0
    assert abs(turned) < 0.5
    assert lay.oblique == pytest.approx(abs(np.sin(2.0 * np.deg2rad(degrees))), abs=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_an_isotropic_surface_has_no_oblique_lay(seed):
    rough = self_affine((128, 128), (1e-4, 1e-4), seed, rms_height=1e-6, **BAND)
    assert find_lay(rough, BAND["short_cutoff"]).oblique < 0.15
