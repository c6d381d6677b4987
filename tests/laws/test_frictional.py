"""Normal law with tangential stiffness and Coulomb friction."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.laws import Exponential, Frictional, RigidContact

LAW = Frictional(Exponential(1e9, 0.4e-6), 0.3, 0.8)


def states(seed=0, points=200):
    """Jumps and committed states, stuck and slipping."""
    random = np.random.default_rng(seed)
    jump = np.stack([random.uniform(0.2e-6, 2e-6, points), *random.normal(0, 3e-7, (2, points))])
    before = np.stack([*random.normal(0, 1e6, (2, points)), *random.normal(0, 1e-7, (2, points))])
    return jump, before


def test_the_tangent_is_the_derivative_of_the_traction():
    jump, state = states()
    response = LAW.respond(jump, state)
    for column in range(3):
        step = np.zeros((3, 1))
        step[column] = 1e-12
        rise = LAW.respond(jump + step, state).traction - LAW.respond(jump - step, state).traction
        scale = np.abs(response.tangent).max()
        np.testing.assert_allclose(response.tangent[:, column], rise / 2e-12, atol=1e-5 * scale)


def test_the_traction_never_exceeds_the_limit_and_slip_dissipates():
    jump, state = states()
    traction = LAW.respond(jump, state).traction
    limit = -0.3 * traction[0]
    size = np.hypot(*traction[1:])
    assert np.all(size <= limit * (1.0 + 1e-12))
    slips = size > 0.999999 * limit
    assert 20 < np.count_nonzero(slips) < 180
    k = 0.8 * LAW.normal.stiffness(jump[0])
    slip = jump[1:] - state[2:] - (traction[1:] - state[:2]) / k
    assert np.all(np.sum(slip * traction[1:], axis=0)[slips] >= 0.0)


@pytest.mark.parametrize(
    ("first", "second"), [(1e9, 0.5), (1e13, 0.5), (1e17, 0.5), (1e17, 1e-4), (1e13, 1e4)]
)
def test_the_resolvent_is_on_the_law_and_on_the_direction(first, second):
    jump, state = states(seed=1)
    stiffness = np.array([[first], [0.5 * first], [second * first]])
    source = LAW.respond(jump, state).traction + stiffness * jump
    found = LAW.resolvent(source, stiffness, state)
    traction = LAW.respond(found, state).traction
    scale = np.abs(source).max()
    np.testing.assert_allclose(traction + stiffness * found, source, atol=1e-10 * scale)


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


def test_without_friction_it_is_the_normal_law():
    jump, state = states()
    smooth = Frictional(LAW.normal, 0.0)
    np.testing.assert_array_equal(
        smooth.respond(jump, 0.0 * state).traction, LAW.normal.respond(jump, state[:0]).traction
    )


def test_a_cycle_of_slip_loses_its_work():
    """Slip back and forth over a long way: the loop is a rectangle."""
    state, jumps = (
        np.zeros((4, 1)),
        np.concatenate([np.linspace(0, 1e-4, 200), np.linspace(1e-4, 0, 200)]),
    )
    gap, pressure, work, last = 1e-6, LAW.normal.pressure(np.array([1e-6]))[0], 0.0, 0.0
    for x in jumps:
        response = LAW.respond(np.array([[gap], [x], [0.0]]), state)
        work += float(response.traction[1, 0]) * (x - last)
        state, last = response.state, x
    assert work == pytest.approx(2.0 * 0.3 * pressure * 1e-4, rel=2e-2)


@pytest.mark.parametrize(("friction", "ratio"), [(-0.1, 0.8), (np.nan, 0.8), (0.3, 0.0)])
def test_parameters_outside_their_range_are_refused(friction, ratio):
    with pytest.raises(CaseError, match="must"):
        Frictional(Exponential(1e9, 1e-6), friction, ratio)
