"""Synthetic surfaces have the spectrum asked for, and measured maps keep theirs when prepared."""

import numpy as np
import pytest
from numpy import cos, pi, sin

from multiscale.errors import CaseError
from multiscale.io import read_surface
from multiscale.micro import self_affine
from multiscale.surfaces import (
    Anisotropy,
    Surface,
    composite,
    crop,
    detrend,
    low_pass,
    mirror,
    resample,
    rms_height,
    rms_slope,
    rotate,
    window,
)
from multiscale.surfaces.fourier import nayak_parameter, ring_density, wave_power
from tests.support import rough_square

BAND = {"hurst_exponent": 0.8, "long_cutoff": 1.0e-4, "short_cutoff": 1.0e-5}
GRIDS = [
    pytest.param((64, 64), (1.0e-4, 1.0e-4), id="square"),
    pytest.param((64, 33), (1.0e-4, 1.0e-4), id="nx-not-ny"),
    pytest.param((21, 64), (1.0e-4, 3.0e-4), id="oblong"),
    pytest.param((97, 50), (2.0e-4, 0.7e-4), id="dx-not-dy"),
]


def rough(points, size, seed=5, *, hurst=0.8, **band):
    """A self-affine surface of the band, or of another band."""
    names = {"long": "long_cutoff", "short": "short_cutoff"}
    changed = {names.get(name, name): value for name, value in band.items()}
    return self_affine(points, size, seed, **BAND | {"hurst_exponent": hurst} | changed)


def waves(points, size, *terms):
    """Sum of a cos(2 pi (i x / Lx + j y / Ly) + phase) at the nodes."""
    x, y = np.meshgrid(*(np.arange(n) / n for n in points), indexing="ij")
    return Surface(sum(a * cos(2 * pi * (i * x + j * y) + p) for a, i, j, p in terms), size)


# Synthesis


@pytest.mark.parametrize(("points", "size"), GRIDS)
def test_rms_slope_is_the_one_asked_for(points, size):
    surface = rough(points, size, rms_slope=0.13)
    assert rms_slope(surface) == pytest.approx(0.13, rel=1e-12)
    assert surface.heights.mean() == pytest.approx(0.0, abs=1e-12 * rms_height(surface))


@pytest.mark.parametrize(("points", "size"), GRIDS)
def test_rms_height_is_the_one_asked_for(points, size):
    surface = rough(points, size, rms_height=0.7e-6)
    assert rms_height(surface) == pytest.approx(0.7e-6, rel=1e-12)


@pytest.mark.parametrize(("points", "size"), GRIDS)
def test_a_finer_grid_samples_the_same_surface(points, size):
    coarse = rough(points, size, rms_slope=0.1)
    fine = rough((3 * points[0], 2 * points[1]), size, rms_slope=0.1)
    scale = rms_height(coarse)
    np.testing.assert_allclose(fine.heights[::3, ::2], coarse.heights, atol=1e-12 * scale)


def test_the_unit_of_length_does_not_change_the_surface():
    metre, micron = (
        rough((40, 48), (m, 1.3 * m), 2, hurst=0.5, long=m, short=0.1 * m, rms_slope=1)
        for m in (1.0, 1e-6)
    )
    np.testing.assert_allclose(1e6 * micron.heights, metre.heights, atol=1e-11)


def test_a_shorter_cutoff_adds_waves_and_keeps_the_longer_waves():
    size = (1.0e-4, 1.0e-4)
    coarse = rough((64, 64), size, rms_height=1e-6)
    fine = rough((64, 64), size, rms_height=1e-6, short=0.5e-5)
    stored = low_pass(fine, BAND["short_cutoff"]).heights
    ratio = stored.std() / coarse.heights.std()
    np.testing.assert_allclose(stored, ratio * coarse.heights, atol=1e-12 * stored.std())


