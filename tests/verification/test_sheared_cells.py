"""Tangential stiffness and friction laws from cells that are sheared until they slide."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.micro import Cell, Path, run_ensemble
from multiscale.micro.viscoelastic_sliding import RelaxingSolid, solve_sliding
from multiscale.upscaling import (
    fit_law,
    fitted_law,
    friction_observations,
    law_band,
    law_from_dataset,
    observe,
    tangential_observations,
)
from tests.support import rough_square

MODULUS, NU, FRICTION, SLOPE, EDGE, POINTS = 1e9, 0.3, 0.3, 0.05, 1e-3, 16
E_STAR = MODULUS / (1.0 - NU**2)
PRESSURE = E_STAR * SLOPE * np.array([0.02, 0.05, 0.1, 0.2])


def surface(seed):
    return rough_square(POINTS, EDGE / 2, EDGE / 4, SLOPE, seed=seed, size=EDGE)


@pytest.fixture(scope="module")
def response():
    """Four cells, each pressed, sheared a little and dragged until it slides, to and fro."""
    slide, at = [], 0.0
    for k, pressure in enumerate(PRESSURE):
        way = (-1.0) ** k
        slide += [at, at + way * 0.01 * FRICTION * pressure * EDGE / E_STAR, at + way * 0.04 * EDGE]
        at = slide[-1]
    path = Path(
        pressure=tuple(np.repeat(PRESSURE, 3)), slide=tuple((float(one), 0.0) for one in slide)
    )
    cells = [
        Cell(surface(k), EDGE, 4, MODULUS, NU, friction_coefficient=FRICTION) for k in range(4)
    ]
    return run_ensemble(cells, path)


def test_the_tangential_stiffness_of_cells_is_fitted_and_in_mindlins_ratio(response):
    """Mindlin: K_T = 2 (1 - nu) / (2 - nu) K_N for every contact, and so for all together."""
    seen = tangential_observations(response)
    np.testing.assert_allclose(seen.pressure, PRESSURE)
    law = fit_law(seen, n_samples=100)
    assert law.attrs["family"] == "power_stiffness"
    assert law.attrs["admissible"] == 1
    found = fitted_law(law).stiffness_at(PRESSURE)
    low, high = law_band(law, lambda one: one.stiffness_at(PRESSURE))
    assert np.all((low < found) & (found < high))
    assert 0.7 < float(law["exponent"]) < 1.1
    normal = law_from_dataset(fit_law(response.isel(step=slice(0, None, 3)), n_samples=0))
    ratio = found / normal.stiffness(normal.gap_at(PRESSURE))
    # contacts of a few points each, whose shapes are not round
    np.testing.assert_allclose(ratio[1:-1], 2.0 * (1.0 - NU) / (2.0 - NU), rtol=0.15)


def test_elastic_cells_slide_with_the_coefficient_of_their_points(response):
    """Small slopes: Coulomb's law at every point is Coulomb's law of the cell, without a rate."""
    seen = friction_observations(response)
    np.testing.assert_array_equal(seen.conditions[1], 0.0)
    assert np.unique(seen.pressure).size >= 3
    law = fit_law(seen, family="coulomb", n_samples=100)
    assert law.attrs["admissible"] == 1
    assert float(law["friction_coefficient"]) == pytest.approx(FRICTION, rel=2e-3)
    low, high = law_band(law, lambda one: one.coefficient(PRESSURE, np.zeros(4)))
    assert np.all(high - low < 2e-3)


def test_rubber_on_rough_ground_gives_a_bell_over_speed_and_pressure():
    """Steady sliding at four pressures and eight speeds: viscous friction has a peak."""
    rubber = RelaxingSolid(10e6, 0.5, (90e6,), (1e-3,))
    pressure, speed = np.array([0.1e6, 0.2e6, 0.4e6]), np.geomspace(3e-3, 1.0, 8)
    p, v = (grid.ravel() for grid in np.meshgrid(pressure, speed, indexing="ij"))
    values = [
        [solve_sliding(surface(seed), rubber, *one).friction for one in zip(p, v, strict=True)]
        for seed in range(4)
    ]
    law = fit_law(observe("friction_coefficient", (p, v), values), family="bell", n_samples=100)
    assert law.attrs["admissible"] == 1
    assert law.attrs["cross_validated_rms_error"] < 0.2
    assert float(law["pressure_exponent"]) < 0.1
    mean = np.mean(values, axis=0).reshape(3, 8)
    peak = speed[np.argmax(mean.mean(axis=0))]
    assert 0.5 < float(law["peak_speed"]) / peak < 2.0
    low, high = law_band(law, lambda one: one.coefficient(p, v))
    assert np.all(low > 0.0)
    assert np.mean((low <= mean.ravel()) & (mean.ravel() <= high)) > 0.5


def test_what_does_not_shear_or_slide_is_refused(response):
    pressed = response.isel(step=slice(0, None, 3))
    with pytest.raises(CaseError, match="no step shears the cells at the pressure of the step bef"):
        tangential_observations(pressed)
    with pytest.raises(CaseError, match=r"at most \d+ % of it does; slide farther"):
        friction_observations(pressed)
    dragged = response.isel(step=[0, 2])
    with pytest.raises(CaseError, match=r"at least 1e\+02 % of the contact slips .*; slide less"):
        tangential_observations(dragged)
    with pytest.raises(CaseError, match="has neither sliding_speed nor slip_fraction"):
        friction_observations(response.drop_vars("slip_fraction"))
