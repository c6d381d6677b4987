"""The flat cell: small slopes, against the conforming cell and a closed form."""

import numpy as np
import pytest

from multiscale.convergence import Status
from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.micro.elastic import flat_contact
from multiscale.micro.elastic.elastic_cells import assemble_flat_cell, flat_compliance
from multiscale.micro.elastic.flat_contact import coarse_start
from multiscale.micro.elastic.lateral_fft import SurfaceFilter
from tests.support import rough_square, wave


def rough(n, slope):
    return rough_square(n, 0.5, 0.25, slope, seed=4)


def test_a_profile_is_a_ridge_in_plane_strain():
    path = Path(pressure=(1e-3, 5e-3))
    ridge = wave((64, 2), 1e-2)
    profile = Surface(ridge.heights[:, :1], (1.0, 0.7))
    across = Surface(profile.heights.T, (0.7, 1.0))
    for geometry in ("flat", "conforming"):
        results = [
            solve_cell(Cell(surface, 1.0, 12, 1.0, 0.3, geometry=geometry), path)
            for surface in (ridge, profile, across)
        ]
        for other in results[1:]:
            np.testing.assert_allclose(other["mean_gap"], results[0]["mean_gap"], rtol=1e-6)
            np.testing.assert_allclose(other["traction"], results[0]["traction"], atol=1e-8)


@pytest.mark.parametrize("share", [0.01, 0.1, 0.5, 0.9])
def test_of_a_soft_surface_the_share_that_carries_is_pressure_over_hardness(share):
    hardness = 1e-4  # Pa, where the elastic pressures would reach .1 Pa
    cell = Cell(rough(128, 0.1), 1.0, 12, 1.0, 0.3, geometry="flat", hardness=hardness)
    response = solve_cell(cell, Path(pressure=(share * hardness,)), keep_fields=True)
    assert response["contact_fraction"].item() == pytest.approx(share, rel=1e-3, abs=1.0 / 128**2)
    assert response["pressure"].values.max() <= hardness * (1.0 + 1e-12)


def test_a_hardness_beyond_every_pressure_changes_nothing():
    path = Path(pressure=(0.001, 0.01))
    free, capped = (
        solve_cell(Cell(rough(32, 0.1), 1.0, 8, 1.0, 0.3, geometry="flat", hardness=hardness), path)
        for hardness in (None, 10.0)
    )
    np.testing.assert_allclose(capped["mean_gap"], free["mean_gap"], rtol=1e-6)


def test_approach_control_gives_the_pressure_back():
    cell = Cell(rough(32, 0.1), 1.0, 10, 1.0, 0.3, geometry="flat")
    loaded = solve_cell(cell, Path(pressure=(0.0, 0.005)))
    approach = rough(32, 0.1).heights
    moved = approach.max() - approach.mean() - loaded["mean_gap"].values[0, 1]
    assert moved > 0.0
    assert loaded["contact_fraction"].values[0, 0] == 0.0
    pressed = solve_cell(cell, Path(approach=(-1.0, 0.02)))
    again = solve_cell(cell, Path(pressure=(-float(pressed["traction"].values[0, 1, 0]),)))
    assert again["mean_gap"].item() == pytest.approx(pressed["mean_gap"].values[0, 1], rel=1e-4)


@pytest.mark.parametrize("first", [1e-6, 4e-6])
def test_a_pressure_far_above_the_first_pressure_is_reached(first):
    cell = Cell(rough(32, 0.02), 1.0, 8, 1.0, 0.3, geometry="flat")
    both = solve_cell(cell, Path(pressure=(first, 4e-3)))
    alone = solve_cell(cell, Path(pressure=(4e-3,)))
    assert both["converged"].values.all()
    np.testing.assert_allclose(both["mean_gap"][0, 1], alone["mean_gap"][0, 0], rtol=1e-5)


