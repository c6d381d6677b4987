"""A tread block that slides: closed forms, equilibrium, and where its pressure goes."""

import numpy as np
import pytest

from multiscale.errors import ConvergenceError
from multiscale.laws import BellFriction, Coulomb, Exponential, SteadySliding
from multiscale.macro.joint import TreadBlock, condense_tread, slide_tread

SIZE, MODULUS, PRESSURE = (0.03, 0.02, 0.008), 4e6, 0.3e6
ROAD = Exponential(1e6, 5e-5)
BELL = BellFriction(0.8, 1.0, 0.4, 0.4, -0.2, 0.0, 3e5)


@pytest.fixture(scope="module")
def tread():
    return condense_tread(TreadBlock(SIZE, MODULUS, 0.49, (6, 4, 1)))


def test_without_lateral_contraction_and_friction_the_pressure_is_even():
    plain = condense_tread(TreadBlock(SIZE, MODULUS, 0.0, (3, 2, 1)))
    result = slide_tread(plain, SteadySliding(ROAD, Coulomb(0.0), (1.0, 0.0)), PRESSURE)
    np.testing.assert_allclose(-result.traction[0], PRESSURE, rtol=1e-7)
    np.testing.assert_allclose(result.traction[1:], 0.0)
    # the carcass comes down by the compression of a bar, and the road closes by its law
    approach = result.solution.unwrap()[-1]
    assert approach == pytest.approx(
        float(ROAD.gap_at(np.array(PRESSURE))) - PRESSURE * SIZE[2] / MODULUS, rel=1e-7
    )


def test_even_friction_shears_a_block_by_its_shear_modulus():
    wide = condense_tread(TreadBlock((0.2, 0.2, 0.002), MODULUS, 0.0, (6, 6, 1)))
    result = slide_tread(wide, SteadySliding(ROAD, Coulomb(0.1), (2.0, 0.0)), PRESSURE)
    middle = np.argmin(np.hypot(*wide.position))
    expected = -0.1 * PRESSURE * 0.002 / (MODULUS / 2.0)  # dragged back against the motion
    assert result.jump[1, middle] == pytest.approx(expected, rel=0.01)
    assert result.jump[2, middle] == pytest.approx(0.0, abs=0.01 * abs(expected))


def test_load_and_braking_force_are_in_equilibrium(tread):
    result = slide_tread(tread, SteadySliding(ROAD, BELL, (0.3, 0.0)), PRESSURE)
    assert result.solution.converged
    assert result.load == pytest.approx(PRESSURE * tread.block.area, rel=1e-8)
    p = -result.traction[0]
    mu = BELL.coefficient(p, np.full(p.shape, 0.3))
    assert result.braking_force == pytest.approx(result.weight @ (mu * p), rel=1e-12)
    # forces on the face and on the carcass of the condensed block balance, the latter along z
    forces = tread.whole.stiffness @ result.solution.value
    assert forces[-1] == pytest.approx(-result.load, rel=1e-8)
    assert forces[0:-1:3].sum() == pytest.approx(-result.braking_force, rel=1e-8)


def test_friction_moves_the_pressure_to_the_edge_that_leads_and_turns_with_the_motion(tread):
    def centre(speed):
        result = slide_tread(tread, SteadySliding(ROAD, BELL, (speed, 0.0)), PRESSURE)
        return result.weight @ (-result.traction[0] * tread.position[0]) / result.load

    assert centre(1.0) > 0.01 * SIZE[0]
    assert centre(-1.0) == pytest.approx(-centre(1.0), rel=1e-6)


@pytest.mark.parametrize("mu", [0.8, 1.0, 1.2, 1.4])
def test_friction_that_moves_the_pressure_far_still_has_its_steady_state(tread, mu):
    """The energy along a step needs a law with potential, which friction has not."""
    result = slide_tread(tread, SteadySliding(ROAD, Coulomb(mu), (1.0, 0.0)), PRESSURE)
    assert result.solution.converged
    assert result.load == pytest.approx(PRESSURE * tread.block.area, rel=1e-7)
    assert result.braking_force == pytest.approx(mu * result.load, rel=1e-7)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_friction_that_tips_the_block_is_refused_with_the_shear_it_would_cause(tread):
    result = slide_tread(tread, SteadySliding(ROAD, Coulomb(3.0), (1.0, 0.0)), PRESSURE)
    strain = 3.0 * PRESSURE / (MODULUS / (2.0 * 1.49))
    sentence = rf"coefficient of 3 at 3e\+05 Pa would shear the block by {strain:.2g} of its height"
    with pytest.raises(ConvergenceError, match=sentence):
        result.solution.unwrap()


def test_the_tangent_of_steady_sliding_is_its_derivative():
    law = SteadySliding(ROAD, BELL, (0.3, -0.4))
    jump, empty, h = np.array([[3e-5, 8e-5], [0.0, 1e-5], [0.0, 0.0]]), np.empty((0, 2)), 1e-9
    response = law.respond(jump, empty)
    speed = np.linalg.norm(response.traction[1:], axis=0) / -response.traction[0]
    np.testing.assert_allclose(speed, BELL.coefficient(-response.traction[0], np.full(2, 0.5)))
    for k in range(3):
        move = np.zeros((3, 1))
        move[k] = h
        slope = law.respond(jump + move, empty).traction - law.respond(jump - move, empty).traction
        np.testing.assert_allclose(response.tangent[:, k], slope / (2.0 * h), rtol=1e-6, atol=1.0)


def test_the_resolvent_of_steady_sliding_lies_on_the_law_and_on_the_search_direction():
    law = SteadySliding(ROAD, BELL, (0.3, -0.4))
    jump = 1e-4 * np.random.default_rng(seed=3).uniform(-1.0, 1.0, (3, 20))
    state, k = np.empty((0, 20)), 1e10
    source = law.respond(jump, state).traction + k * jump
    np.testing.assert_allclose(law.resolvent(source, k, state), jump, atol=1e-13)
