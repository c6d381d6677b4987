"""A half-space with a profile and a law: closed forms at both ends."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.laws import Exponential
from multiscale.macro.half_space import half_space_stiffness, press_profile
from tests.closed_forms import westergaard

LENGTH, MODULUS = 1e-3, 1e11


@pytest.mark.parametrize("waves", [1, 3, 7])
def test_a_wave_meets_half_its_wavenumber(waves):
    x = LENGTH * np.arange(32) / 32
    q = 2.0 * np.pi * waves / LENGTH
    K = half_space_stiffness(32, LENGTH, MODULUS)
    force = K @ np.cos(q * x)  # per metre of width
    np.testing.assert_allclose(
        force * 32 / LENGTH, 0.5 * MODULUS * q * np.cos(q * x), atol=1e-9 * MODULUS * q
    )
    assert np.abs(K @ np.ones(32)).max() < 1e-9 * MODULUS


@pytest.mark.parametrize("ratio", [0.2, 0.5, 0.8])
def test_a_wave_with_a_law_tends_to_westergaards_as_the_roughness_vanishes(ratio):
    amplitude, n = 1e-2 * LENGTH, 128
    full = westergaard.full_contact_pressure(amplitude, LENGTH, MODULUS)
    gap = amplitude * (1.0 - np.cos(2.0 * np.pi * np.arange(n) / n))
    errors = []
    for height in (0.1, 0.01, 0.001):
        law = Exponential(pressure_scale=full, decay_length=height * amplitude)
        found = press_profile(gap, LENGTH, MODULUS, ratio * full, law).unwrap()
        errors.append(abs(found.mean() / amplitude - float(westergaard.mean_gap(np.array(ratio)))))
        assert np.mean(law.pressure(found)) == pytest.approx(ratio * full, rel=1e-8)
    assert errors[2] < 0.2 * errors[1] < 0.04 * errors[0] * 5.0
    assert errors[2] < 6e-3


def test_a_plane_takes_the_gap_of_its_pressure():
    law = Exponential(pressure_scale=1e9, decay_length=1e-6)
    found = press_profile(np.full(16, 3e-6), LENGTH, MODULUS, 1e7, law).unwrap()
    np.testing.assert_allclose(found, law.gap_at(np.array(1e7)), rtol=1e-9)


def test_no_pressure_is_refused():
    law = Exponential(pressure_scale=1e9, decay_length=1e-6)
    with pytest.raises(CaseError, match=r"must be positive and finite \(Pa\), got 0"):
        press_profile(np.zeros(16), LENGTH, MODULUS, 0.0, law)
