"""Plastic contact: loading leaves a mark, unloading and reloading are one curve, cycles cost."""

import numpy as np
import pytest
from scipy.integrate import quad

from multiscale.laws import Exponential, HystereticLaw, PowerLaw

LAWS = [
    pytest.param(HystereticLaw(Exponential(2.0, 0.4, gap=0.1), 2.5, 1.5), id="exponential"),
    pytest.param(HystereticLaw(PowerLaw(2.0, 0.9, 2.0), 1.0, 1.5), id="power"),
]


def walk(law, gaps, state=0.0):
    """Pressures along a path of gaps, and the state at its end."""
    state, pressures = np.full((1, 1), state), []
    for gap in gaps:
        response = law.respond(np.array([[gap - law.loading.gap], [0.0]]), state)
        state = response.state
        pressures.append(-response.traction[0, 0])
    return np.array(pressures), state


@pytest.mark.parametrize("law", LAWS)
def test_first_loading_is_the_loading_law(law):
    gaps = np.linspace(0.8, 0.1, 20)
    pressures, state = walk(law, gaps)
    np.testing.assert_allclose(pressures, law.loading.pressure(gaps), rtol=1e-12)
    assert state[0, 0] == pytest.approx(pressures[-1])


@pytest.mark.parametrize("law", LAWS)
def test_unloading_and_reloading_follow_one_curve_below_the_loading_curve(law):
    _, state = walk(law, [0.2])
    gaps = np.linspace(0.2, 0.8, 30)
    down, after = walk(law, gaps, state[0, 0])
    up, _ = walk(law, gaps[::-1], after[0, 0])
    np.testing.assert_allclose(down, up[::-1], atol=1e-12)
    assert np.all(down[1:] <= law.loading.pressure(gaps)[1:])
    again, _ = walk(law, [0.2, 0.15], state[0, 0])
    np.testing.assert_allclose(again, law.loading.pressure(np.array([0.2, 0.15])), rtol=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_stiffness_jumps_by_its_ratio_where_unloading_starts(law):
    peak = law.loading.pressure(np.array(0.2))
    branch = law.branch(peak)
    tangent = branch.respond(np.array([[0.2 - law.loading.gap], [0.0]]), np.zeros((0, 1))).tangent
    expected = law.stiffness_ratio * law.loading.stiffness(np.array(0.2))
    assert tangent[0, 0, 0] == pytest.approx(expected)


def test_a_cycle_costs_the_area_between_the_branches():
    """Exponential loading from far away to p_m stores p_m u_0; unloading returns p_m l / (n+1)."""
    law = HystereticLaw(Exponential(2.0, 0.4), 2.0, 1.5)
    peak = 1.0
    branch = law.branch(np.array(peak))
    assert float(branch.support) == pytest.approx(1.5 * 0.4 / 2.0)
    returned, _ = quad(
        lambda g: walk(law, [g], peak)[0][0], -float(branch.gap), -float(branch.gap) + 0.3
    )
    assert returned == pytest.approx(peak * 0.3 / 2.5, rel=1e-8)
    assert returned < peak * 0.4


@pytest.mark.parametrize("law", LAWS)
def test_recovery_inverts_the_unloading_branch(law):
    peak = np.array(1.2)
    pressure = np.linspace(0.0, 1.2, 13)
    branch = law.branch(peak)
    gap = law.loading.gap - branch.gap + law.recovery(pressure, peak)
    jump = np.vstack([gap - law.loading.gap, 0.0 * gap])
    computed = -branch.respond(jump, np.zeros((0, 13))).traction[0]
    np.testing.assert_allclose(computed, pressure, atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_a_shaken_down_law_is_the_unloading_branch_on_both_sides(law):
    """Power (1) of the branch below and above the largest pressure; virgin points are elastic."""
    random = np.random.default_rng(seed=7)
    peak = random.uniform(0.5, 1.5, 40) * (random.random(40) < 0.8)
    state, shaken = peak[None], law.shaken_down()
    jump = np.zeros((3, 40))
    jump[0] = law.loading.gap_at(np.where(peak > 0.0, peak, 1.0)) - law.loading.gap
    here = jump + np.array([[1.0], [0.0], [0.0]]) * random.uniform(-0.1, 0.05, 40)
    response = shaken.respond(here, state)
    branch = law.branch(np.where(peak > 0.0, peak, 1.0)).respond(here, state)
    first = law.loading.respond(here, state)
    expected = np.where(peak > 0.0, branch.traction, first.traction)
    np.testing.assert_allclose(response.traction, expected, rtol=1e-12)
    np.testing.assert_array_equal(response.state, state)
    step = np.array([[1e-7], [0.0], [0.0]]) * np.ones(40)
    slope = (
        shaken.respond(here + step, state).traction - shaken.respond(here - step, state).traction
    )
    np.testing.assert_allclose(response.tangent[0, 0], slope[0] / 2e-7, rtol=1e-5)
    source = response.traction + 2.0 * here
    np.testing.assert_allclose(shaken.resolvent(source, 2.0, state), here, atol=1e-8)
    beyond = (peak > 0.0) & (law.respond(here, state).state[0] > peak)
    assert beyond.any()  # where the law itself would load on
    assert np.all(first.traction[0, beyond] != response.traction[0, beyond])
