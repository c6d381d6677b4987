"""Newton's method with a balanced Schur complement, against monolithic solvers."""

import numpy as np
import pytest
from scipy.linalg import eigh

from multiscale.errors import CaseError
from multiscale.fe.boxes import box_mesh
from multiscale.fe.condensation import condense, split
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import Assembly, Body, Interface, solve_static, tensegrity_grid
from multiscale.macro.substructures import (
    cut_assembly,
    cut_links,
    solve_schur,
    split_boxes,
    split_grid,
)
from multiscale.macro.substructures.coarse import prepare_balancing
from multiscale.macro.substructures.schur import NewtonSchur
from multiscale.macro.substructures.stack import Factors
from multiscale.numerics.factorisation import factorise, on_diagonal
from tests.macro.substructures.test_cut_joints import stacked_blocks, whole_blocks
from tests.macro.substructures.test_latin import tension_error, thin_plate


@pytest.fixture(scope="module")
def grid():
    return tensegrity_grid(8, prestress=2550.0 / 4.0)


def test_the_linear_iterations_do_not_grow_with_the_number_of_substructures():
    counts = []
    for n in (8, 16, 24):
        grid = tensegrity_grid(n)
        problem = cut_links(grid, split_grid(grid, (n // 4, n // 4)))
        factor = 0.25 * (16.0 / n) ** 2  # equally far from slackness
        result = solve_schur(problem, factor)
        expected = solve_static(grid, factor).tension.values
        assert tension_error(grid, result.tension.values[0], expected) < 1e-8
        counts.append(float(result.krylov_iterations[0] / result.iterations[0]))
    assert max(counts) <= 12.0
    assert counts[2] <= 1.3 * counts[1]


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
    (expected,) = whole_blocks(problem, law, steps=1)
    np.testing.assert_allclose(result.displacement[0], expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("decay_length", [4e-9, 1e-4])
@pytest.mark.parametrize("pressure_scale", [1e3, 1e9, 1e15])
def test_joints_from_hard_to_soft_converge_in_few_linear_iterations(pressure_scale, decay_length):
    result = solve_schur(stacked_blocks(Exponential(pressure_scale, decay_length), 1))
    assert result.converged == 1
    assert result.krylov_iterations <= 6 * result.iterations


def test_what_did_not_converge_is_no_result(grid):
    problem = cut_links(grid, split_grid(grid, (2, 2)))
    result = solve_schur(problem, np.array([1.0, 4.0]), max_iterations=3)
    np.testing.assert_array_equal(result.converged, [0, 0])
    assert np.isnan(result.tension).all()
    assert np.isnan(result.displacement).all()
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))  # 4 MPa are the limit
    pushed = solve_schur(stacked_blocks(law, 1, (1.0, 6.0, 1.0)), np.eye(3), max_iterations=20)
    np.testing.assert_array_equal(pushed.converged, [1, 0, 0])
    assert np.isnan(pushed.displacement[1:]).all()


def test_load_factors_that_do_not_fit_are_refused(grid):
    with pytest.raises(CaseError, match="load cases"):
        solve_schur(cut_links(grid, split_grid(grid, (2, 2))), np.ones((2, 3)))


def test_condensation_solves_a_system_that_is_not_symmetric():
    rng = np.random.default_rng(seed=3)
    sizes, n = (7, 4, 9), 20
    blocks = [np.eye(size) * 8.0 + rng.standard_normal((size, size)) for size in sizes]
    matrix = on_diagonal(blocks)
    force = rng.standard_normal(n)
    parts = split(np.cumsum([0, *sizes]), rng.random(n) < 0.4)
    condensed = condense(matrix, parts, factorise)
    schur = on_diagonal(condensed.blocks).toarray()
    edge = np.linalg.solve(schur, condensed.reduce(force))
    np.testing.assert_allclose(matrix @ condensed.expand(force, edge), force, atol=1e-13)


@pytest.mark.parametrize("parts", [2, 4])
def test_preconditioned_eigenvalues_lie_between_one_and_a_small_number(parts):
    method = NewtonSchur().start(thin_plate(parts))
    matrix = method.stack.matrix(np.zeros(0), None)
    condensed = condense(matrix, method.split, Factors())
    schur = method.layout.gather(condensed.blocks)
    nothing, coarse = np.zeros(method.layout.shared.shape), Factors()
    balancing = prepare_balancing(method.layout, schur, nothing, coarse)
    columns = np.eye(method.layout.n_shared)
    S = np.array([method.layout.multiply(schur, column) for column in columns])
    M = np.array([balancing(column) for column in columns])
    values = eigh(S @ M @ S, S, eigvals_only=True)
    assert values[0] > 1.0 - 1e-6
    assert values[-1] < 4.0


def test_the_callback_hears_every_iteration_of_newton(grid):
    heard = []
    result = solve_schur(
        cut_links(grid, split_grid(grid, (2, 2))),
        4.0,
        callback=lambda iteration, residual, method: heard.append((iteration, residual)),
    )
    assert [iteration for iteration, _ in heard] == list(range(int(result["iterations"][0]) + 1))
    assert heard[-1][1] < 1e-6 * heard[0][1]


def test_a_load_that_overflows_ends_the_path_without_an_answer(grid):
    result = solve_schur(cut_links(grid, split_grid(grid, (2, 2))), [1.0, 1e308, 2.0])
    assert list(result["converged"].values) == [1, 0, 0]
    assert list(result["iterations"].values[2:]) == [0]


def test_linear_systems_left_unfinished_are_told(monkeypatch):
    monkeypatch.setattr("multiscale.macro.substructures.schur.KRYLOV", 1)
    result = solve_schur(thin_plate(4), max_iterations=3)
    assert result.converged == 0
    assert "3 of its linear systems did not converge in 1 iterations" in result.failure
