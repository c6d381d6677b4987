"""Newton's method with a balanced Schur complement, against monolithic solvers."""

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.sparse import block_diag, csr_array
from scipy.sparse.linalg import spsolve

from multiscale.errors import CaseError
from multiscale.fe.boxes import box_mesh
from multiscale.fe.condensation import condense, split
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import (
    Assembly,
    Body,
    Interface,
    solve_interface,
    solve_static,
    tensegrity_grid,
)
from multiscale.macro.substructures import (
    assemble,
    bisect,
    cut_assembly,
    cut_links,
    solve_latin,
    solve_schur,
    split_boxes,
    split_grid,
)
from multiscale.macro.substructures.balancing import prepare_balancing
from multiscale.macro.substructures.cut_tangent import Newton
from multiscale.macro.substructures.stack import Factors
from multiscale.numerics.factorisation import factorise
from multiscale.schema import MACRO_RESULT
from tests.macro.test_cut_joints import law_of_stiffness, stacked_blocks
from tests.macro.test_substructures import tension_error
from tests.support import slow

FACTORS = [0.25, 1.0, 4.0]


@pytest.fixture(scope="module")
def grids():
    return {8: tensegrity_grid(8, prestress=2550.0 / 4.0), 16: tensegrity_grid(16)}


@pytest.fixture(scope="module")
def tensions(grids):
    return {
        (n, a): solve_static(grid, a).tension.values for n, grid in grids.items() for a in FACTORS
    }


@pytest.mark.parametrize("load_factor", FACTORS)
@pytest.mark.parametrize("parts", [*slow(1), 2, *slow(4), 8])
@pytest.mark.parametrize("n", [8, *slow(16)])
def test_a_cut_tensegrity_has_the_monolithic_tensions(grids, tensions, n, parts, load_factor):
    grid = grids[n]
    result = solve_schur(cut_links(grid, split_grid(grid, (parts, parts))), load_factor)
    MACRO_RESULT.check(result)
    assert result.converged == 1
    assert tension_error(grid, result.tension.values[0], tensions[n, load_factor]) < 1e-8
    assert result.attrs["substructures"] == parts**2


def test_any_cut_into_connected_pieces_gives_the_same_tensions(grids, tensions):
    grid = grids[8]
    result = solve_schur(cut_links(grid, bisect(grid, 5)), 1.0)
    assert tension_error(grid, result.tension.values[0], tensions[8, 1.0]) < 1e-8


