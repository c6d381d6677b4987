"""One assembly, three methods: the same answer, the same refusals."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.fe.boxes import box_mesh
from multiscale.laws import Exponential, RigidContact, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import (
    AssembledNewton,
    Assembly,
    Body,
    Interface,
    LatinMethod,
    NewtonSchur,
    solve_assembly,
)
from multiscale.macro.bodies import stacked_blocks
from multiscale.macro.substructures import JointLoading, load_joint

STEEL, EDGE = Elastic(210e9, 0.3), 0.02
STEPS = np.array([[20e6, 0.0], [20e6, 1.4e6], [20e6, 2.8e6], [20e6, -1.4e6]])  # Pa
METHODS = [
    pytest.param(LatinMethod(parts=(2, 1)), id="LATIN"),
    pytest.param(NewtonSchur(parts=(2, 1)), id="Newton-Schur"),
    pytest.param(AssembledNewton(parts=(2, 1)), id="assembled, cut"),
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
    found = solve_assembly(blocks(), STEPS, method=method)
    assert found.converged.values.all()
    assert set(whole) <= set(found)
    size = float(abs(whole.displacement).max())
    np.testing.assert_allclose(found.displacement, whole.displacement, atol=1e-6 * size)
    place = ("point_joint", "point_position")
    orders = [
        np.lexsort(np.column_stack([one[name].values for name in place]).round(9).T)
        for one in (found, whole)
    ]
    for name in ("traction", "jump"):
        mine, theirs = (
            one[name].values[:, order] for one, order in zip((found, whole), orders, strict=True)
        )
        np.testing.assert_allclose(mine, theirs, atol=1e-6 * np.abs(theirs).max(), err_msg=name)


def test_measures_of_a_joint_do_not_depend_on_the_method():
    loading = JointLoading((10e6, 20e6), shear=1.5e6, cycles=1, steps=2)
    one, other = (
        load_joint(blocks(), loading, method=method)
        for method in (AssembledNewton(), LatinMethod())
    )
    for name in ("joint_stiffness", "tangential_stiffness", "approach", "cycle_energy"):
        np.testing.assert_allclose(one[name], other[name], rtol=1e-5, err_msg=name)
    np.testing.assert_allclose(one.load_above, other.load_above, atol=1e-6)


@pytest.mark.parametrize("method", [AssembledNewton(), LatinMethod(), NewtonSchur()])
def test_a_path_ends_where_friction_does(method):
    slid = solve_assembly(
        blocks(), np.array([[20e6, 0.0], [20e6, 8e6], [20e6, 0.0]]), method=method
    )
    np.testing.assert_array_equal(slid.converged, [1, 0, 0])
    assert (
        "the steps end before step 1: no equilibrium found: the bodies slide on joint 0"
        in (slid.attrs["failure"])
    )
    assert np.isnan(slid.displacement[1:]).all()


def test_a_body_without_interfaces_is_linear():
    plate = Body(
        box_mesh((0.1, 0.1, 0.01), (4, 4, 1)),
        STEEL,
        supports={"left": (0.0, 0.0, 0.0)},
        tractions={"top": (0.0, 0.0, -1e3)},
    )
    once, cut = (
        solve_assembly(Assembly((plate,)), np.array([1.0, 2.0]), method=method)
        for method in (AssembledNewton(), LatinMethod(parts=(2, 2)))
    )
    assert once.converged.values.all()
    np.testing.assert_allclose(once.displacement[1], 2.0 * once.displacement[0], rtol=1e-9)
    size = float(abs(once.displacement).max())
    np.testing.assert_allclose(once.displacement, cut.displacement, atol=1e-6 * size)


@pytest.mark.parametrize("method", [AssembledNewton(), NewtonSchur()])
def test_methods_that_need_a_traction_refuse_rigid_contact(method):
    rigid = stacked_blocks((EDGE,) * 3, (1, 1, 1), [STEEL] * 2, [RigidContact(0.2)])
    with pytest.raises(CaseError, match="solve_latin takes rigid contact as well"):
        solve_assembly(rigid, np.array([[1e6, 0.0]]), method=method)


def test_an_assembly_that_cannot_be_is_refused():
    body = Body(box_mesh((EDGE,) * 3, (1, 1, 1)), STEEL)
    law = Exponential(1e9, 1e-6)
    with pytest.raises(CaseError, match="interface 0 names body 2; there are 2, counted from 0"):
        Assembly((body, body), (Interface((0, 2), ("top", "bottom"), law),))
    with pytest.raises(CaseError, match="the mesh has no boundary 'lid'"):
        Assembly((body, body), (Interface((0, 1), ("lid", "bottom"), law),))
    with pytest.raises(CaseError, match="areas must be one for each of 1 load cases, got 2"):
        Assembly((body,), (), areas=(1.0, 1.0))
    with pytest.raises(CaseError, match="two load cases, preload and shear"):
        load_joint(Assembly((body,)), JointLoading((1e6,)))
