"""The punch with friction against its closed forms and the numbers of the validation plan."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from tests.closed_forms.mindlin import full_stick_load_ratio, spence_stick_radius
from tests.closed_forms.spence import punch_with_friction


@pytest.mark.parametrize(("poissons_ratio", "expected"), [(0.0, 1.09861), (0.3, 1.02863)])
def test_full_stick_carries_the_closed_form(poissons_ratio, expected):
    assert full_stick_load_ratio(poissons_ratio) == pytest.approx(expected, abs=5e-6)
    found = punch_with_friction(100.0, poissons_ratio)[1]
    assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("friction", [0.1, 0.5])
@pytest.mark.parametrize("poissons_ratio", [0.0, 0.3])
def test_without_the_effect_of_shear_on_pressure_it_is_spences_formula(friction, poissons_ratio):
    radius, force = punch_with_friction(friction, poissons_ratio, coupled=False)
    exact = spence_stick_radius(friction, poissons_ratio)
    assert radius == pytest.approx(exact, abs=0.008)  # a ring is 0.0079 wide
    assert force == pytest.approx(1.0, rel=1e-4)


def test_shear_raises_the_force_and_narrows_the_stick_zone():
    radius, force = np.array([punch_with_friction(mu, 0.3) for mu in (0.1, 0.3, 0.5)]).T
    closed = [spence_stick_radius(mu, 0.3) for mu in (0.1, 0.3, 0.5)]
    assert np.all(radius < closed)
    assert np.all(np.diff([1.0, *force, full_stick_load_ratio(0.3)]) > 0.0)


def test_parameters_outside_the_theory_are_refused():
    with pytest.raises(CaseError, match="poissons_ratio lie in"):
        punch_with_friction(0.3, 0.5)
