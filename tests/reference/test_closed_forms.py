"""Closed forms: published numbers, limits and identities between them."""

import numpy as np
import pytest
from numpy import pi
from scipy.integrate import quad

from multiscale.laws.bulk.bulk_law import contact_modulus
from tests.closed_forms import (
    full_contact,
    hertz,
    johnson,
    joint,
    layer,
    mindlin,
    persson,
    westergaard,
)
from tests.closed_forms.mindlin import full_stick_load_ratio as full_stick
from tests.closed_forms.mindlin import spence_stick_radius as stick
from tests.closed_forms.rings import NestedRings
from tests.closed_forms.spence import punch_with_friction

STEEL = (210e9, 0.3)
MODULUS, SHEAR = contact_modulus(STEEL, STEEL), mindlin.tangential_modulus(STEEL, STEEL)
FORCE, RADIUS = 100.0, 10e-3
SPHERE, LIMIT = (FORCE, RADIUS, MODULUS), 0.3 * FORCE
A = hertz.sphere_radius(*SPHERE)
ON_ALUMINIUM = (35e6, 0.05, contact_modulus(STEEL, (70e9, 0.3)))  # the cylinder of NAFEMS
SLIDER = (LIMIT, A, SHEAR)
LOADS = np.array([0.1, 0.25, 0.5, 0.75])


PART, HALVES, RATIOS = np.array([0.25, 0.75]), np.array([0.5, 0.9]), (0.1, 0.3, 0.5)
TABLE = np.array([0.01808, 0.14461, 0.53146])  # published, of boundary-element results