def test_the_linear_iterations_do_not_grow_with_the_number_of_substructures(grids):
    counts = []
    for n in (8, 16, 24):
        grid = tensegrity_grid(n)
        problem = cut_links(grid, split_grid(grid, (n // 4, n // 4)))
        result = solve_schur(problem, 0.25 * (16.0 / n) ** 2)  # equally far from slackness
        counts.append(float(result.krylov_iterations[0] / result.iterations[0]))
    assert max(counts) <= 12.0
    assert counts[2] <= 1.3 * counts[1]


def test_loads_step_by_step_end_where_one_step_does(grids, tensions):
    grid = grids[8]
    result = solve_schur(cut_links(grid, split_grid(grid, (2, 2))), np.array([0.25, 1.0]))
    for step, load_factor in enumerate((0.25, 1.0)):
        error = tension_error(grid, result.tension.values[step], tensions[8, load_factor])
        assert error < 1e-8


def thin_plate(parts):
    """Clamped at two edges and pressed, cut into squares."""
    clamped = (0.0, 0.0, 0.0)
    plate = Body(
        box_mesh((4.0, 4.0, 0.2), (16, 16, 1)),
        Elastic(70e9, 0.3),
        supports={"left": clamped, "right": clamped},
        tractions={"top": (0.0, 0.0, -1e3)},
    )
    return cut_assembly(Assembly((plate,)), (parts, parts))


@pytest.mark.parametrize("parts", [1, 2, 4, 8])
def test_substructures_of_a_plate_bend_like_the_plate(parts):
    problem = thin_plate(parts)
    whole = assemble(problem)
    K, load = whole.stiffness, whole.load
    expected = problem.displacement(spsolve(K.tocsc(), load[:, 0]))
    result = solve_schur(problem)
    assert result.converged == 1
    assert result.krylov_iterations <= 20
    np.testing.assert_allclose(result.displacement[0], expected, atol=1e-8 * np.abs(expected).max())


def monolithic(problem, law, steps):
    """Displacement of every step by the monolithic Newton method."""
    whole = assemble(problem)
    K, load, jump, weight = whole.stiffness, whole.load, whole.jump, whole.weight
    state, u, found = np.zeros((law.n_state, weight.size)), None, []
    for step in range(steps):
        u = solve_interface(K, load[:, step], jump, weight, law, state=state, start=u).unwrap()
        state = law.respond((jump @ u).reshape(3, -1), state).state
        found.append(problem.displacement(u))
    return found


@pytest.mark.parametrize("parts", [1, 2])
def test_a_rough_joint_with_friction_loaded_and_unloaded_is_the_monolithic_one(parts):
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))
    times = (1.0, 2.0, 3.0, 1.5)  # pressed, pushed twice, and pushed back
    problem = stacked_blocks(law, parts, times)
    result = solve_schur(problem, np.eye(len(times)))
    assert np.all(result.converged == 1)
    for step, expected in enumerate(monolithic(problem, law, len(times))):
        size = np.abs(expected).max()
        np.testing.assert_allclose(result.displacement[step], expected, atol=1e-8 * size)


def test_the_sides_of_a_joint_may_be_cut_differently():
    law = Exponential(1e9, 0.4e-6)
    lower = Body(
        box_mesh((0.02, 0.02, 0.02), (4, 4, 2), origin=(0.0, 0.0, -0.02)),
        Elastic(210e9, 0.3),
        supports={"bottom": (0.0, 0.0, 0.0)},
    )
    upper = Body(
        box_mesh((0.02, 0.02, 0.02), (4, 4, 2)),
        Elastic(210e9, 0.3),
        supports={"front": (None, 0.0, None), "left": (0.0, None, None)},
        tractions={"top": (0.0, 0.0, lambda x, t: -20e6 * (1.0 + 20.0 * (x[0] - 0.01)))},
    )
    owners = [split_boxes(lower, (2, 1, 1)), split_boxes(upper, (4, 2, 1))]
    assembly = Assembly((lower, upper), (Interface((0, 1), ("top", "bottom"), law),))
    problem = cut_assembly(assembly, owners=owners)
    result = solve_schur(problem)
    assert result.converged == 1
    (expected,) = monolithic(problem, law, 1)
    np.testing.assert_allclose(result.displacement[0], expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("decay_length", [4e-9, 1e-4])
@pytest.mark.parametrize("pressure_scale", [1e3, 1e9, 1e15])
def test_joints_from_hard_to_soft_converge_in_few_linear_iterations(pressure_scale, decay_length):
    result = solve_schur(stacked_blocks(Exponential(pressure_scale, decay_length), 1))
    assert result.converged == 1
    assert result.krylov_iterations <= 6 * result.iterations


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("ratio", [1e-6, *slow(1e-4), 1.0, *slow(1e6), 1e12])
def test_joints_from_a_millionth_of_the_stiffness_of_the_blocks_to_1e12_converge(ratio, parts):
    law = law_of_stiffness(ratio)
    problem = stacked_blocks(law, parts, (1.0, 2.0))
    result = solve_schur(problem, np.eye(2))
    assert np.all(result.converged == 1)
    assert np.all(result.iterations <= 8)
    # what rounding excuses is far below the load, whatever the motion
    assert np.all(result.residual <= (1e-10 if ratio > 1e-6 else 1e-8))
    other = solve_latin(problem, np.eye(2))
    u = [found.displacement.values for found in (result, other)]
    np.testing.assert_allclose(u[0], u[1], atol=1e-7 * np.abs(u[1]).max())


def test_what_did_not_converge_is_no_result(grids):
    grid = grids[8]
    problem = cut_links(grid, split_grid(grid, (2, 2)))
    result = solve_schur(problem, np.array([1.0, 4.0]), max_iterations=3)
    np.testing.assert_array_equal(result.converged, [0, 0])
    assert np.isnan(result.tension).all()
    assert np.isnan(result.displacement).all()
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))  # 4 MPa are the limit
    pushed = solve_schur(stacked_blocks(law, 1, (1.0, 6.0, 1.0)), np.eye(3), max_iterations=20)
    np.testing.assert_array_equal(pushed.converged, [1, 0, 0])
    assert np.isnan(pushed.displacement[1:]).all()


