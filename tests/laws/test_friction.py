"""Friction never supplies energy, turns with its frame, and has the limits of its formulas."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.laws import BellFriction, Coulomb, DecayingFriction

LAWS = [
    pytest.param(Coulomb(0.4), id="coulomb"),
    pytest.param(DecayingFriction(0.5, 0.2, 0.1), id="decaying"),
    pytest.param(BellFriction(1.2, 0.3, 0.01, 2.0, -0.3, 1e5), id="bell"),
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
    assert np.all(Coulomb(0.4).traction(np.zeros(3), np.ones((2, 3))) == 0.0)


def test_limits_of_the_formulas():
    decaying, bell = DecayingFriction(0.5, 0.2, 0.1), BellFriction(1.2, 0.25, 0.01, 2.0, -0.5, 1e5)
    p = np.array(1e5)
    assert decaying.coefficient(p, 0.1) == pytest.approx(0.2 + 0.3 / np.e)
    assert bell.coefficient(p, 0.01) == pytest.approx(1.2)
    assert bell.coefficient(p, 0.01 * np.exp(2.0)) == pytest.approx(1.2 * (0.25 + 0.75 / np.e))
    assert bell.coefficient(4 * p, 0.01) == pytest.approx(0.6)
    assert bell.coefficient(p, 0.0) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (
            lambda: Coulomb(-0.1),
            r"friction_coefficient must not be negative, but finite \(1\), got -0.1",
        ),
        (lambda: DecayingFriction(0.3, 0.2, 0.0), r"decay_speed must be positive .*\(m/s\)"),
        (lambda: BellFriction(1.0, 1.2, 1.0, 1.0, 0.0, 1e5), "rest_share must be at most 1"),
        (lambda: BellFriction(1.0, 0.2, 1.0, 0.0, 0.0, 1e5), "width must be positive"),
        (lambda: BellFriction(1.0, 0.2, 1.0, 1.0, np.nan, 1e5), "pressure_exponent must be finite"),
    ],
)
def test_parameters_out_of_range_are_refused(make, sentence):
    with pytest.raises(CaseError, match=sentence):
        make()
