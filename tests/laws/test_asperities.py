"""Asperities: Hertz, Greenwood and Williamson, yield with memory, and a slider for every height."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.laws import Asperities, AsperityLaw
from multiscale.laws.asperities import class_densities, gaussian_asperities

STEEL = {"radius": 1.36e-3, "youngs_modulus": 192.31e9, "poissons_ratio": 0.3}
YIELD = {"yield_stress": 331.7e6, "tangent_modulus": 620e6}
ONE = Asperities(np.zeros(1), np.array([1e6]), **STEEL, **YIELD)
ROUGH = Asperities(*gaussian_asperities(2e-6, 1e6, 21), **STEEL, **YIELD)
FRICTION = 0.2


def press(law, approach, state=None):
    """Pressure, normal stiffness and new state at approaches of the plane z = 0, m."""
    jump = np.zeros((3, np.size(approach)))
    jump[0] = -np.ravel(approach)
    state = np.zeros((law.n_state, jump.shape[1])) if state is None else state
    response = law.respond(jump, state)
    return -response.traction[0], response.tangent[0, 0], response.state


def test_elastic_asperities_of_exponential_heights_carry_the_closed_form():
    """eta E* sqrt(pi R) s^1.5 exp(-g/s), by the integral of Greenwood and Williamson."""
    s, density = 1e-6, 1e9
    z = np.linspace(0.0, 30.0 * s, 6001)
    law = Asperities(*class_densities(z, np.exp(-z / s), density, 6001), **STEEL)
    gap = np.array([0.0, 1e-6, 3e-6])
    expected = density * law.contact_modulus * np.sqrt(np.pi * law.radius) * s**1.5
    p, K, _ = press(AsperityLaw(law), -gap)
    np.testing.assert_allclose(p, expected * np.exp(-gap / s), rtol=2e-5)
    np.testing.assert_allclose(K, p / s, rtol=1e-4)


def test_an_asperity_follows_hertz_until_it_yields_and_then_carries_less():
    law, yields = AsperityLaw(ONE), 1.9 * ONE.yield_approach
    d = yields * np.array([0.1, 0.5, 1.0, 3.0, 30.0])
    hertz = 1e6 * 4.0 / 3.0 * ONE.contact_modulus * np.sqrt(ONE.radius) * d**1.5
    ratio = press(law, d)[0] / hertz
    np.testing.assert_allclose(ratio[:3], 1.0, rtol=1e-12)
    assert 1.0 > ratio[3] > ratio[4] > 0.3


def test_the_plastic_force_equals_the_reference_implementation():
    """At 2, 10 and 100 times the approach at yield, by tmdsimpy 17d5fc3 for Re = 1.36493 mm."""
    changed = replace(ONE, radius=1.36493e-3)
    times = np.array([2.0053, 10.0, 100.0])
    np.testing.assert_allclose(
        changed.ratio(times * changed.yield_approach), [1.0, 0.820394047, 0.470356522], atol=2e-5
    )


def test_unloading_starts_at_the_load_is_reversible_and_leaves_a_dent():
    law, d = AsperityLaw(ONE), 30.0 * ONE.yield_approach
    p, _, state = press(law, d)
    again, K, same = press(law, d, state)
    assert again == pytest.approx(p)
    np.testing.assert_array_equal(same, state)
    # at the corner the curve is as stiff as the elastic sphere, 2 E* sqrt(R d)
    assert float(K[0]) == pytest.approx(2e6 * ONE.contact_modulus * np.sqrt(ONE.radius * d))
    dent = d * (1.0 - float(ONE.ratio(np.array(d))))
    assert press(law, 0.999 * dent, state)[0] == 0.0
    assert press(law, 1.001 * dent, state)[0] > 0.0


def test_shaken_down_the_stiffness_is_the_same_on_both_sides_of_the_preload():
    law = AsperityLaw(ROUGH, FRICTION)
    jump = np.array([[-9e-6], [0.0], [0.0]])
    state = law.at_rest(jump)
    frozen, step = law.shaken_down(), np.array([[1e-12], [0.0], [0.0]])
    p, K = -law.respond(jump, state).traction[0, 0], law.respond(jump, state).tangent[0, 0]
    back, forth = (
        -single_law.respond(jump - step, state).traction[0, 0] for single_law in (law, frozen)
    )
    assert (forth - p) / 1e-12 == pytest.approx(float(K[0]), rel=1e-5)
    assert (back - p) / 1e-12 < 0.9 * K[0]  # the flowing law is softer
    np.testing.assert_array_equal(frozen.respond(jump - step, state).state[0], state[0])


def test_stiffness_without_slip_is_mindlins_and_full_slip_is_coulombs():
    law = AsperityLaw(ROUGH, FRICTION)
    jump = np.array([[-9e-6, -5e-6], [0.0, 0.0], [0.0, 0.0]])
    state = law.at_rest(jump)
    tangent = law.respond(jump, state).tangent
    kappa = 2.0 * 0.7 / 1.7
    np.testing.assert_allclose(tangent[1, 1], kappa * tangent[0, 0], rtol=1e-12)
    slid = jump + np.array([[0.0], [6e-5], [8e-5]])
    response = law.respond(slid, state)
    p = -response.traction[0]
    np.testing.assert_allclose(response.traction[1:], FRICTION * p * np.array([[0.6], [0.8]]))
    np.testing.assert_allclose(law.slipping_load(slid, state), 1.0)
    np.testing.assert_array_equal(law.slipping_load(jump, state), 0.0)
    np.testing.assert_array_equal(
        law.respond(slid, law.unsheared(response.state)).traction[1:], np.zeros((2, 2))
    )


def random_path(yields, steps=60, points=20):
    """Law, and states and jumps of random steps that open, press, yield and slide."""
    law, rng = AsperityLaw(ROUGH, FRICTION, yields=yields), np.random.default_rng(seed=3)
    jump = np.zeros((3, points))
    jump[0] = -4e-6
    state = AsperityLaw(ROUGH, FRICTION).at_rest(jump)
    for _ in range(steps):
        jump = np.array([[-4e-6], [0.0], [0.0]]) + rng.normal(size=(3, points)) * [
            [3e-6],
            [4e-7],
            [4e-7],
        ]
        yield law, jump, state
        state = law.respond(jump, state).state


@pytest.mark.parametrize("yields", [True, False])
def test_no_step_of_a_random_path_gains_energy(yields):
    lost, most = [], 0.0
    for law, jump, state in random_path(yields):
        account = law.sliding(jump, state)
        lost.append(account.dissipated)
        most = max(most, account.stored.max())
    assert np.min(lost) >= -1e-12 * most
    assert np.max(lost) > 0.0


def test_unloading_follows_flattened_spheres_of_their_larger_radii():
    law, deepest = AsperityLaw(ROUGH), 9e-6
    _, _, state = press(law, deepest)
    most = np.maximum(ROUGH.height + deepest, 0.0)
    ratio = ROUGH.ratio(np.where(most > 0.0, most, 1e-30))
    hertz = 4.0 / 3.0 * ROUGH.contact_modulus * np.sqrt(ROUGH.radius / ratio)
    for approach in (9.3e-6, 9e-6, 8e-6):
        p, K, _ = press(law.shaken_down(), approach, state)
        each = np.maximum(ROUGH.height - most * (1.0 - ratio) + approach, 0.0)
        assert p[0] == pytest.approx(np.sum(ROUGH.density * hertz * each**1.5))
        assert K[0] == pytest.approx(np.sum(ROUGH.density * 1.5 * hertz * np.sqrt(each)))
