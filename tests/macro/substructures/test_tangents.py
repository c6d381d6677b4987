"""Stiffness against small changes of loads: stuck, sliding, frictionless, half slipping."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, HystereticLaw, ModifiedLaw, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import AssembledNewton, Assembly, Body, Interface
from multiscale.macro.bodies import GapMap
from multiscale.macro.substructures import (
    LoadPath,
    changed_stiffness,
    condense_assembly,
    follow_cut_loads,
    follow_loads,
    joint_path,
    measure_loads,
)

EDGE, PRESSURE, DECAY, RATIO = 0.02, 10e6, 1e-7, 0.8
AREA = EDGE**2
NORMAL = Exponential(1e9, DECAY)
SPRINGS = RATIO * PRESSURE / DECAY * AREA
"""Tangential stiffness of the whole face while it sticks, kappa K A, N/m."""


def bed(friction, slabs=48):
    return Sliders(NORMAL, friction, RATIO, pressures=(1e5, 0.5 * PRESSURE), slabs=slabs)


def inside(low, high):
    """Facets of the bottom between two shares of its length."""
    return lambda x: (x[2] == 0.0) & (x[0] > low * EDGE) & (x[0] < high * EDGE)


HALVES = {"left part": inside(0.0, 0.5), "right part": inside(0.5, 1.0)}


def follow(laws, steps, parts=HALVES, gap=None, elements=2):
    """Press a block that is nearly rigid on parts of its bottom, and push it there."""
    mesh = box_mesh((EDGE, EDGE, EDGE), (elements, 1, 1)).with_boundaries(parts)
    tractions = {
        "top": (0.0, 0.0, lambda x, time: -1.0 * (time == 1.0)),
        "bottom": (lambda x, time: 1.0 * (time == 2.0), 0.0, 0.0),
    }
    block = Body(mesh, Elastic(1e19, 0.0), {}, tractions)
    faces = [
        Interface((None, 0), (None, name), law, gap=gap)
        for name, law in zip(parts, laws, strict=True)
    ]
    assembly = Assembly((block,), faces, times=(1.0, 2.0), areas=(AREA, AREA))
    path = LoadPath(("press", "push"), (AREA, AREA), tuple(steps))
    small = condense_assembly(assembly, AssembledNewton()).small
    result = follow_cut_loads(small, path, method=AssembledNewton(), extrapolate=True)
    assert result["converged"].values.all(), result.attrs
    return result


def test_first_order_changes_are_the_differences():
    """A block that tilts under an uneven pressure; both changes act on a half of it."""
    mesh = box_mesh((EDGE, EDGE, EDGE), (4, 2, 1)).with_boundaries(HALVES)
    tractions = {
        "top": (0.0, 0.0, lambda x, time: -(0.7 + 0.6 * x[0] / EDGE) * (time == 1.0)),
        "bottom": (lambda x, time: 1.0 * (time == 2.0), 0.0, 0.0),
    }
    block = Body(mesh, Elastic(1e13, 0.0), {}, tractions)
    laws, h = (bed(0.5), bed(0.5)), 1e-3
    faces = [
        Interface((None, 0), (None, name), law) for name, law in zip(HALVES, laws, strict=True)
    ]
    assembly = Assembly((block,), faces, times=(1.0, 2.0), areas=(AREA, AREA))
    small = condense_assembly(assembly, AssembledNewton()).small
    centre = float(NORMAL.gap_at(np.array(PRESSURE)))

    def press(problem):
        return follow_loads(problem, joint_path((PRESSURE,)), method=AssembledNewton())

    for change in ("factor", "shift"):
        changed = []
        for step in (h, -h):
            size = {"factor": 1.0 + step} if change == "factor" else {"shift": step * DECAY}
            normal = ModifiedLaw(NORMAL, centre=centre, **size)
            changed.append(small.with_laws([replace(laws[0], normal=normal), laws[1]]))
        first = changed_stiffness(press(small), [problem.law for problem in changed])
        solved = [measure_loads(press(problem)) for problem in changed]
        base = measure_loads(press(small))
        for name in ("joint_stiffness", "interface_stiffness", "tangential_stiffness"):
            apart = [float(result[name][0] / base[name][0]) for result in solved]
            rate = -float(np.diff(first[name][:, 0])[0]) / (2.0 * h)
            exact = (apart[0] - apart[1]) / (2.0 * h)
            assert rate == pytest.approx(exact, rel=1e-6, abs=1e-6), (name, rate, exact)


STATES = {
    # friction of both halves, push over pressure, stiffness over the stiffness of the stuck springs
    "stuck": (0.5, 0.5, 0.0, 1.0),
    "sliding": (0.1, 0.9, 0.2, 0.5),  # the left half slides, its springs hold no more
    "frictionless": (0.0, 0.9, 0.01, 0.5),
}


@pytest.mark.parametrize("state", STATES)
def test_a_small_rise_meets_the_springs_that_still_hold(state):
    left, right, push, share = STATES[state]
    # one slab: no point slips before all of it does
    result = follow([bed(left, 1), bed(right, 1)], [(PRESSURE, 0.0), (PRESSURE, push * PRESSURE)])
    stiffness = result["load_stiffness"].values[-1]
    np.testing.assert_allclose(stiffness[1], share * SPRINGS, rtol=1e-6)
    # normal springs in series with a rigid block
    np.testing.assert_allclose(stiffness[0], PRESSURE / DECAY * AREA, rtol=1e-6)
    np.testing.assert_allclose(result["interface_compliance"].values[-1], 1.0, rtol=1e-6)
    stuck = SPRINGS * (0.5 if state == "frictionless" else 1.0)
    np.testing.assert_allclose(result["stuck_stiffness"].values[-1, 1], stuck, rtol=1e-6)


def test_slip_is_a_share_of_the_force_and_of_the_area():
    result = follow([bed(0.1, 1), bed(0.9, 1)], [(PRESSURE, 0.0), (PRESSURE, 0.2 * PRESSURE)])
    end = result.isel(step=-1)
    # the right half has a third of its limit: of a bed of exponential springs, points slip
    # with a pressure above 2/3
    right = 1.0 - 2.0 / 3.0 * (1.0 + np.log(1.5))
    np.testing.assert_allclose(end["interface_slipping_load"], [1.0, right], rtol=1e-6)
    np.testing.assert_allclose(end["interface_slip"], [1.0, 0.0])
    np.testing.assert_allclose(end["slipping_load"], 0.5 * (1.0 + right), rtol=1e-6)
    np.testing.assert_allclose(end["slip_fraction"], 0.5)
    np.testing.assert_allclose(result["slipping_load"][0], 0.0, atol=1e-12)


def test_a_nearly_unloaded_point_is_open_and_does_not_slip():
    """The middle has a gap of ten decay lengths, and carries e^-10 of the pressure around it."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0.0, EDGE, 7), [0.0, EDGE]))
    middle = np.abs(x - 0.5 * EDGE) < 0.4 * EDGE
    gap = GapMap(np.column_stack([x, y]), 10.0 * DECAY * middle)
    steps = [(PRESSURE, 0.0), (PRESSURE, 0.1 * PRESSURE)]
    part = follow([bed(0.2)], steps, {"whole": inside(0.0, 1.0)}, gap, 6).isel(step=-1)
    place = part["point_position"].values[:, 0]
    middle = np.abs(place - 0.5 * EDGE) < 0.4 * EDGE
    pressure = -part["traction"].values[:, 0]
    assert 0.0 < pressure[middle].max() < 1e-4 * pressure.max()
    np.testing.assert_array_equal(part["contact_state"].values == 0, middle)
    whole = part["open_fraction"] + part["stick_fraction"] + part["slip_fraction"]
    np.testing.assert_allclose([part["open_fraction"], whole], [5.0 / 6.0, 1.0])


