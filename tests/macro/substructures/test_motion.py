"""Time steps of cut structures against steps of the whole."""

import numpy as np

from multiscale.macro import cut_links, simulate, solve_static, tensegrity_grid
from multiscale.macro.substructures import simulate_latin, split_grid


def test_a_cut_grid_that_is_unloaded_moves_like_the_whole():
    grid = tensegrity_grid(4, prestress=2550.0 / 16.0)
    begin = solve_static(grid, 1.0)
    assert (begin.slack > 0.0).any()
    rest = (begin.displacement.values, np.zeros_like(begin.displacement.values))
    times = np.linspace(0.0, 0.1, 21)

    def gone(time):
        return 0.0

    whole = simulate(grid, times, 2.0, load_factor=gone, start=rest)
    problem = cut_links(grid, split_grid(grid, (2, 2)))
    parts = simulate_latin(problem, times, 2.0, load_factor=gone, start=rest)
    assert np.all(parts.converged == 1)
    for name in ("displacement", "velocity", "tension"):
        scale = float(np.abs(whole[name]).max())
        np.testing.assert_allclose(parts[name], whole[name], atol=1e-7 * scale)
