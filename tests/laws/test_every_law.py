"""Properties of every interface law, whatever its formula: a further law is a row of LAWS."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from multiscale.laws import (
    AsperityLaw,
    ConvexDecreasing,
    Coulomb,
    Dilatant,
    Exponential,
    HystereticLaw,
    InterfaceLaw,
    ModifiedLaw,
    PowerLaw,
    Response,
    SteadySliding,
    Tabulated,
)
from multiscale.laws.interface_law import lay_side_by_side
from tests.laws.test_asperities import FRICTION, ROUGH, random_path
from tests.laws.test_sliders import NORMALS, bed, walked

SIGNED = ConvexDecreasing(  # c < 0 in the middle: the curvature is a hat between ramps
    knot=np.array([-0.6, -0.2, 0.3, 0.9]), coefficient=np.array([0.4, 2.0, -1.5, 1.0]), gap=0.05
)
NORMAL_LAWS = {
    "exponential": Exponential(pressure_scale=2.0, decay_length=0.4, gap=0.1),
    "dilatant": Dilatant(pressure_scale=0.5, solid_height=0.4, least_dilation=0.5),
    "convex": ConvexDecreasing(knot=np.array([0.2, 0.7]), coefficient=np.array([3.0, 1.0])),
    "convex-signed": SIGNED,
    "damaged": ModifiedLaw(SIGNED, damage=0.3),
    "stretched": ModifiedLaw(Exponential(2.0, 0.4, gap=-0.1), factor=1.3),
    "power": PowerLaw(pressure_scale=2.0, support=0.9, exponent=2.5, gap=0.1),
    "table": Tabulated(np.array([0.0, 0.5, 2.5]), np.array([0.0, -0.5, -0.9])),
}
normal_laws = pytest.mark.parametrize("law", NORMAL_LAWS.values(), ids=NORMAL_LAWS)
PLASTIC = {
    "hysteretic": HystereticLaw(Exponential(2.0, 0.4, gap=0.1), 2.5, 1.5),
    "hysteretic, power": HystereticLaw(PowerLaw(2.0, 0.9, 2.0), 1.0, 1.5),
}


@dataclass(frozen=True)
class Place:
    """A law, jumps and a committed state, and the sizes with which it is tested.

    ``step`` of differences, ``rtol`` of the tangent, ``k`` that is a stiffness of the law, and the
    number of points that may lie at a corner.
    """

    law: InterfaceLaw
    jump: np.ndarray
    state: np.ndarray
    step: float = 1e-6
    rtol: float = 1e-6
    k: float = 1.0
    corners: int = 0


def places():
    """A place of every law."""
    rng = np.random.default_rng(seed=7)
    for name, law in NORMAL_LAWS.items():
        yield name, Place(law, rng.uniform(-1.0, 1.0, (3, 12)), np.zeros((0, 12)))
    for name, law in PLASTIC.items():
        state = rng.uniform(0.0, 2.0, (1, 60)) * (rng.random(60) < 0.8)
        yield name, Place(law, rng.uniform(-0.2, 0.7, (3, 60)), state, 1e-7, 1e-5)
    sliding = SteadySliding(SIGNED, Coulomb(0.3), velocity=(2.0, -1.0))
    yield "steady sliding", Place(sliding, rng.uniform(-1.0, 0.8, (3, 12)), np.zeros((0, 12)))
    for name, normal in NORMALS.items():
        for slabs in (1, 24):
            law = bed(normal, slabs)
            place = Place(law, *walked(law, seed=3), 1e-13, 1e-4, 1e13, corners=2)
            yield f"sliders, {name}, {slabs}", place
    for yields in (True, False):
        *_, (law, jump, state) = random_path(yields, steps=6)
        yield f"asperities, {yields}", Place(law, jump, state, 1e-13, 1e-4, 1e12)
    smooth = Place(replace(law, friction=0.0), jump, state, 1e-13, 1e-4, 1e12)
    yield "asperities without friction", smooth
    law, other = bed(slabs=5), AsperityLaw(ROUGH, FRICTION)
    together = lay_side_by_side([law, other], [200, 20], np.zeros(220))
    *_, (_, jump, state) = random_path(True, steps=6)
    rows = np.zeros((together.n_state, 220))
    rows[: law.n_state, :200], rows[: other.n_state, 200:] = walked(law, seed=3)[1], state
    jump = np.concatenate([walked(law, seed=3)[0], jump], axis=1)
    yield "side by side", Place(together, jump, rows, 1e-13, 1e-4, 1e13, corners=2)


PLACES = dict(places())
POINTWISE = list(PLACES.values())[:-1]  # laws side by side have so many points
every_law = pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)


@every_law
def test_the_tangent_is_the_derivative_of_the_traction(place):
    tangent = place.law.respond(place.jump, place.state).tangent
    difference = np.empty_like(tangent)
    for column in range(3):
        step = place.step * np.eye(3)[:, column, None]
        ends = [place.law.respond(place.jump + s * step, place.state).traction for s in (1, -1)]
        difference[:, column] = (ends[0] - ends[1]) / (2.0 * place.step)
    scale = np.maximum(np.abs(tangent).max(axis=(0, 1)), 1e-2 * place.k)
    wrong = np.abs(tangent - difference).max(axis=(0, 1)) > place.rtol * scale
    assert np.count_nonzero(wrong) <= place.corners


@every_law
@pytest.mark.parametrize("softer", [1e-7, 1e-3, 1.0, 1e5])
@pytest.mark.parametrize("ratio", [1.0, 1e-6, 1e4])
def test_the_resolvent_is_on_the_law_and_on_the_direction(place, softer, ratio):
    k = softer * place.k * np.array([[1.0], [0.5], [ratio]])
    source = place.law.respond(place.jump, place.state).traction + k * place.jump
    response = place.law.resolvent(source, k * np.ones_like(source), place.state)
    traction = place.law.respond(response, place.state).traction
    scale = np.abs(traction) + k * np.abs(response) + np.abs(source)
    scale = np.maximum(scale, scale.max(axis=1, keepdims=True) * (place.law.n_state > 0))
    least = 1e-10 if place.law.n_state else 1e-12
    assert np.all(np.abs(traction + k * response - source) <= least * scale)


@pytest.mark.parametrize("place", POINTWISE, ids=list(PLACES)[:-1])
@pytest.mark.parametrize("shape", [(), (5,), (2, 3), (0,)], ids=str)
def test_arrays_keep_their_shape_and_arguments_their_values(place, shape):
    count = int(np.prod(shape))
    jump, state = (
        np.ascontiguousarray(value[:, :count]).reshape(len(value), *shape)
        for value in (place.jump, place.state)
    )
    before = jump.copy(), state.copy()
    response = place.law.respond(jump, state)
    assert response.traction.shape == jump.shape
    assert response.tangent.shape == (3, *jump.shape)
    assert response.state.shape == state.shape
    assert place.law.sliding(jump, state).stored.shape == shape
    assert place.law.at_rest(jump).shape == (place.law.n_state, *shape)
    k = np.full(jump.shape, 10.0 * place.k)
    answer = place.law.resolvent(response.traction + k * jump, k, state)
    np.testing.assert_allclose(answer, jump, rtol=1e-6, atol=1e-9 * np.abs(place.jump).max())
    np.testing.assert_array_equal(jump, before[0])
    np.testing.assert_array_equal(state, before[1])


@normal_laws
def test_no_tension_and_no_traction_along_the_interface(law):
    jump = np.random.default_rng(seed=7).uniform(-1.0, 1.0, size=(2, 4, 3))
    traction = law.respond(jump, np.zeros((law.n_state, 4, 3))).traction
    assert np.all(traction[0] <= 0.0)
    assert np.all(traction[1:] == 0.0)


@normal_laws
def test_pressure_is_decreasing_and_convex(law):
    gap = np.linspace(-2.0, 2.0, 2001)
    p = law.pressure(gap)
    assert np.all(np.diff(p) <= 1e-14 * p[:-1])
    assert np.all(np.diff(p, 2) >= -1e-12 * p[:-2])
    assert np.all(np.diff(law.stiffness(gap)) <= 1e-12 * law.stiffness(gap)[0])


@normal_laws
def test_gap_at_inverts_the_pressure_over_twelve_decades(law):
    pressure = np.geomspace(1e-6, 1e6, 101)
    np.testing.assert_allclose(law.pressure(law.gap_at(pressure)), pressure, rtol=1e-9)


@normal_laws
def test_the_gap_at_zero_pressure_bears_nothing(law):
    gap = law.gap_at(np.array([0.0, 1.0]))
    assert gap[0] > gap[1]
    assert law.pressure(gap)[0] == 0.0


@normal_laws
@pytest.mark.parametrize("source", [-1e9, -1.0, -1e-9, 0.0, 1e-9, 1.0, 1e9])
@pytest.mark.parametrize("stiffness", [1e-9, 1.0, 1e9])
def test_resolvent_finds_its_way_from_any_source(law, source, stiffness):
    b = np.full((3, 1), source)
    response = law.resolvent(b, stiffness, np.zeros((0, 1)))
    t = law.respond(response, np.zeros((0, 1))).traction
    scale = np.abs(t) + np.abs(b) + stiffness * np.abs(response)
    assert np.all(np.abs(t + stiffness * response - b) <= 1e-9 * scale)
    np.testing.assert_allclose(response[1:], b[1:] / stiffness)


@pytest.mark.parametrize("source", [-1e-30, -1.0, 0.0, 1e-9])
def test_resolvent_pushes_surfaces_apart_that_start_deep_inside_each_other(source):
    law = Exponential(pressure_scale=1.0, decay_length=1e-3, gap=-0.1)
    response = law.resolvent(np.array([source, 0.0]), 1e-8, np.empty(0))
    t = law.respond(response, np.empty(0)).traction[0]
    assert response[0] > 0.09
    assert t + 1e-8 * response[0] == pytest.approx(source, rel=1e-9, abs=1e-17)


@pytest.mark.parametrize("length", [1e-9, 1e3], ids=["nm", "km"])
def test_resolvent_has_no_absolute_scale(length):
    pressure = 1e9
    law = ConvexDecreasing(SIGNED.knot * length, SIGNED.coefficient * pressure / length**3)
    plain = ConvexDecreasing(SIGNED.knot, SIGNED.coefficient)
    source = np.array([[-0.7, -0.1, 0.2], [0.1, 0.0, 0.3]])
    expected = plain.resolvent(source, 0.5, np.empty((0, 3)))
    response = law.resolvent(source * pressure, 0.5 * pressure / length, np.empty((0, 3)))
    np.testing.assert_allclose(response / length, expected, rtol=1e-9)


class Repelling(InterfaceLaw):
    """Answers nonsense."""

    def respond(self, jump, state):
        return Response(np.full(jump.shape, np.nan), np.zeros((len(jump), *jump.shape)), state)
