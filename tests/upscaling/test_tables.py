"""CSV files of tests and of other codes: units in the head, sentences for missing entries."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io.csv_tables import read_table
from multiscale.laws import Exponential
from multiscale.upscaling import (
    best_family,
    fit_law,
    law_band,
    law_from_dataset,
    observe,
    predict,
    read_observations,
)
from multiscale.upscaling.measured.readers import read_measured
from multiscale.upscaling.reading import refuse_band
from multiscale.upscaling.specimens import with_specimen_budget
from multiscale.upscaling.tables import quantity_of


@pytest.fixture
def write(tmp_path):
    def _write(text):
        file = tmp_path / "data.csv"
        file.write_text(text)
        return file

    return _write


def test_units_are_converted_and_specimens_become_realisations(write):
    file = write(
        "Pressure (MPa), specimen, Stiffness [MPa/um], temperature\n"
        "20, a, 40, 20\n10, a, 21, 20\n10, b, 19, 21\n30, b, 62, 21\n"
    )
    seen = read_observations(file, "normal_stiffness")
    np.testing.assert_allclose(seen.pressure, [1e7, 2e7, 3e7])
    np.testing.assert_allclose(seen.values, 1e12 * np.array([[21, 40, np.nan], [19, np.nan, 62]]))


def test_semicolons_separate_numbers_with_decimal_commas(write):
    file = write("pressure (MPa);stiffness (MPa/um);note\n1,5;2;a, b\n")
    seen = read_observations(file, "normal_stiffness")
    np.testing.assert_allclose([*seen.pressure, *seen.values[0]], [1.5e6, 2e12])


def test_decimal_commas_do_not_change_texts(write):
    table = read_table(write("p;note\n1,5;a,b\n"), lambda name: str if name == "note" else float)
    assert table == {"p": [1.5], "note": ["a,b"]}


def test_without_specimens_repeated_points_are_separated_by_their_order(write):
    seen = read_observations(
        write("pressure (Pa),contact fraction (%)\n1,10\n2,20\n1,12\n"), "contact_fraction"
    )
    np.testing.assert_allclose(seen.values, [[0.1, 0.2], [0.12, np.nan]])


@pytest.mark.parametrize("family", ["exponential", "power", "convex_decreasing"])
def test_a_law_is_fitted_to_measured_stiffness(write, family):
    """K = p / u_0, and gaps count from the largest pressure."""
    pressure = np.linspace(5.0, 60.0, 12)  # MPa
    rows = "".join(f"{p},{p / 0.45}\n" for p in pressure)
    seen = read_observations(
        write("pressure (MPa),stiffness (MPa/um)\n" + rows), "normal_stiffness"
    )
    law = law_from_dataset(fit_law(seen, family=family))
    if family == "power":  # an exponential law is the limit of large exponents
        assert law.exponent > 20.0
    p = np.array([1e7, 3e7, 5e7])
    np.testing.assert_allclose(law.stiffness(law.gap_at(p)), p / 0.45e-6, rtol=2e-2)
    np.testing.assert_allclose(law.gap_at(p), 0.45e-6 * np.log(6e7 / p), rtol=2e-2, atol=2e-9)


def test_single_measurements_give_bands_from_their_residuals():
    random, p = np.random.default_rng(seed=2), np.linspace(5e6, 6e7, 20)
    noisy = p / 0.45e-6 * (1.0 + 0.05 * random.standard_normal(20))
    law = fit_law(observe("normal_stiffness", p, noisy), family="exponential")
    assert law.attrs["uncertainty"] == "bootstrap over the residuals of independent points"
    low, high = law_band(law, lambda item: item.stiffness(item.gap_at(np.array([1e7]))))
    assert low < 1e7 / 0.45e-6 < high
    assert (high - low) * 0.45e-6 / 1e7 == pytest.approx(2 * 1.96 * 0.05 / np.sqrt(20), rel=0.5)


def test_specimens_give_bands_by_specimen():
    p = np.linspace(5e6, 6e7, 10)
    stiffness = p / 0.45e-6 * np.array([[0.9], [1.0], [1.1], [1.05]])
    law = fit_law(observe("normal_stiffness", p, stiffness), n_samples=100)
    assert law.attrs["uncertainty"] == "bootstrap over realisations"
    low, high = law_band(law, lambda item: item.stiffness(item.gap_at(np.array([2e7]))))
    mean = 1.0125 * 2e7 / 0.45e-6
    assert low < mean < high
    assert (high - low) / mean > 0.1


def test_bands_ask_for_enough_realisations_and_samples():
    p = np.geomspace(1e6, 1e8, 8)
    gaps = Exponential(4e8, 1e-6).gap_at(p) * np.array([[1.0], [1.1], [0.95]])

    def band(confidence, n=3, samples=200):
        fit = fit_law(
            observe("gap", p, np.tile(gaps, (2, 1))[:n]), family="exponential", n_samples=samples
        )
        return law_band(fit, lambda law: law.gap_at(p), confidence=confidence)

    with pytest.raises(CaseError, match="3 realisations are too few for a band of 95 %; use at le"):
        band(0.95)
    band(0.9)
    with pytest.raises(CaseError, match=r"4 realisations are too few for a band of 99.9 %.* 5"):
        band(0.999, n=4)
    with pytest.raises(CaseError, match=r"50 samples are too few .* with 80 samples"):
        band(0.95, n=5, samples=50)
    narrow, wide = band(0.8, n=5), band(0.95, n=5)
    assert np.all(wide[1] - wide[0] > narrow[1] - narrow[0])


def test_the_next_specimen_scatters_as_those_measured_by_students_interval():
    """Specimens differ by one factor; two of exp(+-.1) have s = .1 sqrt 2 and one freedom."""
    p = np.geomspace(1e6, 5e7, 8)
    stiffness = 3e12 * (p / 1e6) ** 0.6
    seen = observe("normal_stiffness", p, stiffness * np.exp([[-0.1], [0.1]]))
    family, _ = best_family(seen)
    prediction = predict(fit_law(seen, family=family), seen, p[2:4])
    low, high = prediction.next_specimen
    half = 12.706 * 0.1 * np.sqrt(2.0) * np.sqrt(1.5)
    np.testing.assert_allclose(np.log(high / low), 2.0 * half, rtol=1e-3)
    np.testing.assert_allclose(prediction.value, np.cosh(0.1) * stiffness[2:4], rtol=5e-3)
    ratio = np.log(prediction.mean_law[1] / prediction.mean_law[0])
    np.testing.assert_allclose(ratio, 2.0 * half / np.sqrt(3.0), rtol=1e-3)
    assert prediction.unknown == ()


def scattered_specimens(n, noise=0.15):
    """Specimens with a factor each, and scatter of single values."""
    draw, p = np.random.default_rng(7).standard_normal, np.geomspace(1e6, 5e7, 8)
    factor = np.exp(0.06 * draw((n, 1)) + noise * draw((n, 8)))
    return observe("normal_stiffness", p, 3e12 * (p / 1e6) ** 0.6 * factor)


def test_the_interval_of_the_next_specimen_contains_the_interval_of_the_mean():
    seen = scattered_specimens(5)
    prediction = predict(fit_law(seen), seen, seen.pressure)
    assert np.all(prediction.next_specimen[0] < prediction.mean_law[0])
    assert np.all(prediction.mean_law[1] < prediction.next_specimen[1])


@pytest.mark.parametrize("quantity", ["mean_gap", "stiffness"])
@pytest.mark.parametrize("n", [1, 2, 6])
def test_a_law_of_specimens_has_a_budget_of_their_scatter(n, quantity):
    """Gaps of a measured stiffness are in inverse proportion to it, with the same factors."""
    seen = scattered_specimens(n, noise=0.0)
    law = with_specimen_budget(fit_law(seen, family="power"), seen)
    half = law["error_half_width"].sel(quantity=quantity)
    factor = np.log(seen.values[:, 0]).std(ddof=1) if n > 1 else np.nan
    student = factor * {1: np.nan, 2: 12.706, 6: 2.5706}[n]
    of_mean, few = half.sel(error_term="sampling"), half.sel(error_term="few cells")
    np.testing.assert_allclose(of_mean, np.expm1(student / np.sqrt(n)), rtol=1e-4)
    upper = np.expm1(student * np.sqrt(1.0 + 1.0 / n))
    np.testing.assert_allclose(np.hypot(of_mean, few), upper, rtol=1e-4)
    assert law.attrs["unknown"] == ("sampling, few cells" if n == 1 else "")
    assert refuse_band(law)[:23] == ("2 specimens are too few" if n == 2 else "")


@pytest.mark.parametrize("of", ["gap", "normal_stiffness"])
@pytest.mark.parametrize("n", [2, 3])
def test_intervals_of_fit_and_of_structures_have_the_same_upper_ends(n, of):
    seen = scattered_specimens(n, noise=0.0)
    if of == "gap":
        gap = Exponential(4e8, 1e-6).gap_at(seen.pressure)
        seen = observe("gap", seen.pressure, gap + np.linspace(0.0, 2e-8, n)[:, None])
    law = with_specimen_budget(
        fit_law(seen, family="exponential" if of == "gap" else "power"), seen
    )
    quantity = "mean_gap" if of == "gap" else "stiffness"
    half = law["error_half_width"].sel(quantity=quantity).to_numpy()
    half = dict(zip(law["error_term"].values, half, strict=True))
    prediction = predict(law, seen, seen.pressure)
    ends = prediction.mean_law[1], prediction.next_specimen[1]
    for end, names in zip(ends, (["sampling"], ["sampling", "few cells"]), strict=True):
        error = np.linalg.norm([half[name] for name in names], axis=0)
        np.testing.assert_allclose(end, prediction.value * (1.0 + error), rtol=1e-6)


@pytest.mark.parametrize("load", ["preload", "pressure"])
def test_a_load_has_either_name_in_every_table(load, write):
    rows = "\n".join(f"{p}, {2.0 * p**0.6}" for p in (1, 3, 9))
    file = write(f"{load} (MPa), stiffness (MPa/um)\n{rows}\n")
    np.testing.assert_allclose(read_observations(file, "normal_stiffness").pressure[1], 3e6)
    np.testing.assert_allclose(read_measured(file, "stiffness", error=0.1).pressure[1], 3e6)


def test_the_column_next_to_the_pressure_names_the_quantity(write):
    assert quantity_of(write("gap (um), pressure (MPa)\n1,2\n")) == "gap"
    with pytest.raises(CaseError, match="pressure and stiffness or gap"):
        quantity_of(write("pressure (MPa), force (N)\n1,2\n"))


@pytest.mark.parametrize("cell", ["inf", "nan", "-inf"])
def test_every_table_refuses_numbers_that_are_not_finite_unless_it_asks_for_them(write, cell):
    file = write(f"x,y\n1,2\n3,{cell}\n")
    with pytest.raises(CaseError, match=f"line 3: y should be a finite number, got '{cell}'"):
        read_table(file)
    assert len(read_table(file, lambda name: float)["y"]) == 2