def test_a_small_rise_meets_half_a_bed_where_the_other_half_slips():
    # two slabs: the edge lies at half the pressure, so that half of the stiffness slips first
    log = np.log(2.0)
    sticking = 0.5 * PRESSURE  # K(b) of the slab that holds, times the decay length
    slips = PRESSURE - sticking - sticking * log  # load of the slab that slips
    friction, slip = 0.3, 0.8 * 0.3 * DECAY / RATIO
    push = friction * slips + RATIO * sticking / DECAY * slip
    result = follow([bed(friction, 2)] * 2, [(PRESSURE, 0.0), (PRESSURE, push)])
    np.testing.assert_allclose(result["load_stiffness"].values[0, 1], SPRINGS, rtol=1e-6)
    np.testing.assert_allclose(result["load_stiffness"].values[1, 1], 0.5 * SPRINGS, rtol=1e-6)
    np.testing.assert_allclose(result["stuck_stiffness"].values[1, 1], SPRINGS, rtol=1e-6)


def test_a_slipped_point_sticks_again_under_a_load_that_turns_back():
    result = follow(
        [bed(0.1, 1), bed(0.9, 1)],
        [(PRESSURE, 0.0), (PRESSURE, 0.2 * PRESSURE), (PRESSURE, 0.1 * PRESSURE)],
    )
    # the left half has slid forth, and has come back without slip
    np.testing.assert_allclose(
        result["load_stiffness"].values[:, 1], SPRINGS * np.array([1.0, 0.5, 1.0]), rtol=1e-6
    )


def test_a_frictionless_face_resists_no_push():
    result = follow([bed(0.0)] * 2, [(PRESSURE, 0.0)])
    assert result["load_stiffness"].values[0, 1] == 0.0
    assert result["interface_compliance"].values[0, 1] == 1.0
    np.testing.assert_allclose(
        result["load_stiffness"].values[0, 0], PRESSURE / DECAY * AREA, rtol=1e-6
    )


def test_metal_that_has_flowed_is_stiffer_against_a_load_that_rises_again():
    law = HystereticLaw(Exponential(1e9, DECAY), 3.0, 2.0)
    pair = [Sliders(law, 0.3, RATIO, pressures=(1e6, 1e8))] * 2
    result = follow(pair, [(PRESSURE, 0.0), (0.5 * PRESSURE, 0.0)])
    flows, again = result["load_stiffness"].values[:, 0] / AREA
    np.testing.assert_allclose(flows, PRESSURE / DECAY, rtol=1e-6)
    branch = law.branch(np.array(PRESSURE))
    expected = branch.stiffness(branch.gap_at(np.array(0.5 * PRESSURE)))
    np.testing.assert_allclose(again, expected, rtol=1e-6)
