"""The unloading branch of cells that have flowed."""

import numpy as np
import pytest

from multiscale.laws.bulk import J2
from multiscale.micro import Cell, Path, run_ensemble
from multiscale.upscaling import fit_law, fitted_law, law_band, law_from_dataset, unloading_family
from multiscale.upscaling.response_observations import unloading_observations
from tests.support import rough_square

MODULUS, NU, YIELD, EDGE, POINTS = 200e9, 0.3, 1e9, 1e-4, 12
STEEL = J2(MODULUS, NU, YIELD, 2e9)
LOADING = np.array([20e6, 40e6, 80e6, 160e6])


@pytest.mark.slow
def test_cells_that_have_flowed_unload_stiffer_than_they_were_loaded():
    """Pressed four times as hard, and unloaded twice from the way and from the end."""
    pressure = (*LOADING[:3], 40e6, 20e6, LOADING[3], 80e6, 40e6)
    cells = [
        Cell(
            rough_square(POINTS, EDGE, EDGE / 3, 0.1, seed=seed, size=EDGE),
            EDGE,
            4,
            MODULUS,
            NU,
            bulk=STEEL,
        )
        for seed in range(4)
    ]
    response = run_ensemble(cells, Path(pressure=pressure))
    assert response["converged"].values.all()
    assert response["flowing_fraction"].values.max() > 0.01
    loading = law_from_dataset(fit_law(response.isel(step=[0, 1, 2, 5]), n_samples=0))
    seen = unloading_observations(response)
    assert seen.pressure.size == 4
    fitted = fit_law(seen, family=unloading_family(loading), n_samples=100)
    assert fitted.attrs["admissible"] == 1
    assert float(fitted["stiffness_ratio"]) > 1.05
    low, high = law_band(
        fitted, lambda item: item.recovery(*seen.conditions), family=unloading_family(loading)
    )
    law = fitted_law(fitted, family=unloading_family(loading))
    mean = seen.mean
    np.testing.assert_allclose(law.recovery(*seen.conditions), mean, rtol=0.25)
    assert np.all(low < high)
