"""The reference grid of 16 x 16 modules: table, stored tensions, independent solvers, size."""

import numpy as np
import pytest

from multiscale.macro import solve_static, tensegrity_grid
from multiscale.macro.links.link_equations import compatibility

# load factor, slack cables, max tension over prestress, work of the load (J), smallest tangent
# eigenvalue (N/m): computed once by an independent prototype and its dual program
TABLE = np.array(
    [
        [0.00, 0, 1.0, 0.0, 389.277527],
        [0.25, 6, 1.51072490122, 159.786599719, 349.8453],
        [0.50, 60, 2.09193136317, 704.126135078, 264.1306],
        [0.75, 300, 2.93862251111, 2107.52178502, 151.0840],
        [1.00, 434, 4.16330102932, 4473.83518381, 138.8350],
    ]
)
STORED = ["0", "0.25", "0.5", "0.75", "1", "1.5", "2", "4", "1000"]


@pytest.fixture(scope="module")
def grid():
    return tensegrity_grid(16)


@pytest.fixture(scope="module")
def table(grid):
    return solve_static(grid, TABLE[:, 0], stability=True)


def test_the_table_of_the_reference_grid(grid, table):
    assert np.all(table.converged == 1)
    np.testing.assert_array_equal((table.slack > 0.0).sum("link"), TABLE[:, 1])
    np.testing.assert_allclose(table.tension.max("link") / 2550.0, TABLE[:, 2], rtol=1e-9)
    work = table.load_factor * np.einsum("ni,sni->s", grid.load, table.displacement)
    np.testing.assert_allclose(work, TABLE[:, 3], rtol=1e-9)
    np.testing.assert_allclose(table.tangent_eigenvalue[0], TABLE[0, 4], rtol=1e-9)
    np.testing.assert_allclose(table.tangent_eigenvalue, TABLE[:, 4], rtol=1e-6)


def test_equilibrium_holds_to_the_tenth_digit_of_the_load(grid, table):
    operator = compatibility(grid)
    for step, load_factor in enumerate(TABLE[1:, 0], start=1):
        load = load_factor * grid.load[~grid.fixed]
        unbalanced = operator.T @ table.tension.values[step] - load
        assert np.abs(unbalanced).max() < 1e-10 * np.abs(load).max()


def test_stored_tensions_at_all_load_factors(grid, reference_data):
    stored = np.load(reference_data / "tensegrity" / "ref_grid16_S2550.npz")
    order = np.lexsort(np.round(4.0 * grid.position).T)
    known = np.lexsort(np.round(4.0 * stored["X"]).T)
    np.testing.assert_allclose(grid.position[order], stored["X"][known], atol=1e-12)
    same_node = np.empty(grid.n_nodes, dtype=int)
    same_node[order] = known
    np.testing.assert_array_equal(same_node[grid.ends], stored["links"])

    result = solve_static(grid, [float(name) for name in STORED])
    assert np.all(result.converged == 1)
    for step, name in enumerate(STORED):
        tension, expected = result.tension.values[step], stored[f"tau_{name}"]
        np.testing.assert_allclose(tension, expected, atol=1e-6 * np.abs(expected).max())
        carried = np.abs(expected) > 1e-6 * np.abs(expected).max()
        np.testing.assert_allclose(tension[carried], expected[carried], rtol=1e-6)


def test_the_geometric_stiffness_makes_the_grid_buckle_above_its_load(grid, table):
    assert np.all(table.stability_eigenvalue > 0.0)
    assert solve_static(grid, [2.0], stability=True).stability_eigenvalue[0] < 0.0


@pytest.mark.parametrize(
    ("load_factor", "most"),
    [(1.0, 9), *(pytest.param(*row, marks=pytest.mark.slow) for row in ((4.0, 20), (1000.0, 25)))],
)
def test_the_number_of_iterations_hardly_grows_with_the_size(load_factor, most):
    counts = []
    for n in (16, 24, 32):
        result = solve_static(tensegrity_grid(n, prestress=2550.0 * (n / 16) ** 2), load_factor)
        assert result.converged == 1
        counts.append(int(result.iterations))
    assert max(counts) <= most
    assert counts[2] <= counts[1] + 5


@pytest.mark.long
@pytest.mark.parametrize("load_factor", [1.0, 4.0])
def test_a_grid_of_786432_cables_is_solved(load_factor):
    pytest.importorskip("pypardiso", reason="takes SuperLU many minutes")
    result = solve_static(tensegrity_grid(256, prestress=2550.0 * 16**2), load_factor)
    assert result.converged == 1
    assert float(result.residual) < 1e-8
