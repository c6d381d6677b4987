r"""Scatter of computed rough contact: how it changes with the cell.

Flat cells with hard cut-offs, Hurst exponent .8 and root mean square slope .1; 8 points per
shortest wave. Pressures over contact modulus times slope.
"""

import numpy as np
import pytest

from tests.support import press_flat, rough_square

MODULUS, NU, SLOPE, WAVE = 1e9, 0.3, 0.1, 1e-3
CONTACT_MODULUS = MODULUS / (1.0 - NU**2)


def ensemble(size, n_realisations, pressures, *, seed):
    """Response of cells of ``size`` longest waves, with four shortest waves in the longest."""
    band, n = (WAVE, WAVE / 4, SLOPE), 32 * size
    surfaces = [
        rough_square(n, *band, seed=seed + k, size=size * WAVE) for k in range(n_realisations)
    ]
    pressure = CONTACT_MODULUS * SLOPE * np.asarray(pressures)
    return press_flat(surfaces, pressure, MODULUS, NU)


@pytest.fixture(scope="module")
def sizes():
    return {size: ensemble(size, 40, (0.02, 0.05, 0.1), seed=1000 * size) for size in (1, 2, 4, 8)}


@pytest.mark.long
@pytest.mark.parametrize("variable", ["mean_gap", "contact_fraction"])
@pytest.mark.parametrize("relative_pressure", [0.02, 0.1])
def test_scatter_falls_as_the_inverse_of_the_cell(sizes, variable, relative_pressure):
    """40 realisations at each size; the 95 % interval of the slope overlaps [-1.3, -.8]."""
    random, scatter, drawn = np.random.default_rng(seed=0), [], []
    for response in sizes.values():
        pressure = response["nominal_pressure"] / (CONTACT_MODULUS * SLOPE)
        step = int(np.argmin(np.abs(pressure.to_numpy() - relative_pressure)))
        values = response[variable].to_numpy()[:, step]
        assert response["converged"].to_numpy()[:, step].all()
        scatter.append(values.std(ddof=1) / values.mean())
        sample = values[random.integers(0, values.size, (2000, values.size))]
        drawn.append(sample.std(axis=1, ddof=1) / sample.mean(axis=1))
    size = np.log(list(sizes))
    low, high = np.percentile(np.polyfit(size, np.log(drawn), 1)[0], [2.5, 97.5])
    assert low <= -0.8, scatter
    assert high >= -1.3, scatter
    assert -1.5 < np.polyfit(size, np.log(scatter), 1)[0] < -0.7
    assert np.all(np.diff(scatter) < 0.0)
