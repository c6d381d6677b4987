"""Branches of a law in addition to loading: unloading."""

import numpy as np
import pytest

from multiscale.errors import CaseError, SchemaError
from multiscale.io import open_response
from multiscale.laws import Exponential, HystereticLaw
from multiscale.micro import Path
from multiscale.schema import HOLDING, INTERFACE_LAW, LOADING, UNLOADING
from multiscale.upscaling import (
    fit_branches,
    fit_law,
    hysteretic_from_dataset,
    loading_branch,
)
from multiscale.upscaling.branches import with_unloading
from tests.upscaling.responses import response_of

UP = np.geomspace(5e6, 160e6, 8)
TRUTH = HystereticLaw(Exponential(4e8, 0.45e-6), stiffness_ratio=1.4, exponent=2.5)


@pytest.fixture(scope="module")
def response():
    """Six realisations that differ by a factor of their lengths, loaded and unloaded."""
    down = UP[-2::-1]
    peak = np.array(UP[-1])
    back = TRUTH.loading.gap_at(peak) + TRUTH.recovery(down, peak)
    gap = np.concatenate([TRUTH.loading.gap_at(UP), back])
    factor = 1.0 + 0.03 * np.random.default_rng(1).standard_normal((6, 1))
    area = np.tile(np.concatenate([UP, down]) / 5e8, (6, 1))
    return response_of(factor * gap, np.concatenate([UP, down]), area=area)


def test_the_loading_branch_is_where_the_pressure_is_new(response):
    np.testing.assert_allclose(loading_branch(response)["nominal_pressure"], UP)
    path = np.array([1.0, 2.0, 1.0, 2.0, 3.0])
    gaps = np.ones((1, 5))
    again = loading_branch(response_of(gaps, path, area=0.1 * gaps))
    np.testing.assert_allclose(again["nominal_pressure"], [1.0, 2.0, 3.0])


def test_a_path_names_loading_unloading_and_holding():
    path = Path(pressure=(0.0, 1.0, 2.0, 2.0, 1.5, 1.7, 2.0, 3.0))
    meanings = [("loading", "unloading", "holding")[item] for item in path.branch]
    hold, up, down = "holding", "loading", "unloading"
    assert meanings == [hold, up, up, hold, down, down, hold, up]
    assert list(Path(approach=(-1.0, 1.0, 2.0, 1.5)).branch) == [
        HOLDING,
        LOADING,
        LOADING,
        UNLOADING,
    ]


def test_a_response_without_branches_names_the_missing_entries(response, tmp_path):
    old = response.drop_vars("branch").assign_attrs(schema="micro_response", schema_version=1)
    old.to_netcdf(tmp_path / "r.nc", engine="h5netcdf")
    with pytest.raises(SchemaError, match=r"reads version 2, which has the branch of every step"):
        open_response(tmp_path / "r.nc")


def test_both_branches_are_recovered_with_their_samples(response):
    law = with_unloading(fit_law(loading_branch(response), n_samples=0), response, n_samples=50)
    INTERFACE_LAW.check(law)
    single_law = hysteretic_from_dataset(law)
    assert single_law.stiffness_ratio == pytest.approx(1.4, rel=0.02)
    assert single_law.exponent == pytest.approx(2.5, rel=0.02)
    samples = [hysteretic_from_dataset(law, k).recovery(2e7, np.array(1.6e8)) for k in range(50)]
    low, high = np.percentile(samples, (2.5, 97.5))
    assert low < single_law.recovery(2e7, np.array(1.6e8)) < high


def test_cheap_cells_without_memory_control_the_spring_back_too(response):
    """Their factors equal the factors of the cells, and the factor of many cells is nearer to 1."""
    random = np.random.default_rng(1)
    factor = 1.0 + 0.03 * random.standard_normal((6, 1))
    factor = np.vstack([factor, 1.0 + 0.03 * random.standard_normal((300, 1))])
    cheap = response_of(0.8 * factor * TRUTH.loading.gap_at(UP), UP)
    loading = fit_law(loading_branch(response), control=cheap, n_samples=20)
    law = with_unloading(loading, response, control=cheap, n_samples=20)
    assert "spring back: 306 control cells" in law.attrs["control"]
    down = UP[-2::-1]
    recovery = TRUTH.recovery(down, np.array(UP[-1]))
    result = law["unloading_recovery"].to_numpy()
    order = np.argsort(law["unloading_pressure"].to_numpy())[::-1]
    np.testing.assert_allclose(result[order], factor.mean() * recovery, rtol=1e-6)
    alone = with_unloading(loading, response, n_samples=0)["unloading_recovery"].to_numpy()[order]
    assert np.all(np.abs(result[order] / recovery - 1.0) < np.abs(alone / recovery - 1.0))


def test_cells_that_have_not_flowed_are_fitted_as_they_are(response):
    loading = loading_branch(response)
    law = fit_branches(loading, n_samples=0)
    assert "unloading_exponent" not in law
    with pytest.raises(CaseError, match="the law has no unloading branch; unload the cells"):
        hysteretic_from_dataset(law)


def test_a_sample_that_does_not_exist_is_refused(response):
    law = with_unloading(fit_law(loading_branch(response), n_samples=0), response, n_samples=5)
    with pytest.raises(CaseError, match="no sample 9; it has 5"):
        hysteretic_from_dataset(law, 9)
