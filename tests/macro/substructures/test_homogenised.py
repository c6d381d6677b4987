"""Homogenised substructures: patch test, rate, frequencies, resolved substructures, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from multiscale.laws.link import Bar
from multiscale.macro import LinkSystem, NewtonSchur, cable_net, solve_static, tensegrity_grid
from multiscale.macro.links.link_equations import equations
from multiscale.macro.substructures import (
    cut_links,
    simulate_latin,
    solve_homogenised,
    split_grid,
)
from tests.support import observed_rate


def cut(system, parts):
    return cut_links(system, split_grid(system, (parts, parts)))


def at_rest(problem, factor, **options):
    """Homogenised substructures under factors of the load."""
    newton = NewtonSchur(tolerance=1e-9)
    return solve_homogenised(problem, lambda coarse: newton.solve(coarse, factor), **options)


def sheet(n, displacement):
    """Plane square sheet of bars, n by n, under the forces of a displacement (x, y) -> (u, v)."""
    y, x = (axis.ravel() / n for axis in np.mgrid[: n + 1, : n + 1])
    node = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    pairs = [
        (node[:, :-1], node[:, 1:]),
        (node[:-1], node[1:]),
        (node[:-1, :-1], node[1:, 1:]),
        (node[1:, :-1], node[:-1, 1:]),
    ]
    ends = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])
    fixed = np.zeros((x.size, 3), dtype=bool)
    fixed[:, 2] = True
    fixed[0, :2] = fixed[n, 1] = True
    u = np.stack([*displacement(x, y), 0.0 * x], axis=1)
    u[:, 0] -= u[0, 0]
    u[:, 1] -= u[0, 1] + (u[n, 1] - u[0, 1]) * x  # zero at both fixed nodes
    position, kind = np.stack([x, y, 0.0 * x], axis=1), np.zeros(len(ends), dtype=int)
    still = LinkSystem(position, ends, (Bar(1e6),), kind, fixed, np.zeros((x.size, 3)))
    model, load = equations(still), np.zeros((x.size, 3))
    load[~fixed] = model.gather(model.stiffness * model.elongate(u[~fixed]))
    return replace(still, load=load), u


@pytest.mark.parametrize(
    ("power", "exact"),
    [((1, 0), True), ((0, 2), True), ((2, 1), True), ((0, 3), True), ((4, 0), False)],
)
def test_displacements_up_to_cubic_are_exact_for_any_load(power, exact):
    (i, j), size = power, 1e-3
    system, u = sheet(18, lambda x, y: (size * x**i * y**j, -0.5 * size * x**j * y**i))
    result = at_rest(cut(system, 3), 1.0)
    error = np.abs(result["displacement"][0] - u).max().item() / np.abs(u).max()
    assert (error < 1e-9) == exact
    assert error < 1e-2
    assert result.resolved == 0


def test_the_error_decreases_with_the_fourth_power_of_the_size_of_the_substructures():
    system, u = sheet(
        24, lambda x, y: (1e-3 * np.sin(5.0 * x + y), 1e-3 * np.cos(4.0 * y) * np.exp(x))
    )
    parts = np.array([2, 3, 4])
    errors = [
        np.sqrt(np.mean((at_rest(cut(system, count), 1.0)["displacement"][0] - u) ** 2)).item()
        for count in parts
    ]
    assert observed_rate(1.0 / parts, errors) == pytest.approx(4.0, abs=0.5)
    assert errors[-1] < 1e-3 * np.abs(u).max()


@pytest.mark.parametrize(("factor", "resolved"), [(0.1, 0), (0.25, 2)])
def test_a_grid_has_the_tensions_of_the_whole_and_resolves_where_cables_slacken(factor, resolved):
    grid = tensegrity_grid(16)
    result = at_rest(cut(grid, 4), factor).isel(step=0)
    expected = solve_static(grid, factor)
    assert result.converged == 1
    assert result.resolved == resolved
    assert result.unknowns < 0.35 * np.count_nonzero(~grid.fixed)
    np.testing.assert_array_equal(result.slack > 0.0, expected.slack > 0.0)
    u, change = expected["displacement"], expected["tension"] - grid.prestress
    assert np.abs(result["displacement"] - u).max() < 5e-4 * np.abs(u).max()
    assert ((result["tension"] - expected["tension"]) ** 2).mean() < 0.013**2 * (change**2).mean()
    assert result["tension"].max() == pytest.approx(expected["tension"].max().item(), rel=2e-3)


def test_substructures_that_are_all_resolved_are_the_whole():
    grid = tensegrity_grid(8, prestress=2550.0 / 4.0)
    result = at_rest(cut(grid, 2), [0.1, 4.0])
    assert result.resolved == 4
    expected = solve_static(grid, [0.1, 4.0])
    for name in ("tension", "slack", "displacement"):
        size = np.abs(expected[name]).max().item()
        np.testing.assert_allclose(result[name], expected[name], rtol=0.0, atol=1e-7 * size)


@pytest.mark.slow
def test_the_first_frequencies_are_within_a_percent_and_a_motion_follows_the_whole():
    grid, coarse = tensegrity_grid(16), []
    problem = cut(grid, 4)
    times, mass = np.linspace(0.0, 0.05, 6), 5.0

    def move(reduced):
        coarse.append(reduced)
        return simulate_latin(reduced, times, mass, load_factor=lambda time: 0.1)

    result = solve_homogenised(problem, move)
    assert result.resolved == 0
    expected = simulate_latin(problem, times, mass, load_factor=lambda time: 0.1)
    u = expected["displacement"]
    assert np.abs(result["displacement"] - u).max() < 0.01 * np.abs(u).max()
    model = equations(grid)
    K = (model.operator.T.multiply(model.stiffness) @ model.operator).toarray()
    whole = np.sqrt(eigh(K / mass, eigvals_only=True, subset_by_index=[0, 4]))
    E = coarse[0].expansion
    links = coarse[0].substructures[0].links
    K = (links.operator.T.multiply(links.stiffness) @ links.operator).toarray()
    reduced = eigh(K, mass * (E.T @ E).toarray(), eigvals_only=True)
    ratio = np.sqrt(reduced[:5]) / whole
    assert np.all(ratio > 1.0 - 1e-9)  # displacements of fewer unknowns are stiffer
    assert np.all(ratio < 1.01)


def test_prestressed_nets_approach_the_exact_analysis_as_their_loads_vanish():
    net = cable_net(16, rise=3.0)
    problem = cut_links(net, split_grid(net, (4, 4)), prestressed=True)
    loads = np.array([0.02, 0.2])
    result = at_rest(problem, loads)
    assert (result.resolved, result.unknowns) == (0, 259)
    exact = solve_static(net, loads, exact=True)
    for name, zero in (("displacement", 0.0), ("tension", net.prestress)):
        change = (exact[name] - zero).values
        error = np.abs(result[name].values - exact[name].values)
        first, second = (error[k].max() / np.abs(change[k]).max() for k in range(2))
        assert first < 1e-3
        assert second == pytest.approx(10.0 * first, rel=0.2)  # of second order, and no other
    resolved = at_rest(problem, 60.0)
    assert (resolved.converged.item(), resolved.resolved) == (1, 16)
    assert (resolved["slack"] > 0.0).any()


def test_steps_with_slack_links_are_refused_where_nothing_may_be_resolved():
    result = at_rest(cut(tensegrity_grid(16), 4), [0.1, 1.0], adaptive=False)
    np.testing.assert_array_equal(result.converged, [1, 0])
    assert np.isfinite(result["tension"][0]).all()
    assert np.isnan(result["tension"][1]).all()
    assert np.isnan(result["displacement"][1]).all()
    assert "in step 1" in result.failure
    assert "leave the range of their laws" in result.failure
