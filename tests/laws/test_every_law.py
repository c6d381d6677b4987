"""What every interface law must satisfy, whatever its formula."""

import numpy as np
import pytest

from multiscale.errors import CaseError, ConvergenceError
from multiscale.laws import (
    ConvexDecreasing,
    Exponential,
    InterfaceLaw,
    ModifiedLaw,
    PowerLaw,
    Response,
    Tabulated,
)

SIGNED = ConvexDecreasing(  # c < 0 in the middle: the curvature is a hat between ramps
    knot=np.array([-0.6, -0.2, 0.3, 0.9]), coefficient=np.array([0.4, 2.0, -1.5, 1.0]), gap=0.05
)
LAWS = [
    pytest.param(Exponential(pressure_scale=2.0, decay_length=0.4, gap=0.1), id="exponential"),
    pytest.param(
        ConvexDecreasing(knot=np.array([0.2, 0.7]), coefficient=np.array([3.0, 1.0])), id="convex"
    ),
    pytest.param(SIGNED, id="convex-signed"),
    pytest.param(ModifiedLaw(SIGNED, damage=0.3), id="damaged"),
    pytest.param(ModifiedLaw(Exponential(2.0, 0.4, gap=-0.1), factor=1.3), id="stretched"),
    pytest.param(PowerLaw(pressure_scale=2.0, support=0.9, exponent=2.5, gap=0.1), id="power"),
    pytest.param(Tabulated(np.array([0.0, 0.5, 2.5]), np.array([0.0, -0.5, -0.9])), id="table"),
]


@pytest.fixture
def jump():
    return np.random.default_rng(seed=7).uniform(-1.0, 1.0, size=(2, 4, 3))