def test_load_factors_that_do_not_fit_are_refused(grids):
    grid = grids[8]
    with pytest.raises(CaseError, match="load cases"):
        solve_schur(cut_links(grid, split_grid(grid, (2, 2))), np.ones((2, 3)))


def test_condensation_solves_a_system_that_is_not_symmetric():
    rng = np.random.default_rng(seed=3)
    sizes, n = (7, 4, 9), 20
    blocks = [np.eye(size) * 8.0 + rng.standard_normal((size, size)) for size in sizes]
    matrix = csr_array(block_diag(blocks, format="csr"))
    force = rng.standard_normal(n)
    parts = split(np.cumsum([0, *sizes]), rng.random(n) < 0.4)
    condensed = condense(matrix, parts, factorise)
    schur = block_diag(condensed.blocks).toarray()
    edge = np.linalg.solve(schur, condensed.reduce(force))
    np.testing.assert_allclose(matrix @ condensed.expand(force, edge), force, atol=1e-13)


@pytest.mark.parametrize("parts", [2, 4])
def test_preconditioned_eigenvalues_lie_between_one_and_a_small_number(parts):
    method = Newton(thin_plate(parts))
    matrix = method.stack.matrix(np.zeros(0), None)
    condensed = condense(matrix, method.parts, Factors())
    schur = method.layout.gather(condensed.blocks)
    nothing, coarse = np.zeros(method.layout.shared.shape), Factors()
    balancing = prepare_balancing(method.layout, schur, nothing, coarse)
    columns = np.eye(method.layout.n_shared)
    S = np.array([method.layout.multiply(schur, column) for column in columns])
    M = np.array([balancing(column) for column in columns])
    values = eigh(S @ M @ S, S, eigvals_only=True)
    assert values[0] > 1.0 - 1e-6
    assert values[-1] < 4.0


def test_the_callback_hears_every_iteration_of_newton(grids):
    heard = []
    grid = grids[8]
    result = solve_schur(
        cut_links(grid, split_grid(grid, (2, 2))),
        4.0,
        callback=lambda iteration, residual, method: heard.append((iteration, residual)),
    )
    assert [iteration for iteration, _ in heard] == list(range(int(result["iterations"][0]) + 1))
    assert heard[-1][1] < 1e-6 * heard[0][1]


def test_a_load_that_overflows_ends_the_path_without_an_answer(grids):
    grid = grids[8]
    result = solve_schur(cut_links(grid, split_grid(grid, (2, 2))), [1.0, 1e308, 2.0])
    assert list(result["converged"].values) == [1, 0, 0]
    assert list(result["iterations"].values[2:]) == [0]


def test_linear_systems_left_unfinished_are_told(monkeypatch):
    monkeypatch.setattr("multiscale.macro.substructures.cut_tangent.KRYLOV", 1)
    result = solve_schur(thin_plate(4), max_iterations=3)
    assert result.converged == 0
    assert "3 of its linear systems were left unfinished after 1 iterations" in result.failure
