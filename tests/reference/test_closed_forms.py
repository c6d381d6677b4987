"""Closed forms: published numbers, limits and identities between them."""

import numpy as np
import pytest
from numpy import pi
from scipy.integrate import quad

from tests.closed_forms import full_contact, johnson, joint, layer, persson, westergaard


# numbers of the validation plan, computed from the formulas by hand there
@pytest.mark.parametrize(
    ("s", "area", "peak", "gap"),
    [
        (0.1, 0.20483, 6.3246, 0.669),
        (0.25, 1.0 / 3.0, 4.0, 0.403),
        (0.5, 0.5, 2.8284, 0.153),
        (0.75, 2.0 / 3.0, 2.3094, 0.0342),
    ],
)
def test_westergaard_has_the_published_numbers(s, area, peak, gap):
    assert westergaard.contact_fraction(s) == pytest.approx(area, abs=1e-5)
    assert westergaard.largest_pressure(s) == pytest.approx(peak, abs=1e-4)
    assert westergaard.mean_gap(s) == pytest.approx(gap, rel=3e-3)


@pytest.mark.parametrize("s", [0.1, 0.5, 0.9])
def test_westergaard_pressure_carries_the_load_over_the_contact(s):
    half = 0.5 * float(westergaard.contact_fraction(s))
    load = 2.0 * quad(westergaard.pressure_profile, 0.0, half, args=(s,))[0]
    assert load == pytest.approx(1.0, rel=1e-7)
    assert westergaard.pressure_profile(0.0, s) == pytest.approx(westergaard.largest_pressure(s))
    assert westergaard.pressure_profile(0.5, s) == 0.0


def test_westergaard_gap_follows_from_the_energy_of_full_contact():
    amplitude, wavelength, modulus = 2e-6, 1e-3, 1e11
    full = westergaard.full_contact_pressure(amplitude, wavelength, modulus)
    # the work of the pressure on the closing gap is the energy of the flattened wave
    work = quad(lambda s: full * amplitude * westergaard.mean_gap(s), 0.0, 1.0)[0]
    q = 2.0 * pi / wavelength
    energy = full_contact.elastic_energy(np.full(2, q), np.full(2, amplitude / 2), modulus)
    assert work == pytest.approx(energy, rel=1e-9)


def test_full_contact_closes_the_gap():
    s = np.array([0.0, 1.0, 3.0])
    np.testing.assert_allclose(westergaard.contact_fraction(s), [0.0, 1.0, 1.0])
    np.testing.assert_allclose(westergaard.mean_gap(s), [1.0, 0.0, 0.0])
    np.testing.assert_allclose(westergaard.largest_pressure(np.array([1.0, 3.0])), [2.0, 4.0 / 3.0])


def test_johnson_has_the_published_numbers():
    assert johnson.contact_fraction_low(0.01) == pytest.approx(0.0354, abs=1e-4)
    high = johnson.contact_fraction_high(np.array([0.9, 0.95, 1.0]))
    np.testing.assert_allclose(high, [0.9523, 0.9761, 1.0], atol=1e-4)


def test_johnson_low_limit_is_the_contact_of_hertz():
    amplitude, wavelength, modulus, r = 1e-6, 1e-3, 1e11, 1e-6
    radius = wavelength**2 / (4.0 * pi**2 * amplitude)  # at a crest
    # two crests in every square of one wavelength
    load = 0.5 * r * johnson.full_contact_pressure(amplitude, wavelength, modulus) * wavelength**2
    contact_radius = (3.0 * load * radius / (4.0 * modulus)) ** (1.0 / 3.0)
    expected = 2.0 * pi * contact_radius**2 / wavelength**2
    assert johnson.contact_fraction_low(r) == pytest.approx(expected, rel=1e-12)


def test_layer_has_the_published_numbers():
    phase = 2.0 * pi * np.array([0.25, 0.5, 1.0])
    ratio = layer.ratio_bonded(phase, 0.3)
    np.testing.assert_allclose(ratio, [0.6320, 0.9441, 0.99964], atol=6e-5)


