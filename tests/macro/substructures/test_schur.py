"""Newton's method with a balanced Schur complement, against monolithic tangents."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh, null_space
from scipy.sparse import csr_array

from multiscale.fe.elasticity import condense, split
from multiscale.laws import Exponential, Sliders
from multiscale.laws.link import Bar
from multiscale.macro import (
    AssembledNewton,
    LatinMethod,
    LinkSystem,
    solve_static,
    tensegrity_grid,
)
from multiscale.macro.substructures import (
    cut_assembly,
    cut_links,
    split_boxes,
    split_grid,
)
from multiscale.macro.substructures.balancing import FLEXIBLE, flexible_motions
from multiscale.macro.substructures.cut_tangent import CutTangent
from multiscale.macro.substructures.stack import Alone, stack_substructures
from multiscale.numerics.factorisation import factorise, on_diagonal
from tests.cut_methods import solve_schur
from tests.macro.substructures.test_cut_joints import stacked_blocks, two_blocks, whole_blocks
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
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))
    assembly = two_blocks(law)
    owners = [
        split_boxes(body, parts)
        for body, parts in zip(assembly.bodies, ((2, 1, 1), (4, 2, 1)), strict=True)
    ]
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


def test_steps_that_did_not_converge_are_nan(grid):
    problem = cut_links(grid, split_grid(grid, (2, 2)))
    result = solve_schur(problem, np.array([1.0, 4.0]), max_iterations=3)
    np.testing.assert_array_equal(result.converged, [0, 0])
    assert np.isnan(result.tension).all()
    assert np.isnan(result.displacement).all()
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))  # 4 MPa are the limit
    pushed = solve_schur(stacked_blocks(law, 1, (1.0, 6.0, 1.0)), np.eye(3), max_iterations=20)
    np.testing.assert_array_equal(pushed.converged, [1, 0, 0])
    assert np.isnan(pushed.displacement[1:]).all()


@pytest.mark.parametrize(("decay", "tilt", "limit"), [(0.4e-6, 0.2, 1), (4e-9, 0.9, 6)])
def test_a_step_that_newton_does_not_solve_is_solved_from_the_solution_of_latin(decay, tilt, limit):
    law = Sliders(Exponential(1e9, decay), 0.2, pressures=(1e6, 1e8))
    problem = stacked_blocks(law, 1, (1.0, 2.0), tilt=tilt)
    result = solve_schur(problem, np.eye(2), max_iterations=limit)
    assert "were solved from LATIN: the iteration limit was reached" in result.fallback
    assert result.residual.max() <= 1e-10  # the tolerance and the residual of Newton's method
    assert limit <= result.iterations[-1] <= 2 * limit
    assert (result.krylov_iterations > 0).all()
    latin = LatinMethod(tolerance=1e-10).solve(problem, np.eye(2)).iterations.values
    count = latin[-int(result.fallback[0]) :].sum()  # of the last steps
    assert result.fallback.endswith(f"LATIN took {count} iterations")
    expected = AssembledNewton().solve(problem, np.eye(2)).displacement.values
    np.testing.assert_allclose(
        result.displacement, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max()
    )
    assert "fallback" not in solve_schur(problem, np.eye(2)).attrs


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


def preconditioned_eigenvalues(tangent):
    """Eigenvalues of the preconditioned Schur complement of a tangent, rising."""
    balancing = tangent.balancing
    columns = np.eye(balancing.layout.n_shared)
    S = np.array([balancing.multiply(column) for column in columns])
    M = np.array([balancing(column) for column in columns])
    return eigh(S @ M @ S, S, eigvals_only=True)


def slack_tangent(n, parts, slack):
    """Solver of a grid at a tangent with some slack cables."""
    grid = tensegrity_grid(n, prestress=2550.0)
    tangent = CutTangent(cut_links(grid, split_grid(grid, (parts, parts))), Alone())
    cables = tangent.stack.one_sided
    loose = cables & (np.random.default_rng(seed=1).random(cables.size) < slack)
    tangent.renew(np.where(loose, 1e-5, 1.0), np.zeros((3, 3, 0)))
    return tangent


@pytest.mark.parametrize("parts", [2, 4])
def test_preconditioned_eigenvalues_of_a_plate_lie_between_unity_and_a_small_number(parts):
    tangent = CutTangent(thin_plate(parts), Alone())
    tangent.renew(np.zeros(0), np.zeros((3, 3, 0)))
    values = preconditioned_eigenvalues(tangent)
    assert values[0] > 1.0 - 1e-6
    assert values[-1] < 10.0


@pytest.mark.parametrize("slack", [0.0, 0.1, 0.2])
def test_constraints_bound_the_condition_number_for_any_share_of_slack_cables(slack, monkeypatch):
    tangent = slack_tangent(8, 4, slack)
    values = preconditioned_eigenvalues(tangent)
    assert values[0] > 1.0 - 1e-6
    assert values[-1] < 10.0
    monkeypatch.setattr("multiscale.macro.substructures.balancing.FLEXIBLE", np.inf)
    assert preconditioned_eigenvalues(slack_tangent(8, 4, slack))[-1] > 50.0


def test_ritz_values_are_the_condition_number_of_the_preconditioned_tangent():
    tangent = slack_tangent(8, 4, 0.1)
    force = np.random.default_rng(seed=2).standard_normal(tangent.stack.n)
    values = preconditioned_eigenvalues(tangent)
    condition = tangent.solve(force, 1e-10).condition
    assert condition == pytest.approx(values[-1] / values[0], rel=0.05)


def test_a_renewed_preconditioner_equals_a_new_preconditioner():
    tangent = slack_tangent(8, 4, 0.1)
    share = tangent.share.copy()
    some = (tangent.of_link == 5) & tangent.stack.one_sided
    share[some] = np.where(share[some] < 1.0, 1.0, 1e-5)
    tangent.renew(share, tangent.tangent)
    grid = tensegrity_grid(8, prestress=2550.0)
    anew = CutTangent(cut_links(grid, split_grid(grid, (4, 4))), Alone())
    anew.renew(share, np.zeros((3, 3, 0)))
    force = np.random.default_rng(seed=3).standard_normal(tangent.balancing.layout.n_shared)
    assert tangent.balancing.n_coarse == anew.balancing.n_coarse
    for apply in ("multiply", "__call__"):
        first, second = (getattr(each.balancing, apply)(force) for each in (tangent, anew))
        np.testing.assert_allclose(first, second, atol=1e-9 * np.abs(first).max())


def test_flexible_motions_leave_jumps_that_both_sides_resist():
    rng = np.random.default_rng(seed=4)
    first, second, flexibility = (
        root @ root.T for root in rng.standard_normal((3, 9, 9)) * np.logspace(-2, 2, 9)
    )
    first, second = first[:6, :6], second[:6, :6]  # three unknowns of corners
    motions = flexible_motions(first, second, flexibility)
    H = np.linalg.inv(np.linalg.inv(first) + np.linalg.inv(second))
    resisted = np.linalg.inv(flexibility)[:6, :6]  # with tied corners
    every = eigh(H, resisted, eigvals_only=True)
    assert 0 < motions.shape[1] == np.count_nonzero(every > FLEXIBLE)
    free = null_space(motions.T)  # jumps that the coarse problem does not balance
    left = eigh(free.T @ H @ free, free.T @ resisted @ free, eigvals_only=True)
    assert left[-1] == pytest.approx(every[every <= FLEXIBLE].max())


@pytest.mark.parametrize(
    ("n", "parts", "factor", "outer", "krylov"),
    [
        pytest.param(16, 4, 0.25, 5, 45, id="taut"),
        pytest.param(16, 4, 4.0, 8, 48, id="slack"),
        pytest.param(32, 8, 4.0, 10, 71, id="slack, four times as many", marks=pytest.mark.slow),
        pytest.param(32, 4, 4.0, 10, 75, id="slack, larger substructures", marks=pytest.mark.slow),
    ],
)
def test_iterations_grow_neither_with_substructures_nor_with_slack(n, parts, factor, outer, krylov):
    grid = tensegrity_grid(n, prestress=2550.0 * (n / 16) ** 2)
    problem = cut_links(grid, split_grid(grid, (parts, parts)))
    result = solve_schur(problem, factor, tolerance=1e-8)
    expected = solve_static(grid, factor).tension.values
    np.testing.assert_allclose(
        result.tension.values[0], expected, rtol=0.0, atol=1e-8 * np.abs(expected).max()
    )
    assert result.iterations <= outer
    assert result.krylov_iterations <= krylov
    assert result.condition_number <= 10.0
    share = result.attrs["coarse_unknowns"] / result.attrs["unknowns"]
    assert share <= (0.13 if n // parts == 4 else 0.03)


def test_interiors_are_in_balance_before_a_step(grid):
    problem, shares, counted = cut_links(grid, split_grid(grid, (2, 2))), [], []
    stack = stack_substructures(problem)

    def note(iteration, residual, iterate):
        counted.append(iteration)
        force = stack.links.operator.T @ iterate.tension - 4.0 * stack.load[:, 0]
        inside = np.abs(force[~stack.shared]).max()
        shares.append(inside / np.abs(problem.sum_up([force])).max())

    solve_schur(problem, 4.0, callback=note)
    assert counted == list(range(len(counted)))
    assert shares[0] == 1.0  # the load
    assert max(shares[1:-1]) < 0.02  # the last step ends within the tolerance


def test_substructures_that_touch_in_a_point_have_the_tensions_of_the_whole():
    base = np.array([[1.0, 0.0, -1.0], [-0.5, 0.8, -1.0], [-0.5, -0.8, -1.0], [0.1, 0.2, -0.6]])
    position = np.concatenate([[[0.0, 0.0, 0.0]], base, -base])  # the apex is shared
    ends = np.array([[4, 1], [4, 2], [4, 3], [0, 1], [0, 2], [0, 4]])
    tower = LinkSystem(
        position,
        np.concatenate([ends, np.where(ends > 0, ends + 4, 0)]),
        (Bar(rigidity=1e7),),
        np.zeros(12, dtype=int),
        np.repeat(np.isin(np.arange(9), [0, 4, 8], invert=True), 3).reshape(9, 3),
        np.where(np.arange(9)[:, None] == 0, [10.0, 20.0, -1000.0], 0.0),
    )
    result = solve_schur(cut_links(tower, np.repeat([0, 1], 6)))
    expected = solve_static(tower).tension.values
    np.testing.assert_allclose(
        result.tension.values[0], expected, atol=1e-8 * np.abs(expected).max()
    )
    assert result.attrs["coarse_unknowns"] == 3


def test_a_stiffness_that_is_not_positive_semidefinite_is_refused_with_its_eigenvalue():
    problem = thin_plate(2)
    first = problem.substructures[0]
    entry = csr_array(([2.0 * first.stiffness.diagonal().max()], ([5], [5])), (first.n,) * 2)
    wrong = replace(first, stiffness=csr_array(first.stiffness - entry))
    result = solve_schur(replace(problem, substructures=(wrong, *problem.substructures[1:])))
    assert result.converged == 0
    assert re.search(r"not positive semidefinite: its smallest eigenvalue is -\d", result.failure)


def test_a_load_that_overflows_ends_the_path_without_an_answer(grid):
    result = solve_schur(cut_links(grid, split_grid(grid, (2, 2))), [1.0, 1e308, 2.0])
    assert list(result["converged"].values) == [1, 0, 0]
    assert list(result["iterations"].values[2:]) == [0]


def test_unfinished_linear_systems_are_reported(monkeypatch):
    monkeypatch.setattr("multiscale.macro.substructures.cut_tangent.KRYLOV", 1)
    result = solve_schur(thin_plate(4), max_iterations=3)
    assert result.converged == 0
    assert "3 of its linear systems did not converge" in result.failure