# numbers of the validation plan, computed from the formulas by hand there, or published:
# closed form, numbers, relative and absolute tolerance
PUBLISHED = {
    "area": (westergaard.contact_fraction(LOADS), [0.20483, 1 / 3, 0.5, 2 / 3], 0.0, 1e-5),
    "peak": (westergaard.largest_pressure(LOADS), [6.3246, 4.0, 2.8284, 2.3094], 0.0, 1e-4),
    "gap": (westergaard.mean_gap(LOADS), [0.669, 0.403, 0.153, 0.0342], 3e-3, 0.0),
    "johnson low": (johnson.contact_fraction_low(0.01), 0.0354, 0.0, 1e-4),
    "johnson": (johnson.contact_fraction_high(np.array([0.9, 0.95])), [0.9523, 0.9761], 0.0, 1e-4),
    "layer": (layer.ratio_bonded(0.5 * pi * np.array([1, 2]), 0.3), [0.6320, 0.9441], 0.0, 6e-5),
    "deep layer": (layer.ratio_bonded(2.0 * pi, 0.3), 0.99964, 0.0, 6e-5),
    "persson": (persson.contact_fraction(TABLE), [0.02884, 0.22759, 0.71218], 0.0, 2e-5),
    "persson's slope": (persson.SLOPE_PERSSON, 1.5958, 0.0, 1e-4),
    "slope of asperities": (persson.SLOPE_BUSH_GIBSON_THOMAS, 2.5066, 0.0, 1e-4),
    "sphere": ([A, hertz.sphere_approach(*SPHERE)], [0.186626e-3, 3.48291e-6], 1e-5, 0.0),
    "sphere, peak": (hertz.sphere_pressure(np.zeros(1), *SPHERE), 1370.88e6, 1e-5, 0.0),
    "sphere, stiffness": (hertz.sphere_stiffness(*SPHERE), 43067e3, 1e-4, 0.0),
    "cylinder": (hertz.cylinder_half_width(*ON_ALUMINIUM), 6.2146e-3, 1e-5, 0.0),
    "cylinder, peak": (hertz.cylinder_pressure(np.zeros(1), *ON_ALUMINIUM), 3585.4e6, 2e-5, 0.0),
    "stick": (mindlin.stick_radius(PART), [0.90856, 0.62996], 0.0, 5e-6),
    "slip": (mindlin.tangential_displacement(PART, *SLIDER), [2.2142e-7, 7.6526e-7], 2e-5, 0.0),
    "loop": (mindlin.loop_energy(HALVES, *SLIDER), [1.07238e-6, 1.22179e-5], 1e-5, 0.0),
    "spence, 0.3": ([stick(mu, 0.3) for mu in RATIOS], [0.2240, 0.9186, 0.9917], 0.0, 6e-5),
    "spence, 0": ([stick(mu, 0.0) for mu in RATIOS], [0.0269, 0.6268, 0.9038], 0.0, 6e-5),
    "full stick": ([full_stick(nu) for nu in (0.0, 0.3)], [1.09861, 1.02863], 0.0, 5e-6),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_closed_forms_have_the_published_numbers(name):
    computed, expected, relative, absolute = PUBLISHED[name]
    np.testing.assert_allclose(computed, expected, rtol=relative, atol=absolute)


# --- waves -----------------------------------------------------------------------------------


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
    np.testing.assert_allclose(westergaard.largest_pressure(s[1:]), [2.0, 4.0 / 3.0])


def test_johnson_low_limit_is_the_contact_of_hertz():
    amplitude, wavelength, modulus, r = 1e-6, 1e-3, 1e11, 1e-6
    radius = wavelength**2 / (4.0 * pi**2 * amplitude)  # at a crest
    # two crests in every square of one wavelength
    load = 0.5 * r * johnson.full_contact_pressure(amplitude, wavelength, modulus) * wavelength**2
    expected = 2.0 * pi * hertz.sphere_radius(load, radius, modulus) ** 2 / wavelength**2
    assert johnson.contact_fraction_low(r) == pytest.approx(expected, rel=1e-12)


def test_full_contact_pressure_of_random_waves_has_the_rms_of_its_slope():
    rng = np.random.default_rng(seed=8)
    n, length, modulus = 64, 1e-3, 1e11
    q1 = 2.0 * pi * np.fft.fftfreq(n, length / n)
    q = np.hypot(*np.meshgrid(q1, q1))
    heights = 1e-6 * np.fft.fft2(rng.normal(size=(n, n))) * (q > 0) * (q < 0.3 * q1.max()) / n**2
    pressure = np.fft.ifft2(0.5 * modulus * q * heights).real * n**2
    slope = np.sqrt(np.sum(q**2 * np.abs(heights) ** 2))
    assert np.std(pressure) == pytest.approx(full_contact.rms_pressure(slope, modulus), rel=1e-12)
    surface = np.fft.ifft2(heights).real * n**2
    energy = full_contact.elastic_energy(q, heights, modulus)
    assert 0.5 * np.mean(pressure * surface) == pytest.approx(energy, rel=1e-12)


def test_persson_starts_with_his_slope_and_ends_at_unity():
    assert persson.contact_fraction(1e-6) / 1e-6 == pytest.approx(persson.SLOPE_PERSSON)
    assert persson.contact_fraction(10.0) == pytest.approx(1.0)


# --- layers and joints -----------------------------------------------------------------------


@pytest.mark.parametrize("poissons_ratio", [0.0, 0.3, 0.499])
def test_a_deep_layer_is_a_half_space(poissons_ratio):
    for phase in (30.0, 1e4):
        assert layer.ratio_bonded(phase, poissons_ratio) == pytest.approx(1.0, abs=1e-12)
        assert layer.ratio_frictionless(phase) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("poissons_ratio", [0.0, 0.3])
def test_a_thin_bonded_layer_is_an_oedometer(poissons_ratio):
    E, thickness, phase = 2.0, 0.1, 1e-3
    half_space = 2.0 * thickness * (1.0 - poissons_ratio**2) / (E * phase)
    expected = layer.oedometer_compliance(thickness, E, poissons_ratio)
    computed = layer.ratio_bonded(phase, poissons_ratio) * half_space
    assert computed == pytest.approx(expected, rel=1e-4)


def test_a_thin_frictionless_layer_is_in_plane_strain_compression():
    phase = 1e-3  # p T (1 - nu^2) / E over 2 p / (E* q)
    assert layer.ratio_frictionless(phase) == pytest.approx(phase / 2.0, rel=1e-4)


def test_joint_stiffness_is_its_ratio_times_the_solid_stiffness():
    pressure, decay, E, h = np.array([1e6, 1e7]), 3e-7, 2e11, 0.01
    stiffness = joint.joint_stiffness(pressure, decay, h / E, h / E)
    ratio = joint.stiffness_ratio(pressure, decay, E, h)
    np.testing.assert_allclose(stiffness, ratio * E / (2.0 * h))


def test_a_centred_force_has_the_centred_stiffness():
    assert joint.eccentric_stiffness(5.0, (0.0, 0.0), (1.0, 2.0)) == 5.0
    # at the edge of the core the far edge carries nothing: 1 + 12/36
    assert joint.eccentric_stiffness(4.0, (1.0 / 6.0, 0.0), (1.0, 2.0)) == pytest.approx(3.0)


# --- smooth bodies ---------------------------------------------------------------------------


def over_a_disc(pressure, *ends):
    """Integral of a function of the radius between radii."""
    return quad(lambda r: 2.0 * pi * r * pressure(r), *ends)[0]


def test_the_stiffness_is_the_derivative_of_the_force():
    d = [hertz.sphere_approach(FORCE * (1.0 + s), RADIUS, MODULUS) for s in (-1e-5, 1e-5)]
    slope = 2e-5 * FORCE / (d[1] - d[0])
    assert hertz.sphere_stiffness(*SPHERE) == pytest.approx(slope, rel=1e-8)


def test_pressures_carry_their_load():
    sphere = over_a_disc(lambda r: hertz.sphere_pressure(r, *SPHERE), 0.0, A)
    assert sphere == pytest.approx(FORCE, rel=1e-7)
    half = hertz.cylinder_half_width(2e5, RADIUS, MODULUS)
    line = quad(lambda x: hertz.cylinder_pressure(x, 2e5, RADIUS, MODULUS), -half, half)
    assert line[0] == pytest.approx(2e5, rel=1e-7)
    punch = over_a_disc(lambda r: hertz.punch_pressure(r, FORCE, A), 0.0, A)
    assert punch == pytest.approx(FORCE, rel=1e-6)


@pytest.mark.parametrize("ratio", [0.1, 0.5, 0.95])
def test_tangential_traction_carries_its_load_within_friction(ratio):
    peak = 1.5 * FORCE / (pi * A**2)

    def traction(r):
        return mindlin.tangential_traction(r, ratio, 0.3, A, peak)

    c = A * float(mindlin.stick_radius(ratio))
    load = over_a_disc(traction, 0.0, c) + over_a_disc(traction, c, A)
    assert load == pytest.approx(ratio * LIMIT, rel=1e-7)
    r = np.linspace(0.0, A, 50)
    limit = 0.3 * hertz.sphere_pressure(r, *SPHERE)
    assert np.all(traction(r) <= limit * (1.0 + 1e-12) + 1e-3)


def test_the_loop_energy_is_the_area_of_masings_loop():
    ratio = 0.7
    force = ratio * LIMIT
    top = float(mindlin.tangential_displacement(ratio, *SLIDER))

    def unloading(T):  # the first curve, twice as large, from the point of reversal
        half = mindlin.tangential_displacement((force - T) / 2.0 / LIMIT, *SLIDER)
        return top - 2.0 * float(half)

    # the loop is symmetric: the reloading branch is minus the unloading branch at -T
    area = quad(lambda T: -unloading(-T) - unloading(T), -force, force)[0]
    assert abs(area) == pytest.approx(float(mindlin.loop_energy(ratio, *SLIDER)), rel=1e-8)


def test_nested_rings_meet_their_boundary_conditions():
    rings = NestedRings((0.6, 0.8, 1.0), 1e9, 0.2, 1e7, 1e6)
    angle = np.linspace(0.0, pi / 2.0, 7)
    x = 0.8 * np.stack([np.cos(angle), np.sin(angle)])
    inner, outer = (rings.displacement(x, side) for side in (False, True))
    np.testing.assert_allclose(np.sum(inner * x, 0), np.sum(outer * x, 0), rtol=1e-10)
    # Lame: a pressure on the outside of two rings without a gap is that on one thick ring
    even = NestedRings((0.6, 0.8, 1.0), 1e9, 0.2, 1e7, 0.0)
    thick = 1e7 * (1.0 - 0.6**2 / 0.8**2) / (1.0 - 0.6**2)
    np.testing.assert_allclose(even.contact_pressure(angle), thick, rtol=1e-12)


# --- punch with friction ---------------------------------------------------------------------


@pytest.mark.parametrize("poissons_ratio", [0.0, 0.3])
def test_full_stick_carries_the_closed_form(poissons_ratio):
    solution = punch_with_friction(100.0, poissons_ratio)[1]
    assert solution == pytest.approx(full_stick(poissons_ratio), rel=1e-3)


@pytest.mark.parametrize("friction", [0.1, 0.5])
@pytest.mark.parametrize("poissons_ratio", [0.0, 0.3])
def test_without_the_effect_of_shear_on_pressure_it_is_spences_formula(friction, poissons_ratio):
    radius, force = punch_with_friction(friction, poissons_ratio, coupled=False)
    exact = stick(friction, poissons_ratio)
    assert radius == pytest.approx(exact, abs=0.008)  # a ring is 0.0079 wide
    assert force == pytest.approx(1.0, rel=1e-4)


def test_shear_raises_the_force_and_narrows_the_stick_zone():
    radius, force = np.array([punch_with_friction(mu, 0.3) for mu in (0.1, 0.3, 0.5)]).T
    assert np.all(radius < [stick(mu, 0.3) for mu in (0.1, 0.3, 0.5)])
    assert np.all(np.diff([1.0, *force, full_stick(0.3)]) > 0.0)
