"""Friction never supplies energy, turns with its frame, and has the limits of its formulas."""

import numpy as np
import pytest

from multiscale.laws import BellFriction, Coulomb, DecayingFriction, RigidContact

LAWS = [
    pytest.param(Coulomb(0.4), id="coulomb"),
    pytest.param(DecayingFriction(0.5, 0.2, 0.1), id="decaying"),
    pytest.param(BellFriction(1.2, 0.01, 0.3, 0.6, -0.3, 0.5, 1e5), id="bell"),
]


@pytest.fixture
def sliding():
    random = np.random.default_rng(seed=3)
    return 10.0 ** random.uniform(3, 8, 500), random.standard_normal((2, 500)) * 10.0 ** (
        random.uniform(-9, 2, 500)
    )


@pytest.mark.parametrize("law", LAWS)
def test_friction_dissipates_at_every_pressure_and_velocity(law, sliding):
    pressure, velocity = sliding
    assert np.all(np.sum(law.traction(pressure, velocity) * velocity, axis=0) >= 0.0)


@pytest.mark.parametrize("law", LAWS)
def test_friction_has_the_size_of_its_coefficient(law, sliding):
    pressure, velocity = sliding
    size = np.linalg.norm(law.traction(pressure, velocity), axis=0)
    expected = law.coefficient(pressure, np.linalg.norm(velocity, axis=0)) * pressure
    np.testing.assert_allclose(size, expected, rtol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_friction_turns_with_the_frame_of_the_tangent_plane(law, sliding):
    pressure, velocity = sliding
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s], [s, c]])
    np.testing.assert_allclose(
        law.traction(pressure, turn @ velocity), turn @ law.traction(pressure, velocity), rtol=1e-9
    )


@pytest.mark.parametrize("law", LAWS)
def test_an_interface_at_rest_or_without_pressure_has_no_sliding_friction(law):
    assert np.all(law.traction(np.array(1e6), np.zeros((2, 3))) == 0.0)
    assert np.all(law.traction(np.zeros(3), np.ones((2, 3))) == 0.0)


def test_limits_of_the_formulas():
    decaying = DecayingFriction(0.5, 0.2, 0.1)
    assert decaying.coefficient(np.array(1e5), 0.1) == pytest.approx(0.2 + 0.3 / np.e)


def test_a_bell_with_unit_exponents_is_the_loss_of_one_relaxation_time():
    v, p = np.geomspace(1e-5, 1e5, 41), np.array(1e5)
    loss = 2.0 * (v / 0.01) / (1.0 + (v / 0.01) ** 2)
    bell = BellFriction(1.2, 0.01, 1.0, 1.0, 0.0, 0.0, 1e5)
    np.testing.assert_allclose(bell.coefficient(p, v), 1.2 * loss, rtol=1e-12)


def test_a_skew_bell_peaks_at_its_peak_speed_and_has_powers_of_the_speed_as_flanks():
    bell, p = BellFriction(1.2, 0.01, 0.25, 0.75, -0.5, 0.5, 1e5), np.array(1e5)
    near = 0.01 * np.exp(np.array([-1e-3, 0.0, 1e-3]))
    mu = bell.coefficient(p, near)
    assert mu[1] == pytest.approx(1.2)
    assert mu[0] < mu[1] > mu[2]
    assert mu[2] - mu[0] == pytest.approx(0.0, abs=1e-9)  # smooth there
    slow, fast = np.array([1e-30, 1e-29]), np.array([1e29, 1e30])
    for speeds, power in ((slow, 0.25), (fast, -0.75)):
        low, high = bell.coefficient(p, speeds)
        assert high / low == pytest.approx(10.0**power, rel=1e-9)
    # four times the pressure halves the peak and moves it to twice the speed
    assert bell.coefficient(4.0 * p, 0.02) == pytest.approx(0.6)
    assert bell.coefficient(4.0 * p, 0.02 * np.exp(0.1)) < 0.6


def test_a_bell_is_finite_at_rest_and_without_pressure():
    bell = BellFriction(1.2, 0.01, 0.25, 0.75, -0.5, 0.5, 1e5)
    p, v = np.meshgrid([0.0, 1e5], [0.0, 1.0])
    assert np.all(np.isfinite(bell.coefficient(p, v)))
    assert bell.coefficient(np.array(1e5), 0.0) == pytest.approx(0.0, abs=1e-30)


@pytest.mark.parametrize("second", [1.0, 1e-5, 1e5])
def test_rigid_contact_slides_against_its_traction_whatever_the_direction(second):
    rng = np.random.default_rng(seed=2)
    law, state = RigidContact(0.3), rng.normal(0, 1e-7, (2, 300))
    k = np.array([[1e13], [1e13], [second * 1e13]])
    source = rng.normal(0, 1e6, (3, 300)) * np.array([[1.0], [1.0], [max(1.0, second)]])
    jump = law.resolvent(source, k, state)
    traction, slip = source - k * jump, jump[1:] - state
    limit = -0.3 * traction[0]
    size, way = np.hypot(*traction[1:]), np.hypot(*slip)
    assert np.all(size <= limit + 1e-9 * np.abs(source).max())
    slides = (way > 1e-6 * way.max()) & (limit > 1e-2 * limit.max())
    assert 20 < np.count_nonzero(slides) < 280
    np.testing.assert_allclose(
        np.sum(traction[1:] * slip, 0)[slides], (size * way)[slides], rtol=1e-6
    )
    np.testing.assert_allclose(size[slides], limit[slides], rtol=1e-6)