@pytest.mark.parametrize("hurst_exponent", [0.3, 0.8])
def test_spectrum_falls_with_the_hurst_exponent_below_the_roll_off(hurst_exponent):
    band = {"long": 0.5, "roll_off": 0.125, "short": 0.01, "rms_height": 1.0}
    surface = rough((256, 300), (1.0, 1.0), 3, hurst=hurst_exponent, **band)
    q, density, _ = ring_density(surface, *wave_power(surface))
    q = q / (2 * pi)
    assert density[(q < 1.5) | (q > 101.0)].max() < 1e-25 * density.max()
    flat = (q > 2.6) & (q < 7.4)
    np.testing.assert_allclose(density[flat], density[flat][0], rtol=1e-10)
    falling = (q > 9.0) & (q < 99.0)
    slope = np.polyfit(np.log(q[falling]), np.log(density[falling]), 1)[0]
    assert slope == pytest.approx(-2.0 - 2.0 * hurst_exponent, abs=0.01)


def test_surface_is_isotropic_on_an_oblong_cell():
    surface = rough((512, 256), (2.0, 1.0), 3, long=0.2, short=0.02, rms_slope=0.1)
    along_x, along_y = (
        np.mean((np.diff(surface.heights, axis=k) / surface.spacing[k]) ** 2) for k in range(2)
    )
    assert along_x == pytest.approx(along_y, rel=0.02)
    assert along_x == pytest.approx(0.1**2 / 2, rel=0.05)


def test_the_least_grid_named_in_the_message_is_enough():
    surface = rough((21, 21), (1.0e-4, 1.0e-4), rms_slope=0.1)
    assert rms_slope(surface) == pytest.approx(0.1, rel=1e-12)


# Statistics


def test_statistics_of_two_waves_follow_the_formula():
    size = (2.0, 3.0)
    surface = waves((16, 15), size, (0.3, 2, -1, 0.4), (0.1, 0, 3, 1.0))
    q = [2 * pi * np.hypot(2 / 2.0, 1 / 3.0), 2 * pi * 3 / 3.0]
    power = [0.3**2 / 2, 0.1**2 / 2]
    moments = [sum(p * k**order for p, k in zip(power, q, strict=True)) for order in (0, 2, 4)]
    assert rms_height(surface) == pytest.approx(np.sqrt(moments[0]), rel=1e-12)
    assert rms_slope(surface) == pytest.approx(np.sqrt(moments[1]), rel=1e-12)
    assert nayak_parameter(surface) == pytest.approx(
        1.5 * moments[0] * moments[2] / moments[1] ** 2, rel=1e-12
    )


def slope_of_differences(surface):
    slopes = (np.diff(surface.heights, axis=k) / step for k, step in enumerate(surface.spacing))
    return np.sqrt(sum(np.mean(slope**2) for slope in slopes))


def test_differences_converge_to_the_slope_of_the_series():
    errors = []
    for n in (32, 64):
        surface = rough((n, n), (1.0e-4, 1.0e-4), 1, rms_slope=0.1)
        errors.append(0.1 - slope_of_differences(surface))
    assert errors[0] > 2.0 * errors[1] > 0.0
    assert errors[1] < 0.01


@pytest.mark.parametrize(
    ("waves_long", "waves_short", "reference", "tolerance"),
    [
        pytest.param(1, 16, 17.8, 0.20, id="1-16"),
        pytest.param(4, 16, 2.88, 0.04, id="4-16"),
        pytest.param(8, 16, 1.77, 0.01, id="8-16"),
        pytest.param(4, 32, 5.5, 0.06, id="4-32"),
        pytest.param(1, 64, 135.0, 0.40, id="1-64"),
    ],
)
def test_nayak_parameter_agrees_with_a_reference_ensemble(
    waves_long, waves_short, reference, tolerance
):
    # The ensembles had 4 to 10 realisations with Gaussian moduli; the tolerance is about 2.5 of
    # their standard errors, obtained by sampling such moduli.
    n = 4 * waves_short
    surface = rough_square(n, 1.0 / waves_long, 1.0 / waves_short, 0.1, seed=1)
    assert nayak_parameter(surface) == pytest.approx(reference, rel=tolerance)


