"""One assembly, three methods: the same answer, the same refusals."""

import numpy as np
import pytest
from skfem import ElementHex2

from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import (
    AssembledNewton,
    Block,
    Body,
    LatinMethod,
    MultigridNewton,
    NewtonSchur,
    solve_assembly,
)
from multiscale.macro.bodies import stacked_blocks
from multiscale.macro.joint import TreadBlock
from multiscale.macro.joint.tread import sliding_block
from multiscale.macro.substructures import cut_assembly
from tests.pressed_joint import ElementJoint, press_blocks, pressed_blocks

STEEL, EDGE = Elastic(210e9, 0.3), 0.02
STEPS = np.array([[20e6, 0.0], [20e6, 1.4e6], [20e6, 2.8e6], [20e6, -1.4e6]])  # Pa
JOINT_LAW = Exponential(4e9, 0.72e-6)
BODY = Body(box_mesh((EDGE,) * 3, (1, 1, 1)), STEEL)
METHODS = [
    pytest.param(LatinMethod(parts=(2, 1)), id="LATIN"),
    pytest.param(NewtonSchur(parts=(2, 1)), id="Newton-Schur"),
    pytest.param(AssembledNewton(parts=(2, 1)), id="assembled, cut"),
    pytest.param(MultigridNewton(), id="multigrid"),
]


def blocks():
    """Three blocks with two laws of different friction, one of many slabs."""
    laws = [
        Sliders(Exponential(1e9, decay), mu, pressures=(1e6, 1e8), slabs=slabs)
        for decay, mu, slabs in ((0.4e-6, 0.25, 8), (0.2e-6, 0.3, 16))
    ]
    return stacked_blocks((EDGE, EDGE, 0.5 * EDGE), (2, 2, 2), [STEEL] * 3, laws)


@pytest.fixture(scope="module")
def whole():
    return solve_assembly(blocks(), STEPS)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_same_path(method, whole):
    result = solve_assembly(blocks(), STEPS, method=method)
    assert result.converged.values.all()
    assert set(whole) <= set(result)
    size = float(abs(whole.displacement).max())
    np.testing.assert_allclose(result.displacement, whole.displacement, atol=1e-6 * size)
    place = ("point_joint", "point_position")
    orders = [
        np.lexsort(np.column_stack([item[name].values for name in place]).round(9).T)
        for item in (result, whole)
    ]
    for name in ("traction", "jump"):
        mine, theirs = (
            item[name].values[:, order] for item, order in zip((result, whole), orders, strict=True)
        )
        np.testing.assert_allclose(mine, theirs, atol=1e-6 * np.abs(theirs).max(), err_msg=name)


# --- rigid plates, the ground, single nodes and elements of second order ----------------------


def tilting(law=JOINT_LAW, **options):
    """Unlike blocks pressed by a force off their middle, so that the platen tilts."""
    lower, upper = Block(0.01, 70e9, 0.33), Block(0.02, 210e9, 0.3)
    mesh = {"elements": (4, 2), "layers": (1, 1)} | options
    joint = ElementJoint((0.05, 0.04), lower, upper, **mesh, eccentricity=(0.012, 0.006))
    return joint, pressed_blocks(joint, law)


@pytest.mark.parametrize(
    ("method", "element"),
    [
        pytest.param(LatinMethod(parts=(2, 1)), None, id="LATIN"),
        pytest.param(NewtonSchur((2, 2)), None, id="Newton-Schur, four parts"),
        pytest.param(NewtonSchur((2, 1)), ElementHex2(), id="Newton-Schur, hex27"),
        pytest.param(AssembledNewton(), ElementHex2(), id="assembled, hex27"),
    ],
)
def test_parts_share_a_platen_that_tilts(method, element):
    joint, assembly = tilting(element=element)
    pressures = np.array([5e6, 10e6])
    expected = press_blocks(joint, JOINT_LAW, pressures)
    result = solve_assembly(assembly, pressures, method=method)
    assert result.converged.values.all()
    gap = result.jump.values[..., 0] @ result.point_area.values / joint.area
    np.testing.assert_allclose(gap, expected.mean_gap, rtol=1e-8)
    plate = np.isclose(result.position[:, 2], joint.upper.height)
    x, y = result.position.values[plate, :2].T
    moved = result.displacement.values[:, plate, 2]
    plane = np.column_stack([np.ones(x.size), x, y])
    tilt = np.linalg.lstsq(plane, moved.T)[0]
    np.testing.assert_allclose(plane @ tilt, moved.T, rtol=1e-9)
    approach = -np.array([1.0, *joint.eccentricity]) @ tilt
    np.testing.assert_allclose(approach, expected.approach, rtol=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_a_body_rubs_on_the_ground_however_it_is_cut(method):
    law = Sliders(Exponential(1e6, 5e-5), 0.3, pressures=(1e3, 1e6))
    tread = sliding_block(TreadBlock((0.03, 0.02, 0.008), 4e6, 0.3, (4, 2, 1)), law)
    pressures = np.array([1e5, 2e5])
    once, computed = (
        solve_assembly(tread, pressures, method=entry) for entry in (AssembledNewton(), method)
    )
    size = float(abs(once.displacement).max())
    np.testing.assert_allclose(computed.displacement, once.displacement, atol=1e-7 * size)
    load = -computed.traction.values[..., 0] @ computed.point_area.values
    np.testing.assert_allclose(load, pressures * 0.03 * 0.02, rtol=1e-7)


def test_unknowns_and_displacements_of_nodes_agree():
    problem = cut_assembly(tilting()[1], (2, 1))
    u = np.random.default_rng(0).normal(size=(2, problem.n))
    moved = np.array([problem.displacement(component) for component in u])
    np.testing.assert_allclose(problem.unknowns(moved), u, atol=1e-12)
    # a plate that tilts moves as the body does: to turn both about the axis y needs no force
    upper = problem.substructures[3]  # without the pins
    force = upper.stiffness @ upper.rigid_motions
    assert np.abs(force[upper.unknown >= problem.n - 3][:, [2, 4]]).max() < 1e-9 * abs(force).max()
