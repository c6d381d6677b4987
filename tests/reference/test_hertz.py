"""Closed forms of smooth contact: numbers of the validation plan and identities."""

import numpy as np
import pytest
from scipy.integrate import quad

from multiscale.laws.bulk.moduli import contact_modulus
from tests.closed_forms import hertz, mindlin
from tests.closed_forms.rings import NestedRings

STEEL = (210e9, 0.3)
MODULUS = contact_modulus(STEEL, STEEL)
FORCE, RADIUS = 100.0, 10e-3
A = hertz.sphere_radius(FORCE, RADIUS, MODULUS)


def test_the_sphere_has_the_published_numbers():
    assert pytest.approx(0.186626e-3, rel=1e-5) == A
    assert hertz.sphere_approach(FORCE, RADIUS, MODULUS) == pytest.approx(3.48291e-6, rel=1e-5)
    peak = hertz.sphere_pressure(np.array([0.0]), FORCE, RADIUS, MODULUS)[0]
    assert peak == pytest.approx(1370.88e6, rel=1e-5)
    assert hertz.sphere_stiffness(FORCE, RADIUS, MODULUS) == pytest.approx(43067e3, rel=1e-4)


def test_the_stiffness_is_the_derivative_of_the_force():
    d = [hertz.sphere_approach(FORCE * (1.0 + s), RADIUS, MODULUS) for s in (-1e-5, 1e-5)]
    slope = 2e-5 * FORCE / (d[1] - d[0])
    assert hertz.sphere_stiffness(FORCE, RADIUS, MODULUS) == pytest.approx(slope, rel=1e-8)


def test_pressures_carry_their_load():
    ring = quad(lambda r: 2 * np.pi * r * hertz.sphere_pressure(r, FORCE, RADIUS, MODULUS), 0.0, A)
    assert ring[0] == pytest.approx(FORCE, rel=1e-7)
    half = hertz.cylinder_half_width(2e5, RADIUS, MODULUS)
    line = quad(lambda x: hertz.cylinder_pressure(x, 2e5, RADIUS, MODULUS), -half, half)
    assert line[0] == pytest.approx(2e5, rel=1e-7)
    punch = quad(lambda r: 2 * np.pi * r * hertz.punch_pressure(r, FORCE, A), 0.0, A)
    assert punch[0] == pytest.approx(FORCE, rel=1e-6)


def test_the_cylinder_has_the_numbers_of_nafems():
    modulus = contact_modulus(STEEL, (70e9, 0.3))
    assert hertz.cylinder_half_width(35e6, 0.05, modulus) == pytest.approx(6.2146e-3, rel=1e-5)
    peak = hertz.cylinder_pressure(np.array([0.0]), 35e6, 0.05, modulus)[0]
    assert peak == pytest.approx(3585.4e6, rel=2e-5)


def test_partial_slip_has_the_published_numbers():
    modulus, limit = mindlin.tangential_modulus(STEEL, STEEL), 0.3 * FORCE
    ratio = np.array([0.25, 0.75])
    np.testing.assert_allclose(mindlin.stick_radius(ratio), [0.90856, 0.62996], atol=5e-6)
    motion = mindlin.tangential_displacement(ratio, limit, A, modulus)
    np.testing.assert_allclose(motion, [2.2142e-7, 7.6526e-7], rtol=2e-5)
    energy = mindlin.loop_energy(np.array([0.5, 0.9]), limit, A, modulus)
    np.testing.assert_allclose(energy, [1.07238e-6, 1.22179e-5], rtol=1e-5)


@pytest.mark.parametrize("ratio", [0.1, 0.5, 0.95])
def test_tangential_traction_carries_its_load_within_friction(ratio):
    peak = 1.5 * FORCE / (np.pi * A**2)

    def traction(r):
        return mindlin.tangential_traction(r, ratio, 0.3, A, peak)

    c = A * float(mindlin.stick_radius(ratio))
    load = sum(quad(lambda r: 2 * np.pi * r * traction(r), *ends)[0] for ends in ((0.0, c), (c, A)))
    assert load == pytest.approx(ratio * 0.3 * FORCE, rel=1e-7)
    r = np.linspace(0.0, A, 50)
    limit = 0.3 * hertz.sphere_pressure(r, FORCE, RADIUS, MODULUS)
    assert np.all(traction(r) <= limit * (1.0 + 1e-12) + 1e-3)


def test_the_loop_energy_is_the_area_of_masings_loop():
    modulus, limit, ratio = mindlin.tangential_modulus(STEEL, STEEL), 30.0, 0.7
    force = ratio * limit
    top = float(mindlin.tangential_displacement(ratio, limit, A, modulus))

    def unloading(T):  # the first curve, twice as large, from the point of reversal
        half = mindlin.tangential_displacement((force - T) / 2.0 / limit, limit, A, modulus)
        return top - 2.0 * float(half)

    # the loop is symmetric: the reloading branch is minus the unloading one at -T
    area = quad(lambda T: -unloading(-T) - unloading(T), -force, force)[0]
    assert abs(area) == pytest.approx(
        float(mindlin.loop_energy(ratio, limit, A, modulus)), rel=1e-8
    )


@pytest.mark.parametrize(
    ("poissons_ratio", "expected"),
    [(0.3, [0.2240, 0.9186, 0.9917]), (0.0, [0.0269, 0.6268, 0.9038])],
)
def test_spence_has_the_published_numbers(poissons_ratio, expected):
    found = [mindlin.spence_stick_radius(mu, poissons_ratio) for mu in (0.1, 0.3, 0.5)]
    np.testing.assert_allclose(found, expected, atol=6e-5)


def test_nested_rings_meet_their_boundary_conditions():
    rings = NestedRings((0.6, 0.8, 1.0), 1e9, 0.2, 1e7, 1e6)
    angle = np.linspace(0.0, np.pi / 2.0, 7)
    x = 0.8 * np.stack([np.cos(angle), np.sin(angle)])
    inner, outer = (rings.displacement(x, side) for side in (False, True))
    normal = x / 0.8
    np.testing.assert_allclose(np.sum(inner * normal, 0), np.sum(outer * normal, 0), rtol=1e-10)
    # Lame: a pressure on the outside of two rings without a gap is that on one thick ring
    even = NestedRings((0.6, 0.8, 1.0), 1e9, 0.2, 1e7, 0.0)
    thick = 1e7 * (1.0 - 0.6**2 / 0.8**2) / (1.0 - 0.6**2)
    np.testing.assert_allclose(even.contact_pressure(angle), thick, rtol=1e-12)
