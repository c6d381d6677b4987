"""Grids of growing size by every method; the verifier and the norms by which they are judged."""

from functools import partial

import numpy as np
import pytest

from multiscale.bench.measure import measure
from multiscale.bench.structures import (
    GRID_METHODS,
    GridAnswer,
    distance,
    scene_grid,
    solve_grid,
    verify,
)
from multiscale.macro import self_stress, solve_static
from multiscale.macro.links.link_equations import compatibility
from multiscale.numerics import factorisation
from tests.link_structures import free_module


def answer_of(result):
    return GridAnswer(result["tension"].values, result["displacement"].values, 0, 0)


@pytest.fixture(scope="module")
def grid():
    return scene_grid(4)


@pytest.fixture(scope="module")
def answer(grid):
    return answer_of(solve_static(grid, 4.0))


def test_the_answer_of_newton_is_verified(grid, answer):
    assert np.any(answer.tension[grid.kind == 0] == 0.0), "some cables must be slack"
    assert verify(grid, 4.0, answer) < 1e-10


def test_the_verifier_finds_the_force_out_of_balance(grid, answer):
    wrong = answer.tension.copy()
    wrong[5] += 1e-3 * np.abs(wrong).max()
    unbalanced = np.abs(compatibility(grid).T @ (wrong - answer.tension)).max()
    result = verify(grid, 4.0, GridAnswer(wrong, answer.displacement, 0, 0))
    assert result == pytest.approx(unbalanced / 160.0, rel=1e-6)  # the load is 4 x 40 N


def test_the_verifier_finds_balanced_tensions_that_miss_the_link_law(grid, answer):
    module = np.zeros(grid.n_links)
    module[:16] = self_stress(free_module())[0]
    assert np.abs(compatibility(grid).T @ module).max() < 1e-12
    wrong = answer.tension + 100.0 * module
    result = verify(grid, 4.0, GridAnswer(wrong, answer.displacement, 0, 0))
    expected = 100.0 * np.abs(module).max() / np.abs(wrong).max()
    assert result == pytest.approx(expected, rel=1e-6)


def test_an_answer_of_nan_is_not_verified(grid, answer):
    nothing = GridAnswer(np.nan * answer.tension, answer.displacement, 0, 0)
    assert np.isnan(verify(grid, 4.0, nothing))


def test_the_squared_norm_of_a_change_without_slack_is_the_work_of_the_load(grid):
    rest, loaded = (solve_static(grid, factor) for factor in (0.0, 0.01))
    assert np.all(loaded["slack"] == 0.0)
    tension, reference = loaded["tension"].values, rest["tension"].values
    size = np.sum(reference**2 / grid.stiffness)
    work = 0.01 * np.sum(grid.load * loaded["displacement"].values)
    assert distance(grid, tension, reference) ** 2 * size == pytest.approx(work, rel=1e-8)


@pytest.mark.slow
def test_the_share_of_slack_cables_does_not_depend_on_the_size():
    for load_factor, share in ((1.0, 0.141), (4.0, 0.284)):
        for n in (8, 16, 32):
            result = solve_static(scene_grid(n), load_factor)
            slack = np.count_nonzero(result["slack"] > 0.0)
            assert slack / (12 * n**2) == pytest.approx(share, abs=0.005)


def takes_pardiso(method):
    """Solve, and return whether PARDISO factorises in this process."""
    solve_grid(scene_grid(2), 1.0, method)
    return factorisation.new_pardiso() is not None


@pytest.mark.parametrize("name", ["Newton, PARDISO", "Newton, SuperLU"])
def test_each_method_has_the_factorisation_of_its_name(name):
    pytest.importorskip("pypardiso")
    task = partial(takes_pardiso, GRID_METHODS[name])
    assert measure(task, task).value == name.endswith("PARDISO")
