"""Rough joints of cut bodies against monolithic solvers, under laws from soft to stiff."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from multiscale.errors import ConvergenceError
from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, RigidContact, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import (
    AssembledNewton,
    Assembly,
    Body,
    Interface,
    LatinMethod,
    NewtonSchur,
    bodies,
    solve_interface,
)
from multiscale.macro.substructures import (
    assemble,
    cut_assembly,
    joint_path,
    load_joint,
    solve_latin,
)
from multiscale.macro.substructures.capacity import find_slide
from multiscale.macro.substructures.latin import Latin
from tests.cut_methods import solve_schur
from tests.support import slow


def two_blocks(law, times=(1.0,), tilt=0.2, shear=1.4e6):
    """Two blocks of 20 mm under a pressure that is not quite even, then pushed."""
    elements = (4, 4, 3)
    lower = Body(
        box_mesh((0.02, 0.02, 0.02), elements, origin=(0.0, 0.0, -0.02)),
        Elastic(210e9, 0.3),
        supports={"bottom": (0.0, 0.0, 0.0)},
    )
    upper = Body(
        box_mesh((0.02, 0.02, 0.02), elements),
        Elastic(210e9, 0.3),
        supports={"front": (None, 0.0, None)},
        tractions={
            "top": (
                lambda x, t: shear * (t - 1.0),
                0.0,
                lambda x, t: -20e6 * (1.0 + tilt * (100.0 * x[0] - 1.0)),
            )
        },
    )
    joint = Interface((0, 1), ("top", "bottom"), law)
    return Assembly((lower, upper), (joint,), times)


def stacked_blocks(law, parts, *scene, **changes):
    """Two blocks in parts along either edge."""
    return cut_assembly(two_blocks(law, *scene, **changes), (parts, parts))


@pytest.mark.parametrize("solve", [solve_latin, solve_schur])
def test_a_rough_joint_with_friction_loaded_and_unloaded_is_the_monolithic_joint(solve):
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))
    times = (1.0, 2.0, 3.0, 1.5)  # pressed, pushed twice, and pushed back
    problem = stacked_blocks(law, 2, times)
    result = solve(problem, np.eye(len(times)))
    assert np.all(result.converged == 1)

    whole = assemble(problem)
    K, load, jump, weight = whole.stiffness, whole.load, whole.jump, whole.weight
    state, u = np.zeros((law.n_state, weight.size)), None
    for step in range(len(times)):
        solution = solve_interface(K, load[:, step], jump, weight, law, state=state, start=u)
        assert solution.converged
        u = solution.value
        before, state = state, law.respond((jump @ u).reshape(3, -1), state).state
        expected = problem.displacement(u)
        size = np.abs(expected).max()
        np.testing.assert_allclose(result.displacement[step], expected, atol=1e-8 * size)
        traction = law.respond((jump @ u).reshape(3, -1), before).traction.T
        computed = result.traction.values[step]
        np.testing.assert_allclose(computed, traction, atol=1e-7 * np.abs(traction).max())
        np.testing.assert_allclose(
            result.jump.values[step], (jump @ u).reshape(3, -1).T, atol=1e-8 * size
        )


def pushed(law, parts, share, tilt=0.0):
    """The blocks pressed by 8 kN, of which friction carries 1600 N, pushed by a share, unloaded."""
    return stacked_blocks(law, parts, (1.0, 1.0 + share * 1600.0 / (1.4e6 * 4e-4), 1.0), tilt=tilt)


def say_slide(result):
    """Load and capacity, N, in the sentence of a step that slides away."""
    text = result.attrs["failure"]
    match = re.search(r"on interface 0 under a load of (\S+) N; .* carries about (\S+) N", text)
    assert match, text
    return float(match[1]), float(match[2])


@pytest.mark.slow
@pytest.mark.parametrize(("solve", "parts"), [(solve_latin, 2), (solve_schur, 1)])
def test_a_push_just_below_friction_is_balanced_and_a_push_just_above_it_is_refused(solve, parts):
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))
    outcome = solve(pushed(law, parts, 0.99), np.eye(3))
    assert np.all(outcome.converged == 1)
    assert "failure" not in outcome.attrs
    result = solve(pushed(law, parts, 1.5), np.eye(3))
    np.testing.assert_array_equal(result.converged, [1, 0, 0])
    np.testing.assert_array_equal(result.displacement[0], outcome.displacement[0])
    assert np.isnan(result.displacement[1:]).all()
    assert "the steps end before step 1: there is no equilibrium" in result.attrs["failure"]
    np.testing.assert_allclose(say_slide(result), [1.5 * 1600.0, 1600.0], rtol=1e-3)


@pytest.mark.parametrize("method", [AssembledNewton, LatinMethod, NewtonSchur])
def test_every_method_reports_every_step_that_converged(method):
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))
    problem, steps = stacked_blocks(law, 1, (1.0, 2.0)), []
    result = method(after_step=lambda: steps.append(1)).solve(problem, np.eye(2))
    assert len(steps) == int(result.converged.sum()) == 2


def test_the_residual_separates_a_block_that_runs_away_from_a_block_in_balance(monkeypatch):
    monkeypatch.setattr("multiscale.macro.substructures.latin.find_slide", lambda *_: None)
    law = Sliders(Exponential(1e9, 1e-8), 0.2, pressures=(1e6, 1e8))
    result = solve_latin(pushed(law, 1, 1.75), np.eye(3), tolerance=1e-6)
    np.testing.assert_array_equal(result.converged, [1, 0, 0])
    assert "the iteration limit was reached" in result.failure


def test_a_step_that_a_law_has_no_answer_to_keeps_the_steps_before(monkeypatch):
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))
    resolvent = Sliders.resolvent

    def give_up(self, source, stiffness, state):
        if np.abs(state).max() > 0.0:  # from the second step on
            raise ConvergenceError("no jump on the search direction")
        return resolvent(self, source, stiffness, state)

    monkeypatch.setattr(Sliders, "resolvent", give_up)
    result = solve_latin(pushed(law, 1, 0.5), np.eye(3))
    np.testing.assert_array_equal(result.converged, [1, 0, 0])
    assert np.isnan(result.displacement[1:]).all()
    assert "the steps end before step 1: no jump on the search direction" in result.failure


@pytest.mark.slow
def test_forces_out_of_balance_between_substructures_do_not_hide_behind_the_motion():
    # without a coarse problem, relative to the motion they fell below 1e-4 on the way
    law = Sliders(Exponential(1e9, 1e-8), 0.2, pressures=(1e6, 1e8))
    result = solve_latin(pushed(law, 2, 1.05), np.eye(3), tolerance=1e-3, coarse=False)
    np.testing.assert_array_equal(result.converged, [1, 0, 0])


@pytest.mark.parametrize("solve", [solve_latin, solve_schur])
@pytest.mark.parametrize("force", [1e8, 1e30])
def test_an_absurd_push_ends_the_path_in_a_sentence(solve, force):
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))
    result = solve(pushed(law, 1, force / 1600.0), np.eye(3))
    np.testing.assert_array_equal(result.converged, [1, 0, 0])
    np.testing.assert_allclose(say_slide(result), [force, 1600.0], rtol=1e-3)


def test_what_friction_carries_is_the_least_over_all_joints_that_a_motion_slides():
    """A tower of three: the middle joint has half the friction; a part of the push acts there."""
    size, steel = (0.02, 0.02, 0.02), Elastic(210e9, 0.3)
    floor = {"bottom": (0.0, 0.0, 0.0)}
    loads = ({}, {}, {"right": (1e6, 0.0, 0.0), "top": (0.0, 0.0, -20e6)})
    bodies = [
        Body(
            box_mesh(size, (2, 2, 2), origin=(0.0, 0.0, k * 0.02)),
            steel,
            supports={} if k else floor,
            tractions=load,
        )
        for k, load in enumerate(loads)
    ]
    laws = [Sliders(Exponential(1e9, 0.4e-6), mu, pressures=(1e6, 1e8)) for mu in (0.2, 0.1)]
    joints = [Interface((k, k + 1), ("top", "bottom"), law) for k, law in enumerate(laws)]
    problem = cut_assembly(Assembly(bodies, joints))
    load = problem.load(np.ones(1))
    even = np.full(18, 20e6)
    assert find_slide(problem, load, even) is None  # 400 N of 800 N
    slide = find_slide(problem, 3.0 * load, even)
    assert slide.joints == (1,)
    np.testing.assert_allclose([slide.load, slide.capacity], [1200.0, 800.0], rtol=2e-3)
    assert find_slide(problem, -load, even).joints == ()  # it lifts


def law_of_stiffness(ratio):
    """Law with a stiffness at 20 MPa that is a ratio of the stiffness of a block."""
    normal = Exponential(20e6, 20e6 * 0.02 / (ratio * 210e9))
    return Sliders(normal, 0.2, pressures=(1e6, 1e8))


def whole_blocks(problem, law, steps=1):
    """Displacement of the nodes in every step, in one array."""
    whole, state, u, computed = assemble(problem), None, None, []
    for step in range(steps):
        u = solve_interface(
            whole.stiffness,
            whole.load[:, step],
            whole.jump,
            whole.weight,
            law,
            state=state,
            start=u,
        ).unwrap()
        before = np.zeros((law.n_state, whole.weight.size)) if state is None else state
        state = law.respond((whole.jump @ u).reshape(3, -1), before).state
        computed.append(problem.displacement(u))
    return np.array(computed)


def test_a_corner_of_a_cut_joint_that_opens_jumps_as_far_as_its_bodies_are_apart():
    """One corner, a separate substructure, opens and closes again under friction of 1.5."""
    size, materials = (0.02, 0.02, 0.02), [Elastic(210e9, 0.3)] * 2
    law = Sliders(law_of_stiffness(1e6).normal, 1.5, pressures=(2e6, 2e8))
    blocks = bodies.stacked_blocks(size, (2, 2, 2), materials, [law])
    loading = joint_path((20e6,), shear=6e6, cycles=1, steps=2)
    result, problem = (
        load_joint(blocks, loading, method=LatinMethod(parts=(2, 2))),
        cut_assembly(blocks, (2, 2)),
    )
    pressure = -result.traction.values[..., 0]
    assert np.any(pressure.min(axis=0) < 1e-9 * 20e6)
    u = problem.unknowns(result.displacement.values)
    apart = (assemble(problem).jump @ u.T).T.reshape(len(u), 3, -1).swapaxes(1, 2)
    np.testing.assert_allclose(result.jump, apart, atol=1e-8 * 20e6 * 0.02 / 210e9)


@pytest.mark.parametrize("ratio", [1e-6, 1.0, *slow(1e8), 1e12])
def test_joints_from_a_millionth_of_the_stiffness_of_the_blocks_to_1e12_converge(ratio):
    law = law_of_stiffness(ratio)
    problem = stacked_blocks(law, 2, (1.0, 2.0))
    result = solve_latin(problem, np.eye(2))
    assert np.all(result.converged == 1)
    assert np.all(result.iterations <= 55)
    newton = solve_schur(problem, np.eye(2))
    assert np.all(newton.converged == 1)
    assert np.all(newton.iterations <= 8)
    # what rounding excuses is far below the load, whatever the motion
    assert np.all(newton.residual <= (1e-10 if ratio > 1e-6 else 1e-8))
    u = [outcome.displacement.values for outcome in (newton, result)]
    np.testing.assert_allclose(u[0], u[1], atol=1e-7 * np.abs(u[1]).max())
    force = np.einsum("spd,p->sd", result.traction.values, result.point_area.values)
    np.testing.assert_allclose(force[:, 0], -20e6 * 0.02**2, rtol=1e-7)
    if 1e-4 <= ratio <= 1e4:
        expected = whole_blocks(problem, law, steps=2)
        size = np.abs(expected).max()
        np.testing.assert_allclose(result.displacement, expected, atol=1e-8 * size)


@pytest.mark.parametrize(
    ("solve", "law"),
    [
        (solve_latin, Sliders(Exponential(1e9, 0.4e-6, gap=1e-3), 0.2, pressures=(1e6, 1e8))),
        (solve_schur, Sliders(Exponential(1e9, 0.4e-6, gap=1e-3), 0.2, pressures=(1e6, 1e8))),
        (solve_latin, RigidContact(0.2)),
    ],
)
def test_a_joint_that_is_open_everywhere_separates_both_bodies(solve, law):
    assembly, pulled = two_blocks(law), dict.fromkeys(("left", "right"), (0.0, 0.0, 5e6))
    lower, upper = assembly.bodies
    upper = replace(upper, supports={"top": (0.0, 0.0, 0.0)}, tractions=pulled)
    problem = cut_assembly(replace(assembly, bodies=(lower, upper)), (2, 2))
    result = solve(problem)
    assert result.converged == 1
    if solve is solve_latin:
        assert np.all(result.traction == 0.0)
    whole = assemble(problem)
    expected = problem.displacement(spsolve(whole.stiffness.tocsc(), whole.load[:, 0]))
    size = np.abs(expected).max()
    np.testing.assert_allclose(result.displacement[0], expected, atol=1e-8 * size)


@pytest.mark.parametrize("ratio", [1e-2, 1.0, 1e2])
def test_a_joint_that_opens_on_one_side_is_the_monolithic_joint(ratio):
    law = law_of_stiffness(ratio)
    problem = stacked_blocks(law, 2, tilt=1.5)  # the edge would pull by half the pressure
    result = solve_latin(problem)
    assert result.converged == 1
    assert result.iterations <= 70
    (expected,) = whole_blocks(problem, law)
    size = np.abs(expected).max()
    np.testing.assert_allclose(result.displacement[0], expected, atol=1e-8 * size)


def test_directions_that_follow_a_soft_law_save_iterations(monkeypatch):
    problem = stacked_blocks(law_of_stiffness(1e-2), 2)
    updated = solve_latin(problem)
    monkeypatch.setattr(Latin, "update", lambda self: None)
    fixed = solve_latin(problem)
    assert 1.5 * updated.iterations.item() < fixed.iterations.item()


def test_the_indicator_of_joints_is_heuristic_by_name_and_small_at_the_end():
    result = solve_latin(stacked_blocks(law_of_stiffness(1.0), 2, (1.0, 2.0)), np.eye(2))
    assert np.isnan(result.error_bound).all()
    assert np.all((result.error_indicator > 0.0) & (result.error_indicator < 1e-7))
    assert "heuristic" in result.error_indicator.attrs["long_name"]


def test_a_block_that_tips_over_does_not_converge():
    lifted = stacked_blocks(law_of_stiffness(1.0), 2, tilt=4.0)  # beyond the edge: it tips over
    result = solve_latin(lifted, max_iterations=60)
    assert result.converged == 0
    assert "the steps end before step 0: there is no equilibrium" in result.attrs["failure"]
    assert "tips" in result.attrs["failure"]
    assert np.isnan(result.displacement).all()