@pytest.mark.parametrize("law", LAWS)
def test_tangent_is_the_derivative_of_the_traction(law, jump):
    state = np.zeros((law.n_state, 4, 3))
    tangent = law.respond(jump, state).tangent
    for j in range(jump.shape[0]):
        step = np.zeros_like(jump)
        step[j] = 1e-6
        difference = (
            law.respond(jump + step, state).traction - law.respond(jump - step, state).traction
        )
        np.testing.assert_allclose(tangent[:, j], difference / 2e-6, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("law", LAWS)
def test_no_tension_and_no_traction_along_the_interface(law, jump):
    traction = law.respond(jump, np.zeros((law.n_state, 4, 3))).traction
    assert np.all(traction[0] <= 0.0)
    assert np.all(traction[1:] == 0.0)


@pytest.mark.parametrize("law", LAWS)
def test_pressure_is_decreasing_and_convex(law):
    gap = np.linspace(-2.0, 2.0, 2001)
    p = law.pressure(gap)
    assert np.all(np.diff(p) <= 1e-14 * p[:-1])
    assert np.all(np.diff(p, 2) >= -1e-12 * p[:-2])
    assert np.all(np.diff(law.stiffness(gap)) <= 1e-12 * law.stiffness(gap)[0])


@pytest.mark.parametrize("law", LAWS)
def test_gap_at_inverts_the_pressure_over_twelve_decades(law):
    pressure = np.geomspace(1e-6, 1e6, 101)
    np.testing.assert_allclose(law.pressure(law.gap_at(pressure)), pressure, rtol=1e-9)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("stiffness", np.geomspace(1e-6, 1e6, 13))
def test_resolvent_lies_on_the_law_and_on_the_search_direction(law, stiffness, jump):
    state = np.zeros((law.n_state, 4, 3))
    source = law.respond(jump, state).traction + stiffness * jump
    found = law.resolvent(source, stiffness, state)
    traction = law.respond(found, state).traction
    scale = np.abs(traction) + stiffness * np.abs(found) + np.abs(source)
    assert np.all(np.abs(traction + stiffness * found - source) <= 1e-12 * scale)
    # the solution is the jump, as far as the data tell: a soft direction drowns in the traction
    tangent = law.respond(jump, state).tangent[0, 0] + stiffness
    spread = 1e-14 * scale[0] / tangent
    assert np.all(np.abs(found[0] - jump[0]) <= 1e-9 + 100.0 * spread)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("source", [-1e9, -1.0, -1e-9, 0.0, 1e-9, 1.0, 1e9])
@pytest.mark.parametrize("stiffness", [1e-9, 1.0, 1e9])
def test_resolvent_finds_its_way_from_any_source(law, source, stiffness):
    b = np.full((3, 1), source)
    found = law.resolvent(b, stiffness, np.zeros((0, 1)))
    t = law.respond(found, np.zeros((0, 1))).traction
    scale = np.abs(t) + np.abs(b) + stiffness * np.abs(found)
    assert np.all(np.abs(t + stiffness * found - b) <= 1e-9 * scale)
    np.testing.assert_allclose(found[1:], b[1:] / stiffness)


@pytest.mark.parametrize("source", [-1e-30, -1.0, 0.0, 1e-9])
def test_resolvent_pushes_surfaces_apart_that_start_deep_inside_each_other(source):
    law = Exponential(pressure_scale=1.0, decay_length=1e-3, gap=-0.1)
    found = law.resolvent(np.array([source, 0.0]), 1e-8, np.empty(0))
    t = law.respond(found, np.empty(0)).traction[0]
    assert found[0] > 0.09
    assert t + 1e-8 * found[0] == pytest.approx(source, rel=1e-9, abs=1e-17)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "shape", [(2,), (3,), (2, 5), (3, 4, 6), (2, 0)], ids=lambda shape: "x".join(map(str, shape))
)
def test_arrays_keep_their_shape_and_arguments_their_values(law, shape):
    jump = np.random.default_rng(seed=3).uniform(-0.5, 0.5, size=shape)
    before, state = jump.copy(), np.zeros((law.n_state, *shape[1:]))
    response = law.respond(jump, state)
    assert response.traction.shape == shape
    assert response.tangent.shape == (shape[0], *shape)
    assert response.state.shape == state.shape
    if jump.size:
        found = law.resolvent(response.traction + 2.0 * jump, np.full(shape, 2.0), state)
        np.testing.assert_allclose(found, jump, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(jump, before)


@pytest.mark.parametrize("length", [1e-9, 1e3], ids=["nm", "km"])
def test_resolvent_knows_no_absolute_scale(length):
    pressure = 1e9
    law = ConvexDecreasing(SIGNED.knot * length, SIGNED.coefficient * pressure / length**3)
    plain = ConvexDecreasing(SIGNED.knot, SIGNED.coefficient)
    source = np.array([[-0.7, -0.1, 0.2], [0.1, 0.0, 0.3]])
    expected = plain.resolvent(source, 0.5, np.empty((0, 3)))
    found = law.resolvent(source * pressure, 0.5 * pressure / length, np.empty((0, 3)))
    np.testing.assert_allclose(found / length, expected, rtol=1e-9)


class Repelling(InterfaceLaw):
    """Answers nonsense."""

    def respond(self, jump, state):
        return Response(np.full(jump.shape, np.nan), np.zeros((len(jump), *jump.shape)), state)


def test_resolvent_says_when_it_finds_nothing():
    with pytest.raises(ConvergenceError, match="resolvent of Repelling found no jump"):
        Repelling().resolvent(np.ones((2, 3)), 1.0, np.empty((0, 3)))


def test_resolvent_refuses_a_direction_that_is_not_stiff():
    with pytest.raises(ValueError, match="must be positive"):
        SIGNED.resolvent(np.ones((2, 3)), -1.0, np.empty((0, 3)))


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Exponential(-1.0, 1.0), r"pressure_scale must be positive and finite \(Pa\)"),
        (lambda: Exponential(1.0, 0.0), r"decay_length must be positive and finite \(m\), got 0"),
        (lambda: ModifiedLaw(SIGNED, 1.0), "from 0 to below 1, got 1; remove an interface"),
        (
            lambda: ModifiedLaw(SIGNED, factor=0.0),
            r"factor must be positive and finite \(1\), got 0",
        ),
        (lambda: PowerLaw(-1.0, 1.0, 2.0), r"pressure_scale must be positive and finite \(Pa\)"),
        (lambda: PowerLaw(1.0, 0.0, 2.0), r"support must be positive and finite \(m\), got 0"),
        (lambda: PowerLaw(1.0, 1.0, 0.9), "exponent must be at least 1"),
        (lambda: ConvexDecreasing(np.ones(2), np.ones(3)), "lists of one length"),
        (lambda: Tabulated(np.zeros(1), np.zeros(1)), "two points or more"),
        (lambda: Tabulated(np.array([1.0, 2.0]), np.array([0.0, -1.0])), "begin at the pressure"),
        (lambda: Tabulated(np.array([0.0, 2.0]), np.array([0.0, 1.0])), "point 0 to 1 of a table"),
        (lambda: Tabulated(np.arange(3.0), np.array([0.0, -1.0, -3.0])), "not convex at point 1"),
        (lambda: ConvexDecreasing(np.array([1.0, 1.0]), np.ones(2)), "must increase"),
        (lambda: ConvexDecreasing(np.array([1.0, 2.0]), np.array([np.nan, 1.0])), "be finite"),
        (lambda: ConvexDecreasing(np.array([1.0, 2.0]), np.array([-2.0, 1.0])), "below the first"),
        (lambda: ConvexDecreasing(np.array([1.0, 2.0]), np.array([1.0, 0.0])), "last knot must be"),
    ],
)
def test_parameters_out_of_range_are_refused_with_a_sentence(make, sentence):
    with pytest.raises(CaseError, match=sentence):
        make()


def test_a_law_that_is_not_convex_is_refused_although_it_decreases():
    """p'' = 6 (9 (1-g) - 3 (2-g) + (3-g)) is -6 at g = 1: decreasing nearby, not convex."""
    with pytest.raises(CaseError, match="not convex at the gap 1 m"):
        ConvexDecreasing(np.array([1.0, 2.0, 3.0]), np.array([9.0, -3.0, 1.0]))
