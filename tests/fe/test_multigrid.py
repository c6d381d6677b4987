"""Multigrid solves tangents of bodies and joints of any contrast as factors do, or refuses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import diags_array
from skfem import ElementHex2

from multiscale.errors import MultiscaleError
from multiscale.fe import multigrid
from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import Assembly, Body, Interface, MultigridNewton
from multiscale.macro.bodies import stacked_blocks
from multiscale.macro.monolithic import factorise_joined
from multiscale.macro.substructures import assemble, cut_assembly

STEEL, EDGE = Elastic(210e9, 0.3), 0.02
LAW = Sliders(Exponential(2e9, 0.2e-6), 0.2, pressures=(1e6, 1e8))
FEW = 50  # iterations


def matching():
    return stacked_blocks((EDGE, EDGE, 0.5 * EDGE), (10, 10, 5), [STEEL] * 2, [LAW])


def unlike():
    """A body of second order on a finer body of first order, which do not match."""
    lower = Body(box_mesh((EDGE,) * 3, (7, 7, 7)), STEEL, supports={"bottom": (0.0,) * 3})
    upper = Body(
        box_mesh((EDGE,) * 3, (4, 4, 4), origin=(0.0, 0.0, EDGE)),
        replace(STEEL, youngs_modulus=70e9),
        tractions={"top": (0.2, 0.1, -1.0)},
        element=ElementHex2(),
    )
    return Assembly((lower, upper), (Interface((0, 1), ("top", "bottom"), LAW),))


@pytest.fixture(scope="module", params=[matching, unlike], ids=["matching", "unlike"])
def structure(request):
    problem = cut_assembly(request.param())
    return assemble(problem, MultigridNewton().linear(problem)), problem


def tangent(structure, contrast, across, opened):
    """Tangents of the joint: normal contrast, tangential share of it, and a side that is open."""
    whole, problem = structure
    x = problem.joints[0].position[:, 0]
    k = contrast * 4.0 * whole.resistance * whole.weight
    k = np.where(opened & (x > 0.5 * EDGE), 0.0, k)
    return k * np.diag([1.0, across, across])[:, :, None]


def compare(structure, D):
    """Error of the displacement under all loads, in the norm of the energy of the bodies."""
    whole, _ = structure
    load = whole.load @ np.ones(whole.load.shape[1])
    expected = factorise_joined(whole.stiffness, whole.jump, D)(load)
    error = whole.linear(whole.stiffness, whole.jump, D)(load) - expected
    size = expected @ (whole.stiffness @ expected)
    return float(np.sqrt(abs(error @ (whole.stiffness @ error)) / size))


@pytest.mark.slow
@pytest.mark.parametrize("contrast", [1e-6, 1.0, 1e3, 1e8])
@pytest.mark.parametrize(("across", "opened"), [(1.0, False), (1e-3, True)])
def test_contrasts_of_the_joint_need_few_iterations(
    structure, contrast, across, opened, monkeypatch
):
    monkeypatch.setattr(multigrid, "ROOM", FEW)  # more iterations are refused
    assert compare(structure, tangent(structure, contrast, across, opened)) < 1e-6


def test_friction_makes_a_tangent_that_is_not_symmetric(structure):
    for contrast in (1.0, 1e4):
        D = tangent(structure, contrast, 1e-3, False)
        D[1, 0] = -0.3 * D[0, 0]  # mu times the normal stiffness
        assert compare(structure, D) < 1e-6


def test_a_residual_above_the_goal_is_not_an_answer(structure, monkeypatch):
    monkeypatch.setattr(multigrid, "ROOM", 3)
    with pytest.raises(MultiscaleError, match="multigrid left a residual of"):
        compare(structure, tangent(structure, 1.0, 1.0, False))


def test_a_body_that_may_move_is_refused(structure):
    whole, _ = structure  # without its joint nothing supports the upper body
    load, D = whole.load @ np.ones(whole.load.shape[1]), tangent(structure, 0.0, 1.0, False)
    with pytest.raises(MultiscaleError, match="singular"):
        whole.linear(whole.stiffness, whole.jump, D)(load)


@pytest.mark.parametrize("unbalanced", [0.0, 1e-6])
@pytest.mark.parametrize(
    ("supports", "across", "friction"),
    [
        ({}, 1.0, 0.0),  # tied blocks move together
        ({"bottom": (0.0,) * 3}, 0.0, 0.3),  # the upper block slides
    ],
    ids=["free", "sliding"],
)
def test_rigid_motions_are_refused_under_any_load(supports, across, friction, unbalanced):
    bodies = tuple(
        Body(
            box_mesh((EDGE,) * 3, (7, 7, 7), origin=(0.0, 0.0, z)),
            STEEL,
            supports={} if z else supports,
        )
        for z in (0.0, EDGE)
    )
    problem = cut_assembly(Assembly(bodies, (Interface((0, 1), ("top", "bottom"), LAW),)))
    whole = assemble(problem, MultigridNewton().linear(problem))
    D = 4.0 * whole.resistance * whole.weight * np.diag([1.0, across, across])[:, :, None]
    D[1, 0] = -friction * D[0, 0]
    load = whole.stiffness @ np.sin(np.arange(whole.stiffness.shape[0]))  # in equilibrium
    load[-1] += unbalanced * np.abs(load).max()
    for linear in (whole.linear, factorise_joined):
        with pytest.raises(MultiscaleError, match="singular"):
            linear(whole.stiffness, whole.jump, D)(load)


def test_bodies_without_joints_are_solved(structure):
    whole, _ = structure
    nothing, none = np.zeros((3, 3, 0)), whole.jump[:0]
    on_springs = whole.stiffness + diags_array(0.1 * whole.stiffness.diagonal())
    load = whole.load @ np.ones(whole.load.shape[1])
    exact = factorise_joined(on_springs, none, nothing)(load)
    answer = whole.linear(on_springs, none, nothing)(load)
    np.testing.assert_allclose(answer, exact, atol=1e-8 * np.abs(exact).max())


@pytest.mark.slow
def test_iterations_do_not_grow_with_the_size(monkeypatch):
    counts = []
    solve = multigrid.minimal_residual

    def counted(*arguments, **options):
        answer, count = solve(*arguments, **options)
        counts.append(count)
        return answer, count

    monkeypatch.setattr(multigrid, "minimal_residual", counted)
    for n in (5, 10, 20):
        blocks = stacked_blocks((EDGE, EDGE, 0.5 * EDGE), (n, n, n // 2), [STEEL] * 2, [LAW])
        problem = cut_assembly(blocks)
        whole = assemble(problem, MultigridNewton().linear(problem))
        D = tangent((whole, problem), 1.0, 1.0, False)
        whole.linear(whole.stiffness, whole.jump, D)(whole.load @ np.ones(2))
    assert counts[2] < counts[1] + 4
