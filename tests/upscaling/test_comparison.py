"""The family that made the data is selected, and a superfluous parameter is detected."""

import numpy as np
import pytest

from multiscale.laws import BellFriction, Coulomb, ErrorFunctionArea, Exponential, PowerLaw
from multiscale.upscaling import compare_laws, observe
from tests.upscaling.responses import exponential_gaps, response_of

PRESSURE = np.geomspace(5e6, 1e8, 10)


@pytest.mark.parametrize(
    ("law", "winner"),
    [(Exponential(4e8, 0.45e-6), "exponential"), (PowerLaw(4e8, 1.2e-6, 2.2), "power")],
)
def test_the_family_of_the_data_is_selected_in_spite_of_noise(law, winner):
    wins = 0
    for seed in range(10):
        noise = 1.0 + 0.002 * np.random.default_rng(seed).standard_normal((8, 10))
        table = compare_laws(
            observe("gap", PRESSURE, law.gap_at(PRESSURE) * noise), ["exponential", "power"]
        )
        best = str(table["family"][int(np.nanargmax(table["akaike_weight"]))].values)
        wins += best == winner
        assert float(table["akaike_weight"].sum()) == pytest.approx(1.0)
    assert wins >= 8


def test_the_law_of_free_form_is_compared_by_unseen_data():
    table = compare_laws(response_of(exponential_gaps(5)))
    assert set(table["family"].values) == {"convex_decreasing", "exponential", "power"}
    assert np.all(np.diff(table["cross_validated_error"]) >= 0.0)
    free = table.sel(family="convex_decreasing")
    assert np.isnan(free["akaike_criterion"])
    assert float(free["cross_validated_error"]) < 5e-3
    assert int(table["admissible"].min()) == 1


def test_friction_that_depends_on_speed_is_separated_from_coulombs():
    p, v = (part.ravel() for part in np.meshgrid([1e5, 1e6], np.geomspace(1e-4, 1e2, 9)))
    random = np.random.default_rng(seed=1)
    bell = BellFriction(1.0, 0.1, 0.3, 0.5, -0.1, 0.3, 3e5)
    for law, winner in ((Coulomb(0.3), "coulomb"), (bell, "bell")):
        mu = law.coefficient(p, v) * (1.0 + 0.01 * random.standard_normal((6, p.size)))
        table = compare_laws(observe("friction_coefficient", (p, v), mu))
        assert str(table["family"][int(np.nanargmax(table["akaike_weight"]))].values) == winner


def test_an_area_of_free_form_is_compared_with_the_error_function():
    p = np.geomspace(1e6, 1e9, 12)
    table = compare_laws(observe("contact_fraction", p, 1.0 - np.exp(-p / 3e8)))
    assert list(table["family"].values) == ["monotone", "error_function"]
    exact = compare_laws(observe("contact_fraction", p, ErrorFunctionArea(3e8).contact_fraction(p)))
    assert str(exact["family"][0].values) == "error_function"
    assert float(exact["cross_validated_error"][0]) < 1e-6