@pytest.mark.parametrize("poissons_ratio", [0.0, 0.3, 0.499])
def test_a_deep_layer_is_a_half_space(poissons_ratio):
    for phase in (30.0, 1e4):
        assert layer.ratio_bonded(phase, poissons_ratio) == pytest.approx(1.0, abs=1e-12)
        assert layer.ratio_frictionless(phase) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("poissons_ratio", [0.0, 0.3])
def test_a_thin_bonded_layer_is_an_oedometer(poissons_ratio):
    E, thickness, phase = 2.0, 0.1, 1e-3
    contact_modulus = E / (1.0 - poissons_ratio**2)
    half_space = 2.0 * thickness / (contact_modulus * phase)
    expected = layer.oedometer_compliance(thickness, E, poissons_ratio)
    found = layer.ratio_bonded(phase, poissons_ratio) * half_space
    assert found == pytest.approx(expected, rel=1e-4)


def test_a_thin_frictionless_layer_is_in_plane_strain_compression():
    phase = 1e-3
    # p T (1 - nu^2) / E over 2 p / (E* q)
    assert layer.ratio_frictionless(phase) == pytest.approx(phase / 2.0, rel=1e-4)


def test_full_contact_pressure_of_random_waves_has_the_rms_of_its_slope():
    rng = np.random.default_rng(seed=8)
    n, length, modulus = 64, 1e-3, 1e11
    q1 = 2.0 * pi * np.fft.fftfreq(n, length / n)
    q = np.hypot(*np.meshgrid(q1, q1))
    spectrum = np.fft.fft2(rng.normal(size=(n, n))) * (q > 0) * (q < 0.3 * q1.max()) / n**2
    heights = 1e-6 * spectrum
    pressure = np.fft.ifft2(0.5 * modulus * q * heights).real * n**2
    slope = np.sqrt(np.sum(q**2 * np.abs(heights) ** 2))
    assert np.std(pressure) == pytest.approx(full_contact.rms_pressure(slope, modulus), rel=1e-12)
    surface = np.fft.ifft2(heights).real * n**2
    energy = full_contact.elastic_energy(q, heights, modulus)
    assert 0.5 * np.mean(pressure * surface) == pytest.approx(energy, rel=1e-12)


def test_persson_starts_with_his_slope_and_ends_at_one():
    assert persson.contact_fraction(1e-6) / 1e-6 == pytest.approx(persson.SLOPE_PERSSON)
    assert persson.contact_fraction(10.0) == pytest.approx(1.0)
    # erf column of the published table of boundary-element results
    np.testing.assert_allclose(
        persson.contact_fraction(np.array([0.01808, 0.14461, 0.53146])),
        [0.02884, 0.22759, 0.71218],
        atol=2e-5,
    )
    assert pytest.approx(1.5958, abs=1e-4) == persson.SLOPE_PERSSON
    assert pytest.approx(2.5066, abs=1e-4) == persson.SLOPE_BUSH_GIBSON_THOMAS


def test_joint_stiffness_is_its_ratio_times_that_of_the_solid():
    pressure, decay, E, h = np.array([1e6, 1e7]), 3e-7, 2e11, 0.01
    stiffness = joint.joint_stiffness(pressure, decay, h / E, h / E)
    ratio = joint.stiffness_ratio(pressure, decay, E, h)
    np.testing.assert_allclose(stiffness, ratio * E / (2.0 * h))


def test_a_centred_force_has_the_centred_stiffness():
    assert joint.eccentric_stiffness(5.0, (0.0, 0.0), (1.0, 2.0)) == 5.0
    # at the edge of the core the far edge carries nothing: 1 + 12/36
    assert joint.eccentric_stiffness(4.0, (1.0 / 6.0, 0.0), (1.0, 2.0)) == pytest.approx(3.0)
