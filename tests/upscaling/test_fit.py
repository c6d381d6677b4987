"""The fit accepts the response with failed steps, and reports the use of its steps."""

import numpy as np
import pytest

from multiscale.errors import CaseError, SchemaError
from multiscale.io import open_law, save_law
from multiscale.schema import INTERFACE_LAW
from multiscale.upscaling import (
    admissibility,
    area_from_dataset,
    areas_from_dataset,
    fit_law,
    fitted_laws,
    law_from_dataset,
)
from tests.upscaling.responses import PRESSURE, exponential_gaps, response_of


def test_the_result_follows_its_schema_and_states_its_origin():
    response = response_of(
        exponential_gaps(5), contact_modulus=1.1e11, bodies="steel on steel", source="other"
    )
    law = fit_law(response, n_samples=20)
    INTERFACE_LAW.check(law)
    assert law.sizes == {"term": 40, "sample": 20, "area_term": 8, "step": 8}
    assert law.attrs["family"] == "convex_decreasing"
    assert law.attrs["contact_modulus"] == 1.1e11
    assert law.attrs["bodies"] == "steel on steel"
    assert "source" not in law.attrs
    assert law.attrs["n_realisations"] == 5
    assert law.attrs["admissible"] == 1
    assert law.attrs["pressure_max"] == PRESSURE[-1]
    assert law.attrs["gap_max"] == pytest.approx(float(law["fit_mean_gap"].max()))
    assert law.attrs["maximum_fit_error"] < 1e-3
    assert law.attrs["cross_validated_error"] < 5e-3
    assert law.attrs["cross_validated_stiffness_error"] < 1e-2
    assert all(isinstance(value, str | int | float) for value in law.attrs.values())


def test_every_sample_is_an_admissible_law():
    law = fit_law(response_of(exponential_gaps(6, spread=0.1)), n_samples=30)
    areas = areas_from_dataset(law, range(30))
    for sample, single_law in enumerate(fitted_laws(law, range(30))):
        assert admissibility(single_law, single_law.pressure_range).passed
        same = law_from_dataset(law, sample)
        np.testing.assert_array_equal(single_law.pressure(1e-6), same.pressure(1e-6))
        fraction = area_from_dataset(law, sample).contact_fraction(PRESSURE)
        np.testing.assert_array_equal(areas[sample].contact_fraction(PRESSURE), fraction)


def test_one_realisation_has_a_law_but_no_samples_and_reports_it():
    law = fit_law(response_of(exponential_gaps(1)))
    assert law.sizes["sample"] == 0
    assert law.attrs["n_samples"] == 0
    assert law.attrs["uncertainty"].startswith("none: too few realisations")
    with pytest.raises(CaseError, match="no sample 0; it has 0"):
        law_from_dataset(law, 0)


def test_the_same_seed_gives_the_same_samples():
    response = response_of(exponential_gaps(5))
    first, second, other = (
        fit_law(response, n_samples=10, seed=seed)["coefficient_sample"].values
        for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, second)
    assert not np.allclose(first, other)


def test_failed_steps_are_left_out():
    gap = exponential_gaps(4, spread=0.0)
    converged = np.ones(gap.shape, dtype=int)
    converged[1, 3], converged[2, 5], converged[:, 7] = 0, 0, 0
    wrong = gap.copy()
    wrong[1, 3], wrong[2, 5], wrong[:, 7] = np.nan, 5.0, np.nan
    law = fit_law(response_of(wrong, converged=converged), n_samples=10)
    np.testing.assert_allclose(law["fit_pressure"], PRESSURE[:7])
    np.testing.assert_allclose(law["fit_mean_gap"], gap[0, :7])
    assert np.all(np.isfinite(law["coefficient_sample"]))
    assert law.attrs["n_realisations"] == 4


def test_a_realisation_that_never_converged_does_not_count():
    gap = exponential_gaps(3)
    converged = np.ones(gap.shape, dtype=int)
    converged[1] = 0
    law = fit_law(response_of(gap, converged=converged), n_samples=5)
    assert law.attrs["n_realisations"] == 2
    np.testing.assert_allclose(law["fit_mean_gap"], gap[[0, 2]].mean(axis=0))


