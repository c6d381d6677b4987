"""Flow through the gap of a cell: exact channels, bounds, paths and order of the error."""

import numpy as np
import pytest

from multiscale.micro import Cell, Path, self_affine, solve_cell
from multiscale.micro.averages import gap_flow, open_gap

SPACING = (0.5e-6, 0.8e-6)  # m


def waves(n, m, along):
    """A gap that varies along a single axis, m."""
    shape, at = (n, m), np.arange(n if along == 0 else m) / (n if along == 0 else m)
    wave = 1e-6 * (1.0 + 0.6 * np.cos(2.0 * np.pi * at))
    return np.broadcast_to(wave[:, None] if along == 0 else wave, shape)


@pytest.mark.parametrize("axis", [0, 1])
def test_parallel_walls_are_as_far_apart_as_their_gap(axis):
    flow = gap_flow(np.full((12, 8), 3e-6), SPACING, axis)
    assert flow.aperture == pytest.approx(3e-6, rel=1e-12)
    assert flow.share == 1.0
    np.testing.assert_allclose(flow.speed, 1.0, rtol=1e-10)


@pytest.mark.parametrize("axis", [0, 1])
def test_waves_across_the_flow_are_in_series_and_along_it_in_parallel(axis):
    """Means of (1 + a cos)^3 and of its inverse over a period in closed form, a = .6."""
    a = 0.6
    parallel = 1.0 + 1.5 * a**2
    series = (1.0 - a**2) ** 2.5 / (1.0 + 0.5 * a**2)
    across = gap_flow(waves(64, 64, axis), SPACING, axis)
    along = gap_flow(waves(64, 64, 1 - axis), SPACING, axis)
    assert across.aperture**3 == pytest.approx(1e-18 * series, rel=1e-10)
    assert along.aperture**3 == pytest.approx(1e-18 * parallel, rel=1e-10)


def test_the_error_of_a_plane_flow_falls_with_the_square_of_the_spacing():
    """k and 1/k are alike but for a shift of half a period: the effective value is 1 (Keller)."""
    errors = []
    for n in (16, 32, 64):
        at = 2.0 * np.pi * (np.arange(n) + 0.5) / n  # ends are planes of symmetry
        gap = 1e-6 * np.cbrt(np.exp(2.0 * np.cos(at)[:, None] * np.cos(at)))
        errors.append(gap_flow(gap, (1e-6 / n, 1e-6 / n), 0).aperture / 1e-6 - 1.0)
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(order, 2.0, atol=0.1)
    assert abs(errors[-1]) < 1e-3


def test_a_random_gap_lies_between_its_series_and_parallel_bounds():
    gap = 1e-6 * np.exp(np.random.default_rng(1).normal(size=(40, 30)))
    for axis in (0, 1):
        k = gap**3 if axis == 0 else gap.T**3
        lower = np.mean(1.0 / np.mean(1.0 / k, axis=0))  # no flow to the side
        upper = 1.0 / np.mean(1.0 / np.mean(k, axis=1))  # even pressure on every section
        assert lower < gap_flow(gap, (1e-6, 1e-6), axis).aperture ** 3 < upper


def test_only_paths_to_both_ends_conduct():
    gap = np.zeros((9, 8))
    gap[:, 2] = 1e-6  # a channel along x, one of eight points wide
    gap[0:6, 5] = 1e-6  # a blind path
    along = gap_flow(gap, SPACING, 0)
    assert along.share == pytest.approx(1.0 / 8.0)
    assert along.aperture == pytest.approx(1e-6 * 8.0 ** (-1.0 / 3.0))
    np.testing.assert_allclose(along.speed[:, 2], 8.0)
    assert not np.delete(along.speed, 2, axis=1).any()
    blocked = gap_flow(gap, SPACING, 1)
    assert (blocked.aperture, blocked.share) == (0.0, 0.0)
    gap[:] = 0.0
    gap[:5, 0] = gap[4:, -1] = 1e-6  # joined only over the period
    assert gap_flow(gap, SPACING, 0).share == pytest.approx(10.0 / 72.0)


def test_what_presses_is_closed_whatever_its_gap():
    gap, pressure = np.array([[1.0, 1e-7, -1e-9, 0.5]]), np.array([[0.0, 0.0, 0.0, 2.0]])
    np.testing.assert_array_equal(open_gap(gap, pressure), [[1.0, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize("geometry", ["flat", "conforming"])
def test_a_cell_reports_the_flow_of_its_gap(geometry):
    waves = {"hurst_exponent": 0.8, "long_cutoff": 0.5, "short_cutoff": 0.25, "rms_slope": 0.05}
    surface = self_affine((16, 24), (1.0, 1.5), 3, **waves)
    cell = Cell(surface, 1.5, 4, 1.0, 0.3, geometry=geometry)
    response = solve_cell(cell, Path(pressure=(1e-4, 1e-3, 3e-3)), keep_fields=True, keep_flow=True)
    aperture = response["hydraulic_aperture"].to_numpy()[0]
    gaps, pressures = (response[name].to_numpy()[0].swapaxes(1, 2) for name in ("gap", "pressure"))
    for step, (gap, pressure) in enumerate(zip(gaps, pressures, strict=True)):
        free = open_gap(gap, pressure)
        for axis in (0, 1):
            assert aperture[step, axis] == gap_flow(free, surface.spacing, axis).aperture
    assert np.all(np.diff(aperture, axis=0) < 0.0)
    assert np.all(aperture <= response["mean_gap"].to_numpy().T)
    alone = solve_cell(cell, Path(pressure=(1e-4,)), keep_flow=True)
    assert "gap" not in alone
