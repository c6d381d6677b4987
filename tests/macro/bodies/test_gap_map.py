"""Initial gaps that vary over an interface."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.laws.interface_law import SideBySide, lay_side_by_side
from multiscale.macro import (
    AssembledNewton,
    Assembly,
    Body,
    GapMap,
    Interface,
    LatinMethod,
    solve_assembly,
)
from multiscale.macro.bodies.assembly import GROUND

EDGE = 0.02
NORMAL = Exponential(1e9, 0.5e-6)
LAW = Sliders(NORMAL, 0.3, pressures=(1e5, 1e9), slabs=8)
X, Y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-1e-3, EDGE + 1e-3, 23)] * 2))
SLOPE = 1e-4
TILTED = GapMap(np.column_stack([X, Y]), SLOPE * X)


def pressed(gap=None, law=LAW):
    """A stiff block on the ground, guided along z and pressed from above."""
    block = Body(
        box_mesh((EDGE,) * 3, (3, 3, 2)),
        Elastic(210e9, 0.3),
        supports={"left": (0.0, None, None), "front": (None, 0.0, None)},
        tractions={"top": (0.0, 0.0, -1.0)},
    )
    (first, face) = GROUND
    return Assembly((block,), (Interface((first, 0), (face, "bottom"), law, gap=gap),))


@pytest.mark.parametrize("method", [AssembledNewton(), LatinMethod((2, 1))])
def test_the_law_counts_from_the_gap_of_the_map(method):
    result = solve_assembly(pressed(TILTED), 10e6, method=method)
    assert result.converged.values.all()
    x = result.point_position.values[:, 0]
    pressure = -result.traction.values[0, :, 0]
    expected = NORMAL.pressure(result.jump.values[0, :, 0] + SLOPE * x)
    np.testing.assert_allclose(pressure, expected, rtol=1e-6)
    assert pressure @ result.point_area.values == pytest.approx(10e6 * EDGE**2)
    assert pressure[x < 1e-3].min() > 1.5 * pressure[x > EDGE - 1e-3].max()


def test_a_spaced_law_answers_as_the_law_at_the_opened_jump():
    spacing = np.array([0.0, 4e-7, -2e-7])
    law, jump = SideBySide([LAW], [slice(0, 3)], spacing), np.full((3, 3), 1e-7)
    opened = jump + np.stack([spacing, 0 * spacing, 0 * spacing])
    state = law.at_rest(jump)
    np.testing.assert_array_equal(state, LAW.at_rest(opened))
    moved = jump + 1e-7
    there, expected = law.respond(moved, state), LAW.respond(opened + 1e-7, state)
    np.testing.assert_array_equal(there.tangent, expected.tangent)
    response = law.resolvent(there.traction + 1e13 * moved, 1e13, state)
    np.testing.assert_allclose(response, moved, rtol=1e-9)


def test_parts_of_one_law_are_evaluated_together_as_separately():
    laws, counts = [LAW, LAW, NORMAL, replace(LAW, friction=0.1), LAW], [2, 3, 1, 1, 1]
    joined = lay_side_by_side(laws, counts, 1e-7 * np.arange(8.0))
    alone = [slice(0, 2), slice(2, 5), slice(5, 6), slice(6, 7), slice(7, 8)]
    apart = replace(joined, laws=laws, points=alone)
    assert joined.points == [slice(0, 5), *alone[2:]]
    jump = np.random.default_rng(seed=3).uniform(-3e-7, 3e-7, (3, 8))
    state = apart.at_rest(jump)
    np.testing.assert_array_equal(joined.at_rest(jump), state)
    for name in ("traction", "tangent", "state"):
        computed, expected = (getattr(law.respond(-jump, state), name) for law in (joined, apart))
        np.testing.assert_allclose(computed, expected, rtol=1e-12)
    computed, expected = (law.resolvent(-1e13 * jump, 1e13, state) for law in (joined, apart))
    np.testing.assert_allclose(computed, expected, rtol=1e-12)


def test_a_small_hole_of_the_map_is_bridged():
    small = np.where(np.hypot(X - 0.5 * EDGE, Y - 0.5 * EDGE) < 1.5e-3, np.nan, TILTED.gap)
    place = np.array([[0.5 * EDGE, 0.5 * EDGE, 0.0], [0.0, 0.0, 0.0], [EDGE, EDGE, 0.0]])
    np.testing.assert_allclose(replace(TILTED, gap=small).at(place), SLOPE * place[:, 0])
