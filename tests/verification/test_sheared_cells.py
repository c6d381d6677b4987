"""Friction laws from cells that are sheared until they slide."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.micro import Cell, Path, run_ensemble
from multiscale.micro.elastic.viscoelastic import RelaxingSolid, solve_sliding
from multiscale.upscaling import (
    fit_law,
    friction_observations,
    law_band,
    observe,
)
from tests.support import rough_square

MODULUS, NU, FRICTION, SLOPE, EDGE, POINTS = 1e9, 0.3, 0.3, 0.05, 1e-3, 16
E_STAR = MODULUS / (1.0 - NU**2)
PRESSURE = E_STAR * SLOPE * np.array([0.02, 0.05, 0.1, 0.2])


def surface(seed):
    return rough_square(POINTS, EDGE / 2, EDGE / 4, SLOPE, seed=seed, size=EDGE)


@pytest.fixture(scope="module")
def response():
    """Four cells, each pressed and dragged until it slides, to and fro."""
    slide = np.repeat(np.cumsum([0.0, *(0.04 * EDGE * (-1.0) ** np.arange(4))]), 2)[1:-1]
    path = Path(
        pressure=tuple(np.repeat(PRESSURE, 2)), slide=tuple((entry, 0.0) for entry in slide)
    )
    cells = [
        Cell(surface(k), EDGE, 4, MODULUS, NU, friction_coefficient=FRICTION) for k in range(4)
    ]
    return run_ensemble(cells, path)


def test_elastic_cells_slide_with_the_coefficient_of_their_points(response):
    """Small slopes: Coulomb's law at every point is Coulomb's law of the cell, without a rate."""
    seen = friction_observations(response)
    np.testing.assert_array_equal(seen.conditions[1], 0.0)
    assert np.unique(seen.pressure).size >= 3
    law = fit_law(seen, family="coulomb", n_samples=100)
    assert law.attrs["admissible"] == 1
    assert float(law["friction_coefficient"]) == pytest.approx(FRICTION, rel=2e-3)
    low, high = law_band(law, lambda item: item.coefficient(PRESSURE, np.zeros(4)))
    assert np.all(high - low < 2e-3)


def test_rubber_on_rough_ground_gives_a_bell_over_speed_and_pressure():
    """Steady sliding at four pressures and eight speeds: viscous friction has a peak."""
    rubber = RelaxingSolid(10e6, 0.5, (90e6,), (1e-3,))
    pressure, speed = np.array([0.1e6, 0.2e6, 0.4e6]), np.geomspace(3e-3, 1.0, 8)
    p, v = (grid.ravel() for grid in np.meshgrid(pressure, speed, indexing="ij"))
    values = [
        [solve_sliding(surface(seed), rubber, *item).friction for item in zip(p, v, strict=True)]
        for seed in range(4)
    ]
    law = fit_law(observe("friction_coefficient", (p, v), values), family="bell", n_samples=100)
    assert law.attrs["admissible"] == 1
    assert law.attrs["cross_validated_rms_error"] < 0.2
    assert float(law["pressure_exponent"]) < 0.1
    mean = np.mean(values, axis=0).reshape(3, 8)
    peak = speed[np.argmax(mean.mean(axis=0))]
    assert 0.5 < float(law["peak_speed"]) / peak < 2.0
    low, high = law_band(law, lambda item: item.coefficient(p, v))
    assert np.all(low > 0.0)
    assert np.mean((low <= mean.ravel()) & (mean.ravel() <= high)) > 0.5


def test_what_does_not_shear_or_slide_is_refused(response):
    pressed = response.isel(step=slice(0, None, 2))
    with pytest.raises(CaseError, match=r"at most \d+ % of it does; slide farther"):
        friction_observations(pressed)
    with pytest.raises(CaseError, match="has neither sliding_speed nor slip_fraction"):
        friction_observations(response.drop_vars("slip_fraction"))