def test_moments_tend_to_their_integrals_as_the_cell_grows():
    # C ~ q^-3.6 between 1e4 and 1e6 rad/m: the moments are elementary integrals. They give the
    # rms slope 0.2766 for the rms height 6 um and the Nayak parameter 139.8.
    low, high, hurst, height = 1.0e4, 1.0e6, 0.8, 6.0e-6

    def moment(order):
        power = order - 2.0 * hurst
        return (high**power - low**power) / power

    slope = height * np.sqrt(moment(2) / moment(0))
    nayak = 1.5 * moment(0) * moment(4) / moment(2) ** 2
    assert slope == pytest.approx(0.27660, rel=1e-4)
    assert nayak == pytest.approx(139.8, rel=1e-3)

    size, band = (6 * 2 * pi / low,) * 2, {"long": 2 * pi / low, "short": 2 * pi / high}
    surface = rough((1201, 1201), size, 1, hurst=hurst, rms_height=height, **band)
    assert rms_slope(surface) == pytest.approx(slope, rel=0.03)
    assert nayak_parameter(surface) == pytest.approx(nayak, rel=0.06)


@pytest.mark.parametrize("points", [(16, 16), (15, 16), (16, 15), (9, 21)])
def test_spectral_density_adds_up_to_the_mean_square_height(points):
    noise = np.random.default_rng(seed=1).normal(loc=3.0, size=points)
    surface = Surface(noise, (2.0, 5.0))
    _, density, count = ring_density(surface, *wave_power(surface))
    assert count @ density / (2.0 * 5.0) == pytest.approx(noise.var(), rel=1e-12)
    assert count.sum() == noise.size - 1


# Preparation


def test_mirrored_map_is_even_and_twice_as_long():
    noise = np.random.default_rng(seed=1).normal(size=(5, 4))
    doubled = mirror(Surface(noise, (1.0, 2.0)))
    assert doubled.size == (2.0, 4.0)
    assert doubled.spacing == (0.2, 0.5)
    np.testing.assert_array_equal(doubled.heights[:5, :4], noise)
    np.testing.assert_array_equal(doubled.heights, doubled.heights[::-1])
    np.testing.assert_array_equal(doubled.heights, doubled.heights[:, ::-1])


def test_window_leaves_the_middle_and_fades_to_the_mean():
    noise = np.random.default_rng(seed=1).normal(loc=7.0, size=(40, 60))
    faded = window(Surface(noise, (1.0, 1.0)), taper=0.2).heights
    np.testing.assert_allclose(faded[8:33, 12:49], noise[8:33, 12:49], rtol=1e-13)
    np.testing.assert_allclose(faded[0], noise.mean(), rtol=1e-13)
    np.testing.assert_allclose(faded[:, 0], noise.mean(), rtol=1e-13)


@pytest.mark.parametrize("taper", [0.1, 0.5])
def test_window_lowers_the_mean_square_height_as_stated(taper):
    noise = np.random.default_rng(seed=1).normal(size=(800, 800))
    faded = window(Surface(noise, (1.0, 1.0)), taper=taper).heights
    assert np.mean(faded**2) == pytest.approx((1.0 - 1.25 * taper) ** 2, rel=0.01)


@pytest.mark.parametrize("points", [(64, 64), (27, 90), (51, 24)])
def test_resampling_a_resolved_surface_is_exact(points):
    size = (1.0e-4, 1.0e-4)
    surface, exact = (rough(grid, size, rms_height=1.0) for grid in ((30, 33), points))
    np.testing.assert_allclose(resample(surface, points).heights, exact.heights, atol=1e-12)


def test_coarsening_removes_waves_that_the_grid_cannot_carry_instead_of_aliasing_it():
    size = (2.0, 1.0)
    fine = waves((64, 48), size, (1.0, 3, 2, 0.1), (0.5, 11, 2, 0.2), (0.5, 3, -9, 0.3))
    coarse = resample(fine, (16, 12))
    np.testing.assert_allclose(
        coarse.heights, waves((16, 12), size, (1.0, 3, 2, 0.1)).heights, atol=1e-13
    )
    assert coarse.size == size


def test_crop_keeps_spacing_and_heights():
    noise = np.random.default_rng(seed=1).normal(size=(8, 6))
    piece = crop(Surface(noise, (4.0, 6.0)), (2, 1), (4, 3))
    assert piece.size == (2.0, 3.0)
    np.testing.assert_array_equal(piece.heights, noise[2:6, 1:4])


def test_detrended_part_has_no_tilt():
    x, y = np.meshgrid(np.arange(9.0), np.arange(6.0), indexing="ij")
    level = detrend(Surface(1.0 + 2.0 * x - 3.0 * y + sin(x * y), (9.0, 6.0)))
    np.testing.assert_allclose(
        level.heights, detrend(Surface(sin(x * y), (9.0, 6.0))).heights, atol=1e-13
    )


