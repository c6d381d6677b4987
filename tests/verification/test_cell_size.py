r"""Scatter and area of computed rough contact: how they change with cell, grid and spectrum.

Flat cells with hard cut-offs, Hurst exponent .8 and root mean square slope .1; 8 points per
shortest wave. Pressures over contact modulus times slope.
"""

import numpy as np
import pytest

from multiscale.micro import Cell, Path, run_ensemble, self_affine
from multiscale.upscaling import (
    ensemble_average,
    error_budget,
    fit_law,
    law_from_dataset,
    nayak_trend,
    size_trend,
)

MODULUS, NU, SLOPE, WAVE = 1e9, 0.3, 0.1, 1e-3
CONTACT_MODULUS = MODULUS / (1.0 - NU**2)


def ensemble(
    size, n_realisations, pressures, *, ratio=4, points=8, seed=0, long_cutoff=WAVE, hurst=0.8
):
    """Response of cells of ``size`` longest waves, with ``ratio`` shortest waves in the longest."""
    n, length = round(size * ratio * points), size * WAVE
    cells = [
        Cell(
            self_affine(
                (n, n),
                (length, length),
                seed + k,
                hurst_exponent=hurst,
                long_cutoff=long_cutoff,
                short_cutoff=WAVE / ratio,
                rms_slope=SLOPE,
            ),
            length,
            8,
            MODULUS,
            NU,
            geometry="flat",
        )
        for k in range(n_realisations)
    ]
    path = Path(pressure=tuple(CONTACT_MODULUS * SLOPE * np.asarray(pressures)))
    return run_ensemble(cells, path).assign_attrs(contact_modulus=CONTACT_MODULUS)


@pytest.fixture(scope="module")
def sizes():
    return {size: ensemble(size, 40, (0.02, 0.05, 0.1), seed=1000 * size) for size in (1, 2, 4, 8)}


@pytest.mark.slow
@pytest.mark.parametrize("variable", ["mean_gap", "contact_fraction"])
@pytest.mark.parametrize("relative_pressure", [0.02, 0.1])
def test_scatter_falls_as_the_inverse_of_the_cell(sizes, variable, relative_pressure):
    """40 realisations at each size; the 95 % interval of the slope overlaps [-1.3, -.8]."""
    pressure = CONTACT_MODULUS * SLOPE * relative_pressure
    trend = size_trend(sizes, variable, pressure=pressure)
    low, high = trend.slope_interval
    assert low <= -0.8, trend
    assert high >= -1.3, trend
    assert -1.5 < trend.slope < -0.7
    assert np.all(np.diff(trend.value) < 0.0)


@pytest.mark.slow
def test_area_of_light_contact_falls_with_the_nayak_parameter():
    """Spectra from 1, 1/4 and 1/8 of the cell down to 1/16; kappa falls, slowly."""
    responses = [
        ensemble(1, 12, (0.01, 0.02, 0.05), ratio=16, seed=10, long_cutoff=WAVE / part)
        for part in (1, 4, 8)
    ]
    trend = nayak_trend(responses, relative_pressure=0.02)
    assert np.all(np.diff(trend.at) < 0.0)
    assert trend.at[0] > 5.0 * trend.at[-1]
    assert -0.2 < trend.slope < -0.02
    assert trend.slope_interval[1] < 0.0


@pytest.mark.slow
def test_budgets_of_small_ensembles_contain_their_true_error():
    """40 ensembles of 8 cells of two waves, 8 points per shortest wave, and 60 cells of one wave.

    The truth is the mean of 40 cells of eight waves, with the area extrapolated over the grids of
    other cells. An exact interval of a normal error is 2.9 times its median.
    """
    pressures, found = np.geomspace(0.01, 0.2, 6), []
    for hurst in (0.5, 0.8):
        truth = true_values(pressures, hurst)
        for scene in range(20):
            options = {"hurst": hurst, "seed": 1000 * scene}
            response = ensemble(2, 8, pressures, **options)
            law = fit_law(response, n_samples=100)
            budget = error_budget(
                response,
                law,
                resolutions={2.0: ensemble(2, 8, pressures, points=4, **options)},
                sizes={0.5: ensemble(1, 60, pressures, hurst=hurst, seed=1000 * scene + 500)},
            )
            error = np.abs(values_of(response, law) / truth - 1.0)
            found.append([error, budget["error_total"].values])
    error, half_width = np.swapaxes(found, 0, 1)
    coverage = np.mean(error <= half_width, axis=(0, 2))  # gap, contact fraction, stiffness
    assert np.all(coverage >= 0.9), coverage
    assert np.median(half_width) <= 3.0 * np.median(error)
    # a constant width that holds as often is no narrower for gap and stiffness together
    for k in (0, 2):
        constant = np.quantile(error[:, k], coverage[k])
        assert np.median(half_width[:, k]) <= 2.0 * constant


def values_of(response, law):
    """Mean gap, contact fraction and stiffness of the law at the steps, (3, steps)."""
    one, p = law_from_dataset(law), law["fit_pressure"].values
    averages = [ensemble_average(response, name).mean for name in ("mean_gap", "contact_fraction")]
    return np.array([*averages, one.stiffness(one.gap_at(p))])


def true_values(pressures, hurst):
    large = ensemble(8, 40, pressures, hurst=hurst, seed=100000)
    truth = values_of(large, fit_law(large, n_samples=0))
    options = {"hurst": hurst, "seed": 200000}
    grids = [ensemble(2, 12, pressures, points=points, **options) for points in (8, 16, 32)]
    area = [ensemble_average(grid, "contact_fraction").mean for grid in grids]
    truth[1] *= (2.0 * area[2] - area[1]) / area[0]  # to the limit, by the order 1 of the area
    return truth