def test_every_other_point_answers_long_waves_as_all_points_do():
    cell = Cell(Surface(np.zeros((24, 16)), (1.0, 0.8)), 0.7, 4, 1.0, 0.3, geometry="flat")
    every = SurfaceFilter(flat_compliance(cell))
    x, y = np.arange(24)[:, None] / 24, np.arange(16) / 16
    for kx, ky in ((0, 0), (5, 0), (-5, 3), (1, 2)):
        force = np.cos(2.0 * np.pi * (kx * x + ky * y) + 0.3)
        result = every.coarse(4.0 * force[::2, ::2])
        np.testing.assert_allclose(result, every(force)[::2, ::2], rtol=1e-10)


def _start_elsewhere(*problem, **options):
    """A good guess for the surface shifted by half its length."""
    return np.roll(coarse_start(*problem, **options), 32, axis=0)


def _start_at_random(_compliance, gap, _closing, *, load, cap):
    return np.random.default_rng(seed=1).uniform(0.0, 1e3 * load, gap.shape)


@pytest.mark.parametrize("hardness", [None, 0.06], ids=["elastic", "hard"])
@pytest.mark.parametrize("start", [lambda *_, **__: None, _start_elsewhere, _start_at_random])
def test_a_guess_from_fewer_points_saves_iterations_and_changes_no_answer(
    monkeypatch, hardness, start
):
    monkeypatch.setattr(flat_contact, "_FINE", 16)
    cell = Cell(rough(64, 0.2), 1.0, 2, 1.0, 0.3, geometry="flat", hardness=hardness)
    problem, scale = assemble_flat_cell(cell), float(np.ptp(cell.surface.heights))
    pressed = {"load": 0.01, "approach": None, "start": None, "tolerance": 1e-6}
    guessed = problem.solve(**pressed)
    with monkeypatch.context() as patch:
        patch.setattr(flat_contact, "coarse_start", start)
        elsewhere = assemble_flat_cell(cell)
    other = elsewhere.solve(**pressed)
    assert guessed.linear_iterations < 0.95 * other.linear_iterations
    for state in (guessed, other):
        assert state.status is Status.CONVERGED
        assert np.sum(state.force) == pytest.approx(0.01, rel=1e-3)
        gap = problem.obstacle_height - problem.surface_height - state.displacement[:, 2]
        overlap = np.where(state.force < problem.cap, state.approach - gap, 0.0)
        assert np.max(overlap) <= 1e-6 * scale
        assert np.all(state.force <= problem.cap)
    assert other.approach == pytest.approx(guessed.approach, abs=1e-5 * scale)
    np.testing.assert_allclose(other.force, guessed.force, atol=1e-3 * np.max(guessed.force))


def test_the_guess_carries_the_load_below_the_cap_nearly_where_the_solution_does():
    cell = Cell(rough(256, 0.2), 1.0, 2, 1.0, 0.3, geometry="flat", hardness=0.06)
    problem = assemble_flat_cell(cell)
    gap, symbol = problem.obstacle_height - problem.surface_height, flat_compliance(cell)
    options = {"load": 0.01, "cap": problem.cap}
    guess = coarse_start(SurfaceFilter(symbol), gap, np.ones_like(gap), **options)
    solved = problem.solve(load=0.01, approach=None, start=None, tolerance=1e-6)
    assert np.sum(guess) == pytest.approx(0.01, rel=1e-2)
    assert 0.0 <= np.min(guess) <= np.max(guess) <= problem.cap
    assert np.linalg.norm(guess - solved.force) < 0.2 * np.linalg.norm(solved.force)


@pytest.mark.parametrize("shape", [(257, 256), (256, 257), (128, 512)])
def test_odd_and_coarse_grids_have_no_guess(shape):
    symbol = SurfaceFilter(np.ones((shape[0], shape[1] // 2 + 1)))
    given = {"load": 1.0, "cap": np.inf}
    assert coarse_start(symbol, np.zeros(shape), np.ones(shape), **given) is None
