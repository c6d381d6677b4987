"""The area law stays between no and full contact and follows its data."""

import numpy as np
import pytest

from multiscale.laws import AreaLaw

PRESSURE = np.array([1.0e6, 3.0e6, 9.0e6, 2.7e7])
LAWS = [
    pytest.param(AreaLaw(PRESSURE, np.array([0.02, 0.06, 0.17, 0.42])), id="rough"),
    pytest.param(AreaLaw(PRESSURE, np.array([0.0, 0.1, 0.1, 0.9])), id="with a plateau"),
    pytest.param(AreaLaw(PRESSURE, np.array([0.5, 0.9, 1.0, 1.0])), id="closed"),
]


@pytest.mark.parametrize("law", LAWS)
def test_area_starts_at_zero_never_decreases_and_never_exceeds_unity(law):
    fraction = law.contact_fraction(np.append(0.0, np.geomspace(1.0, 1e12, 5000)))
    assert fraction[0] == 0.0
    assert np.all(np.diff(fraction) >= -1e-15)
    assert np.all(fraction <= 1.0)


@pytest.mark.parametrize("law", LAWS)
def test_area_passes_through_its_knots(law):
    np.testing.assert_allclose(
        law.contact_fraction(law.knot_pressure), law.knot_fraction, atol=1e-14
    )


def test_area_is_proportional_to_light_pressure():
    law = AreaLaw(PRESSURE, np.array([0.02, 0.06, 0.17, 0.42]))
    np.testing.assert_allclose(law.contact_fraction(np.array([[2.5e5, 5e5]])), [[0.005, 0.01]])


def test_a_power_of_the_pressure_is_followed_between_knots():
    p = np.geomspace(1e6, 2.7e7, 50)
    law = AreaLaw(PRESSURE, 0.02 * (PRESSURE / 1e6) ** 0.9)
    np.testing.assert_allclose(law.contact_fraction(p), 0.02 * (p / 1e6) ** 0.9, rtol=1e-12)


def test_area_continues_with_the_slope_of_its_last_knot():
    law = AreaLaw(PRESSURE, np.array([0.02, 0.06, 0.17, 0.42]))
    p = PRESSURE[-1] * np.array([1.0 - 1e-6, 1.0, 1.0 + 1e-6])
    before, after = np.diff(law.contact_fraction(p))
    assert after == pytest.approx(before, rel=1e-4)