def test_pressures_may_come_in_any_order_and_from_the_traction():
    gap, order = exponential_gaps(1), np.random.default_rng(0).permutation(8)
    expected = fit_law(response_of(gap))
    law = fit_law(response_of(gap[:, order], PRESSURE[order], nominal=False))
    np.testing.assert_allclose(law["coefficient"], expected["coefficient"])


def test_area_that_falls_by_scatter_is_levelled():
    area = np.linspace(0.1, 0.8, 8)[None]
    area[0, 3], area[0, 4] = 0.5, 0.45
    law = fit_law(response_of(exponential_gaps(1), area=area))
    np.testing.assert_allclose(law["area_fraction"][3:5], 0.475)
    assert area_from_dataset(law).contact_fraction(PRESSURE[:1]) == pytest.approx(0.1)


def test_a_pressure_that_comes_twice_is_refused():
    pressure = PRESSURE.copy()
    pressure[4] = pressure[2]
    with pytest.raises(CaseError, match="one loading branch"):
        fit_law(response_of(exponential_gaps(1), pressure))


def test_another_dataset_or_family_is_refused():
    law = fit_law(response_of(exponential_gaps(1)))
    with pytest.raises(SchemaError, match="micro_response"):
        fit_law(law)
    with pytest.raises(CaseError, match="family 'power'"):
        law_from_dataset(law.assign_attrs(family="power"))


def test_a_family_with_parameters_is_fitted_with_the_area_next_to_it():
    law = fit_law(response_of(exponential_gaps(6)), family="exponential", n_samples=30)
    INTERFACE_LAW.check(law)
    assert law["decay_length"].attrs["units"] == "m"
    assert law["decay_length_sample"].sizes == {"sample": 30}
    single_law = law_from_dataset(law)
    assert single_law.decay_length == float(law["decay_length"])
    assert law_from_dataset(law, 3).decay_length == float(law["decay_length_sample"][3])
    assert area_from_dataset(law).contact_fraction(PRESSURE[:1]) == pytest.approx(0.01)
    assert law.attrs["cross_validated_error"] < 1e-6


def test_a_law_with_parameters_survives_its_file(tmp_path):
    law = fit_law(response_of(exponential_gaps(6)), family="power", n_samples=5)
    save_law(law, tmp_path / "law.nc")
    read = law_from_dataset(open_law(tmp_path / "law.nc"))
    np.testing.assert_array_equal(read.pressure(1e-6), law_from_dataset(law).pressure(1e-6))


def test_fixed_parameters_keep_their_value_and_the_others_adapt():
    response = response_of(exponential_gaps(1))
    law = fit_law(response, family="exponential", fixed={"decay_length": 0.5e-6})
    assert float(law["decay_length"]) == 0.5e-6
    assert float(law["pressure_scale"]) != pytest.approx(4e8, rel=1e-3)


def test_a_point_without_weight_does_not_count():
    gap = exponential_gaps(1)
    expected = fit_law(response_of(gap), family="exponential")
    gap[0, 5] *= 1.1
    weights = np.ones(8)
    weights[5] = 0.0
    law = fit_law(response_of(gap), family="exponential", weights=weights)
    assert float(law["decay_length"]) == pytest.approx(float(expected["decay_length"]))
    every = fit_law(response_of(gap), family="exponential")
    assert float(every["decay_length"]) != pytest.approx(float(expected["decay_length"]), rel=1e-3)
    order = np.arange(8)[::-1]  # weights follow the steps of the response, not the pressures
    turned = fit_law(
        response_of(gap[:, order], PRESSURE[order]), family="exponential", weights=weights[order]
    )
    assert float(turned["decay_length"]) == pytest.approx(float(expected["decay_length"]))
    spline = law_from_dataset(fit_law(response_of(gap), weights=weights))
    assert spline.pressure(exponential_gaps(1)[0]) == pytest.approx(PRESSURE, rel=5e-3)
