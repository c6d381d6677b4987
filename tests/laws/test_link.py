"""Properties of every link law, and the modes of a beam."""

import numpy as np
import pytest

from multiscale.laws.link import Bar, Beam, Cable, Strut

LAWS = [
    pytest.param(Bar(3.0), id="bar"),
    pytest.param(Cable(3.0), id="cable"),
    pytest.param(Strut(3.0), id="strut"),
]


@pytest.fixture
def strain():
    return np.random.default_rng(seed=3).uniform(-1.0, 1.0, size=(5, 7))


@pytest.mark.parametrize("law", LAWS)
def test_tangent_is_the_derivative_of_the_tension(law, strain):
    step = 1e-6
    difference = law.respond(strain + step).tension - law.respond(strain - step).tension
    np.testing.assert_allclose(law.respond(strain).tangent, difference / (2.0 * step), atol=1e-6)


@pytest.mark.parametrize("law", LAWS)
def test_tension_is_admissible_and_complementary_to_the_slack(law, strain):
    response = law.respond(strain)
    assert np.all((response.tension >= law.lower) & (response.tension <= law.upper))
    assert np.all(response.slack >= 0.0)
    assert not np.any(response.tension * response.slack)


def test_a_cable_and_a_strut_share_the_force_of_a_bar(strain):
    both = Cable(3.0).respond(strain).tension + Strut(3.0).respond(strain).tension
    np.testing.assert_array_equal(both, Bar(3.0).respond(strain).tension)


def test_bending_modes_give_the_stiffness_4_and_2_EI_over_L():
    beam = Beam(rigidity=1.0, torsion=1.0, bending_y=5.0, bending_z=7.0)
    _, _, even_y, odd_y, even_z, odd_z = beam.mode_stiffness(np.array([2.0]))[:, 0]
    assert (even_y + odd_y, odd_y - even_y) == pytest.approx((4 * 5 / 2, 2 * 5 / 2))
    assert (even_z + odd_z, odd_z - even_z) == pytest.approx((4 * 7 / 2, 2 * 7 / 2))