def test_composite_of_independent_surfaces_adds_their_mean_squares():
    size = (1.0e-3, 1.0e-3)
    first, two = (rough((256, 256), size, seed, rms_height=1.0) for seed in (1, 2))
    both = composite(first, two)
    np.testing.assert_array_equal(both.heights, first.heights + two.heights)
    assert rms_height(both) == pytest.approx(np.sqrt(2.0), rel=0.05)


@pytest.mark.parametrize("name", ["tmd-1.tmd", "al3d-1.al3d"])
def test_a_measured_map_becomes_a_periodic_cell(reference_data, name):
    measured = read_surface(reference_data / "topography" / name, detrend_order=2)
    cell = resample(low_pass(mirror(measured), 16.0 * max(measured.spacing)), (128, 96))
    assert cell.size == tuple(2.0 * edge for edge in measured.size)
    assert 0.5 * rms_height(measured) < rms_height(cell) < rms_height(measured)
    assert 0.1 * slope_of_differences(measured) < rms_slope(cell) < rms_slope(measured)


@pytest.mark.parametrize(("ratio", "degrees"), [(2.0, 0), (4.0, 35), (3.0, 90)])
def test_an_anisotropic_surface_has_its_lay_and_its_height(ratio, degrees):
    lay = Anisotropy(ratio, np.deg2rad(degrees))
    band = {"hurst_exponent": 0.8, "long_cutoff": 1e-5, "short_cutoff": 2e-6, "rms_height": 1e-7}
    surface = self_affine((256, 256), (1e-4, 1e-4), 2, anisotropy=lay, **band)
    assert rms_height(surface) == pytest.approx(1e-7, rel=1e-12, abs=0.0)
    q, along = np.cos(lay.direction), np.sin(lay.direction)
    hx, hy = np.gradient(surface.heights)
    slopes = [np.std(q * hx + along * hy), np.std(q * hy - along * hx)]
    assert slopes[1] / slopes[0] == pytest.approx(ratio, rel=0.05)


def test_an_anisotropy_of_unit_ratio_is_isotropic():
    isotropic = self_affine((64, 64), (1e-4, 1e-4), 1, rms_slope=0.1, **BAND)
    same = self_affine((64, 64), (1e-4, 1e-4), 1, rms_slope=0.1, anisotropy=Anisotropy(1.0), **BAND)
    np.testing.assert_allclose(same.heights, isotropic.heights, atol=1e-12 * 1e-6)
    with pytest.raises(CaseError, match=r"must be at least 1, got 0\.5"):
        Anisotropy(0.5)


def test_quarter_turns_are_exact_and_counter_clockwise():
    heights = np.zeros((5, 3))
    heights[4, 1] = 1.0  # at the middle of the edge x = 4
    turned = rotate(Surface(heights, (5.0, 3.0)), 0.5 * pi)
    assert turned.size == (3.0, 5.0)
    assert np.argwhere(turned.heights).tolist() == [[1, 4]]  # of the edge y = 4
    back = rotate(turned, -0.5 * pi)
    np.testing.assert_array_equal(back.heights, heights)


def test_other_turns_interpolate_the_same_surface():
    x, y = np.meshgrid(np.arange(200.0), np.arange(160.0), indexing="ij")
    angle = np.deg2rad(25.0)

    def wave(x, y):  # about the middle of the map
        return cos(2.0 * pi * (0.6 * (x - 99.5) + 0.8 * (y - 79.5)) / 20.0)

    filled = np.zeros(x.shape, dtype=bool)
    turned = rotate(Surface(wave(x, y), (200.0, 160.0), filled), angle)
    nx, ny = turned.heights.shape
    assert turned.spacing == pytest.approx((1.0, 1.0))
    assert not turned.filled.any()
    u, v = np.meshgrid(
        np.arange(nx) - 0.5 * (nx - 1), np.arange(ny) - 0.5 * (ny - 1), indexing="ij"
    )
    expected = wave(99.5 + cos(angle) * u + sin(angle) * v, 79.5 - sin(angle) * u + cos(angle) * v)
    inner = np.s_[4:-4, 4:-4]  # splines end at the edges
    np.testing.assert_allclose(turned.heights[inner], expected[inner], atol=2e-3)
