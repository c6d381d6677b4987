"""Bolts: tightened, then locked; their forces follow the load as forces of springs do."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq, fsolve

from multiscale.errors import CaseError
from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import (
    AssembledNewton,
    Assembly,
    Body,
    Bolt,
    BoltSection,
    Interface,
    LatinMethod,
    NewtonSchur,
    shank_stiffness,
    solve_assembly,
)
from multiscale.macro.substructures import (
    PreparedStructure,
    cut_assembly,
    follow,
    joint_path,
    load_joint,
)

EDGE, E = 0.02, 210e9
AREA = EDGE**2
NORMAL = Exponential(1e9, 0.2e-6)
LAW = Sliders(NORMAL, 0.3, pressures=(1e6, 1e8), slabs=8)
METHODS = [AssembledNewton(), LatinMethod((2, 1)), NewtonSchur((2, 1))]
SHANK, PRELOAD = shank_stiffness(8e-3, 2.0 * EDGE, E), 4e3  # N/m, N
BOLT = Bolt((1, 0), ("top", "bottom"), SHANK, PRELOAD)
GUIDED = {"front": (None, 0.0, None)}


def clamped(bolt=BOLT, law=LAW):
    """Two blocks, a bolt from the top face to the bottom face, and 1 Pa that parts them.

    Pins fix unloaded motions: the stress is even.
    """
    pins = {(0.0, 0.0, 0.0): (None, None, 0.0), (0.0, EDGE, 0.0): (None, None, 0.0)}
    pins |= {(EDGE, 0.0, 0.0): (None, None, 0.0)}
    along = {"left": (0.0, None, None)} | GUIDED
    lower = Body(
        box_mesh((EDGE,) * 3, (2, 2, 2), origin=(0.0, 0.0, -EDGE)),
        Elastic(E, 0.0),
        supports=along,
        tractions={"bottom": (0.0, 0.0, -1.0)},
    )
    upper = Body(
        box_mesh((EDGE,) * 3, (2, 2, 2)),
        Elastic(E, 0.0),
        supports=along,
        tractions={"top": (0.0, 0.0, 1.0)},
    )
    lower = replace(lower, pins=pins)
    return Assembly(
        (lower, upper), (Interface((0, 1), ("top", "bottom"), law),), bolts=(bolt,) if bolt else ()
    )


@pytest.mark.parametrize("method", METHODS)
def test_one_bolt_and_its_clamped_blocks_are_springs(method):
    """The blocks and the joint are in series, and the shank is parallel to them."""

    def apart(clamp):  # distance of the washers under a force on the joint
        return NORMAL.gap_at(np.array(clamp / AREA)) - clamp * 2.0 * EDGE / (E * AREA)

    def tension(pull):
        def left(logarithm):
            clamp = np.exp(logarithm)
            return clamp + pull - PRELOAD - SHANK * float(apart(clamp) - apart(PRELOAD))

        return np.exp(brentq(left, -600.0, np.log(10.0 * PRELOAD))) + pull

    pull = np.array([0.0, 0.5, 0.9, 2.0, -0.8]) * PRELOAD
    steps = np.stack([np.ones(5), pull / AREA], axis=1)
    result = solve_assembly(clamped(), steps, method=method)
    assert result.converged.values.all()
    expected = [tension(load) for load in pull]
    np.testing.assert_allclose(result.bolt_force[:, 0], expected, rtol=1e-6)
    joint = -result.traction.values[..., 0] @ result.point_area.values
    np.testing.assert_allclose(joint, expected - pull, rtol=1e-5, atol=1e-5 * PRELOAD)
    assert result.bolt_force[3] > 1.9 * PRELOAD  # beyond the preload the bolt carries all


CUT = BoltSection((0, 1), ("top", "bottom"), PRELOAD)


def column(ends, height=EDGE, origin=0.0):
    """A part of a column along z, with forces and supports of its ends."""
    mesh = box_mesh((EDGE, EDGE, height), (2, 2, round(2 * height / EDGE)), origin=(0, 0, origin))
    return Body(mesh, Elastic(E, 0.0), **ends)


def test_a_cut_through_a_bolt_bends_as_if_it_were_whole_and_stretches_only_by_its_force():
    clamp = {"supports": {"bottom": (0.0, 0.0, 0.0)}}
    push = {"tractions": {"top": (1e6, 0.0, 0.0)}}
    whole = solve_assembly(Assembly((column(clamp | push, 2.0 * EDGE),)), 1.0)
    upright = {"top": (None, None, 0.0)}
    guided = push | {"supports": upright}
    both = push | {"supports": clamp["supports"] | upright}
    with_guide = solve_assembly(Assembly((column(both, 2.0 * EDGE),)), 1.0)
    parts = column(clamp), column(guided, origin=EDGE)
    steps = np.array([[1.0, 0.0], [1.0, 1.0]])
    result = solve_assembly(Assembly(parts, sections=(CUT,)), steps)
    u = result["displacement"].values
    stretch = PRELOAD * EDGE / (E * AREA)  # of each part, towards each other
    faces = [body.nodes(name) for body, name in zip(parts, ("top", "bottom"), strict=True)]
    faces[1] = faces[1] + parts[0].basis.N
    np.testing.assert_allclose(u[0, faces[0], 2], stretch, rtol=1e-9)
    np.testing.assert_allclose(u[0, faces[1], 2], -stretch, rtol=1e-9)
    tip = [item["displacement"].values[-1, -1, 0] for item in (whole, with_guide)]
    bent = (u[1] - u[0])[-1, 0]
    assert bent == pytest.approx(tip[1], rel=1e-9)
    assert abs(bent - tip[0]) > 0.1 * bent  # the guide holds the end upright


def test_a_path_without_bolts_goes_on_by_any_method_of_the_same_cut():
    problem = cut_assembly(replace(clamped(), bolts=()))
    begun, once = (
        follow(PreparedStructure(problem, AssembledNewton()), path)
        for path in ([-1e6, -2e6], [-1e6, -2e6, -3e6])
    )
    for method in (AssembledNewton(), NewtonSchur()):
        path = follow(PreparedStructure(problem, method), [-3e6], after=begun.end)
        expected = once.result.jump[-1:]
        atol = 1e-9 * float(abs(expected).max())
        np.testing.assert_allclose(path.result.jump, expected, atol=atol)
    other = PreparedStructure(cut_assembly(sheared()), AssembledNewton())
    with pytest.raises(CaseError, match="points of joints, where the structure has"):
        follow(other, [[1.0, 0.0]], after=begun.end)


@pytest.mark.parametrize("method", METHODS)
def test_a_state_goes_from_path_to_path_whatever_changes_first(method):
    steps = np.array([[1.0, 0.0], [1.0, 2e6], [1.3, 2e6], [1.3, -1e6], [1.3, 1e6]])  # 1, Pa
    prepared = PreparedStructure(cut_assembly(sheared(), method.parts), method)
    once = follow(prepared, steps)
    for cut in (2, 3):  # the next step tightens, or shears
        begun = follow(prepared, steps[:cut])
        path = follow(prepared, steps[cut:], after=begun.end)
        for name in ("displacement", "traction", "bolt_force"):
            expected = once.result[name].values
            atol = 1e-6 * float(np.abs(expected).max())
            np.testing.assert_allclose(path.result[name], expected[cut:], atol=atol, err_msg=name)
        np.testing.assert_allclose(path.slipping, once.slipping[cut:], atol=1e-5)
        size = float(once.dissipated.max())
        np.testing.assert_allclose(path.dissipated, once.dissipated[cut:], atol=1e-4 * size)


def with_clamp(mesh):
    """Name the upper half of the left face, which keeps clear of the washers."""
    return mesh.with_boundaries({"clamp": lambda x: (x[0] == 0.0) & (x[2] > -0.5 * EDGE)})


def sheared(bolt=BOLT):
    """A block clamped at a side, a block that is bolted on it and pulled along."""
    lower = Body(
        with_clamp(box_mesh((EDGE,) * 3, (2, 2, 2), origin=(0.0, 0.0, -EDGE))),
        Elastic(E, 0.3),
        supports={"clamp": (0.0, 0.0, 0.0)},
    )
    upper = Body(
        box_mesh((EDGE,) * 3, (2, 2, 1)),
        Elastic(E, 0.3),
        supports=GUIDED,
        tractions={"right": (1.0, 0.0, 0.0)},
    )
    interface = Interface((0, 1), ("top", "bottom"), LAW)
    return Assembly((lower, upper), (interface,), areas=(AREA, AREA), bolts=(bolt,))


def test_a_cycle_of_shear_dissipates_energy_and_locked_bolts_follow_it():
    assembly = sheared(replace(BOLT, preload=AREA))  # 1 Pa under the washers
    loading = joint_path((5e6, 10e6), shear=1.5e6, cycles=1, steps=4)
    first, other = (
        load_joint(assembly, loading, method=method)
        for method in (AssembledNewton(), LatinMethod())
    )
    assert first.converged.values.all()
    assert first.cycle_energy.item() > 0.0
    np.testing.assert_allclose(first.bolt_force[:2, 0], [5e6 * AREA, 10e6 * AREA], rtol=1e-12)
    assert np.ptp(first.bolt_force.values[2:]) > 1e-3 * 10e6 * AREA  # the upper block tips a little
    names = ("bolt_force", "cycle_energy", "approach", "joint_stiffness", "tangential_stiffness")
    for name in names:
        np.testing.assert_allclose(first[name], other[name], rtol=1e-5, err_msg=name)
    assert (first.tangential_stiffness[:2] > 0.0).all()


def test_a_bolt_without_tension_ends_the_path():
    steps = np.array([[1.0, 0.0], [1.0, -10e6], [1.0, -1e9], [1.0, 0.0]])
    result = solve_assembly(clamped(), steps)
    np.testing.assert_array_equal(result.converged, [1, 1, 0, 0])
    assert result.attrs["failure"].startswith(
        "the steps end before step 2: the force of the bolt from"
    )
    assert np.isnan(result.bolt_force[2:]).all()
    assert np.isnan(result.displacement[2:]).all()


def test_a_load_that_parts_what_bolts_clamp_is_refused_with_all_forces():
    assembly = clamped()
    lower, upper = assembly.bodies
    upper = replace(upper, supports={}, tractions={"top": (0.01, 0.0, 1.0)})
    loose = replace(assembly, bodies=(lower, upper))
    pull = np.array([[1.0, 0.0], [1.0, 20.0 * PRELOAD / AREA]])
    result = solve_assembly(loose, pull)
    assert result.converged.values.tolist() == [1, 0]
    sentence = "the load opens the clamped faces: it is .* kN along x, y and z, and the "
    assert re.search(sentence + "bolts carry 4 kN at the step before", result.attrs["failure"])


def test_three_bolts_share_a_load_as_springs():
    """Blocks a thousand times as stiff as steel on a soft joint: a rigid body on springs."""
    law, length, stiff = Exponential(1e8, 5e-6), 6 * EDGE, Elastic(1e3 * E, 0.0)
    spots = [f"bolt {i}" for i in range(3)]

    def drilled(mesh, height):
        on = {
            name: lambda x, i=i: (
                np.isclose(x[2], height) & (abs(x[0] - (1 + 2 * i) * EDGE) < 0.5 * EDGE)
            )
            for i, name in enumerate(spots)
        }
        return mesh.with_boundaries(on)

    sizes = (length, EDGE, EDGE), (12, 2, 2)
    lower = drilled(box_mesh(*sizes, origin=(0.0, 0.0, -EDGE)), -EDGE)
    upper = drilled(box_mesh(*sizes), EDGE)
    body = Body(with_clamp(lower), stiff, supports={"clamp": (0.0, 0.0, 0.0)})
    pulled = Body(
        upper,
        stiff,
        supports=GUIDED,
        pins={(0.0, 0.0, 0.0): (0.0, 0.0, None)},
        tractions={"right": (0.0, 0.0, 1.0)},
    )
    k = np.array([200e6, 400e6, 300e6])  # N/m
    bolts = [Bolt((0, 1), (name, name), item, 2e3) for name, item in zip(spots, k, strict=True)]
    assembly = Assembly(
        (body, pulled), (Interface((0, 1), ("top", "bottom"), law),), bolts=tuple(bolts)
    )
    steps = np.array([[1.0, 0.0], [1.0, 1e3 / AREA], [1.0, 2e3 / AREA]])
    result = solve_assembly(assembly, steps)
    assert result.converged.values.all()

    x, w = result.point_position.values[:, 0], result.point_area.values
    at = EDGE * np.array([1.0, 3.0, 5.0])

    def forces(motion, tension, load):  # resultant and moment on the upper block, motion in um
        p = law.pressure(1e-6 * (motion[0] + motion[1] * x / length))
        lift = p @ w - tension.sum() + load
        return lift, (p * w @ x - tension @ at + load * length) / length

    def moved(motion):
        return 1e-6 * (motion[0] + motion[1] * at / length)

    start = fsolve(lambda m: forces(m, np.full(3, 2e3), 0.0), (20.0, 0.0))
    motion = start
    for step, load in ((1, 1e3), (2, 2e3)):
        motion = fsolve(
            lambda m, load=load: forces(m, 2e3 + k * (moved(m) - moved(start)), load), motion + 1.0
        )
        change = k * (moved(motion) - moved(start))
        assert change[2] > 0.3 * load  # the load is at the end
        np.testing.assert_allclose(result.bolt_force[step] - 2e3, change, rtol=0.01)
