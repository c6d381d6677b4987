"""The contact loop: complementarity, control, extremes, and its report when it fails."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.convergence import Status
from multiscale.micro import Cell, Path, Surface, self_affine, solve_cell
from multiscale.micro.elastic import active_set
from multiscale.micro.elastic.active_set import (
    ElasticBody,
    ReferenceInverse,
    solve_elastic_contact,
)
from multiscale.micro.elastic.elastic_cells import assemble_graph_cell
from multiscale.micro.elastic.flat_contact import solve_flat
from multiscale.micro.elastic.lateral_fft import SurfaceFilter
from tests.support import rough_square


def rough(n=32, slope=0.2, size=(1.0, 1.0), seed=0):
    return self_affine(
        (n, n),
        size,
        seed,
        hurst_exponent=0.8,
        long_cutoff=size[0] / 2.0,
        short_cutoff=size[0] / 4.0,
        rms_slope=slope,
    )


def cell_of(surface, **changes):
    given = {"depth": 1.0, "layers": 10, "youngs_modulus": 1.0, "poissons_ratio": 0.3}
    return Cell(surface, **(given | changes))


@pytest.mark.parametrize("pressure", [1e-6, 1e-3, 1e-2, 1.0])
def test_solution_satisfies_every_condition_of_contact(pressure):
    problem = assemble_graph_cell(cell_of(rough()))
    body, gap, closing = problem.solve.args
    state = problem.solve(load=pressure)
    assert state.status is Status.CONVERGED

    distance = gap - closing * state.approach - body.trace(state.displacement)
    balance = body.apply(state.displacement)
    body.add(balance, state.force)
    largest = state.force.max()
    assert np.linalg.norm(balance) <= 2e-8 * np.linalg.norm(state.force)
    assert np.sum(state.force) == pytest.approx(pressure, rel=1e-7)
    assert np.all(state.force >= 0.0)
    assert np.min(distance) >= -1e-8 * np.ptp(gap)
    assert np.max(np.abs(distance[state.active])) <= 1e-10 * np.ptp(gap)
    assert np.all(state.force[~state.active] <= 1e-8 * largest)


def test_iterations_in_single_and_in_double_precision_end_at_one_answer():
    body, gap, closing = assemble_graph_cell(cell_of(rough())).solve.args
    assert body.dtype is np.float32
    single, double = (
        solve_elastic_contact(replace(body, dtype=precision), gap, closing, load=0.02)
        for precision in (np.float32, np.float64)
    )
    assert single.displacement.dtype == np.float64
    assert single.linear_iterations <= double.linear_iterations
    np.testing.assert_array_equal(single.active, double.active)
    assert single.approach == pytest.approx(double.approach, rel=1e-8)
    distance = np.linalg.norm(single.force - double.force)
    assert distance <= 1e-8 * np.linalg.norm(double.force)


def test_prescribing_the_approach_at_a_pressure_gives_the_pressure_back():
    cell = cell_of(rough())
    problem = assemble_graph_cell(cell)
    state = problem.solve(load=0.02)
    response = solve_cell(cell, Path(approach=(state.approach,)))
    assert response["traction"].values[0, 0, 0] == pytest.approx(-0.02, rel=1e-6)


def test_a_step_does_not_depend_on_the_path_to_it():
    cell = cell_of(rough())
    direct = solve_cell(cell, Path(pressure=(0.01,)))
    loop = solve_cell(cell, Path(pressure=(0.002, 0.05, 0.01)))
    for name in ("mean_gap", "contact_fraction"):
        assert loop[name].values[0, -1] == pytest.approx(direct[name].values[0, 0], rel=1e-6)


@pytest.mark.parametrize(
    ("nu", "limit"),
    [(0.3, 20), *(pytest.param(*row, marks=pytest.mark.slow) for row in ((0.49, 30), (0.499, 60)))],
)
def test_linear_iterations_do_not_grow_with_the_grid(nu, limit):
    counts = []
    for n in (32, 64, 128):
        surface = rough_square(n, 0.5, 0.125, 0.2)
        cell = cell_of(surface, layers=14, poissons_ratio=nu)
        response = solve_cell(cell, Path(pressure=(0.02,)))
        counts.append(int(response["linear_iterations"].item()))
    assert counts[2] <= 1.2 * counts[1]
    assert max(counts[1:]) <= limit  # 32 points are 4 in the shortest wave


@pytest.mark.parametrize("length", [1e-9, 1.0, 1e3], ids=["nm", "m", "km"])
@pytest.mark.parametrize("modulus", [1e3, 1e12], ids=["kPa", "TPa"])
def test_the_response_is_free_of_units(length, modulus):
    plain = solve_cell(cell_of(rough()), Path(pressure=(0.01,)))
    surface = rough(size=(length, length))
    cell = cell_of(surface, depth=length, youngs_modulus=modulus)
    scaled = solve_cell(cell, Path(pressure=(0.01 * modulus,)))
    assert scaled["mean_gap"].item() / length == pytest.approx(plain["mean_gap"].item(), rel=1e-6)
    fraction = plain["contact_fraction"].item()
    assert scaled["contact_fraction"].item() == pytest.approx(fraction, rel=1e-6)


@pytest.mark.parametrize("slope", [0.0, 1e-6, 0.5], ids=["flat", "nearly-flat", "steep"])
def test_extreme_slopes_converge(slope):
    surface = rough(slope=slope) if slope else Surface(np.zeros((32, 32)), (1.0, 1.0))
    response = solve_cell(cell_of(surface), Path(pressure=(1e-9, 1e-3, 0.5)))
    assert response["converged"].values.all()
    assert response["contact_fraction"].values[0, -1] > 0.95


def test_zero_pressure_is_the_first_touch():
    surface = rough()
    response = solve_cell(cell_of(surface), Path(pressure=(0.0, 0.01, 0.0)))
    assert response["mean_gap"].values[0, [0, 2]] == pytest.approx(
        surface.heights.max() - surface.heights.mean()
    )
    assert response["contact_fraction"].values[0, 0] == 0.0
    apart = solve_cell(cell_of(surface), Path(approach=(-0.1,)))
    assert np.all(apart["traction"].values == 0.0)


def test_an_unconverged_step_is_not_a_number_and_is_reported():
    problem = assemble_graph_cell(cell_of(rough()))
    state = problem.solve(load=0.02, max_iterations=1)
    assert state.status is Status.MAX_ITERATIONS
    response = solve_cell(cell_of(rough()), Path(pressure=(0.02,)), tolerance=1e-30)
    assert response["converged"].item() == 0
    assert np.isnan(response["mean_gap"].item())


def test_all_active_sets_share_one_budget_of_linear_iterations(monkeypatch):
    cell = cell_of(rough(n=16, slope=0.5), poissons_ratio=0.499)
    monkeypatch.setattr(active_set, "_LINEAR_LIMIT", 160)
    response = solve_cell(cell, Path(pressure=(0.01, 0.0)), recover_stress=False)
    assert response["converged"].values.tolist() == [[0, 1]]
    assert response["active_set_iterations"].values[0, 0] > 1
    assert response["linear_iterations"].values[0, 0] == 160
    assert response.attrs["ended"].startswith("step 0 ended after")
    assert "160 linear iterations: the limit on linear iterations" in response.attrs["ended"]


def dense_body(stiffness, rng):
    """A body that has only contact nodes, with a reference that is only spectrally close to it."""
    n = len(stiffness)
    root = np.linalg.cholesky(stiffness)
    turn, _ = np.linalg.qr(rng.standard_normal((n, n)))
    reference = np.linalg.inv(root @ (turn * rng.uniform(0.3, 3.0, n)) @ turn.T @ root.T)

    def solve(force, correct, out):
        u = np.zeros(n) if force is None else reference @ force
        return u - reference @ correct(u)

    def add(vector, values):
        vector += values

    inverse = ReferenceInverse(solve, lambda f: reference @ f, np.copy)
    return ElasticBody(lambda u, out: stiffness @ u, np.copy, add, inverse, (n,))


@pytest.mark.parametrize("blocks", [5, 0], ids=["all-wrong-nodes", "least-index"])
def test_random_problems_agree_with_non_negative_least_squares(blocks, monkeypatch):
    from scipy.optimize import nnls

    monkeypatch.setattr(active_set, "_BLOCKS", blocks)
    rng = np.random.default_rng(seed=0)
    for _ in range(40):
        n = rng.integers(3, 30)
        factor = rng.standard_normal((n, n))
        stiffness = factor @ factor.T + 10.0 ** rng.uniform(-3.0, 0.0) * np.eye(n)
        gap, approach = rng.uniform(0.0, 1.0, n), rng.uniform(0.2, 2.0)
        state = solve_elastic_contact(
            dense_body(stiffness, rng), gap, np.ones(n), approach=approach, max_iterations=300
        )
        assert state.status is Status.CONVERGED
        root = np.linalg.cholesky(np.linalg.inv(stiffness))
        expected, _ = nnls(root.T, np.linalg.solve(root, approach - gap), maxiter=10000)
        np.testing.assert_allclose(state.force, expected, atol=1e-5 * expected.max())


@pytest.mark.parametrize("cap", [np.inf, 0.3, 0.05], ids=["elastic", "capped", "soft"])
@pytest.mark.parametrize("seed", range(5))
def test_flat_solver_agrees_with_an_independent_quadratic_program(cap, seed):
    from scipy.optimize import lsq_linear

    rng = np.random.default_rng(seed)
    n = 12
    factor = rng.standard_normal((n, n))
    compliance = factor @ factor.T + 0.5 * np.eye(n)
    gap, closing = rng.uniform(0.0, 0.5, n), rng.uniform(0.5, 1.0, n)
    tight = {"cap": cap, "tolerance": 1e-12, "max_iterations": 20000}
    force = solve_flat(lambda f: compliance @ f, gap, closing, approach=1.0, **tight).unwrap()

    root = np.linalg.cholesky(compliance)  # 1/2 f C f - d f = 1/2 |R^t f - R^-1 d|^2 - const
    target = np.linalg.solve(root, closing - gap)
    expected = lsq_linear(root.T, target, (0.0, cap), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(force, expected, atol=1e-7)

    load = float(closing @ expected)
    again = solve_flat(lambda f: compliance @ f, gap, closing, load=load, **tight)
    np.testing.assert_allclose(again.value, expected, atol=1e-6)
    if np.any((expected > 0.0) & (expected < cap)):  # else the approach may lie in an interval
        assert again.approach == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("stiff", ["top", "base"])
def test_a_contrast_of_1e4_between_layers_converges(stiff):
    modulus = np.ones(10)
    modulus[-3:] = 1e4
    layers = modulus if stiff == "top" else modulus[::-1]
    response = solve_cell(cell_of(rough(), youngs_modulus=layers), Path(pressure=(1e-4, 1e-2)))
    assert response["converged"].values.all()
    assert response["linear_iterations"].values.max() <= 60


def test_a_single_asperity_touches_at_a_vanishing_load():
    surface = rough()
    response = solve_cell(cell_of(surface), Path(pressure=(1e-15, 1e-12)), keep_fields=True)
    assert response["converged"].values.all()
    assert np.count_nonzero(response["pressure"].values[0, 0]) == 1
    assert response["mean_gap"].values[0, 0] == pytest.approx(
        surface.heights.max() - surface.heights.mean(), rel=1e-9
    )


def test_a_shallow_cell_is_named_before_it_is_solved(caplog):
    solve_cell(cell_of(rough(), depth=0.5), Path(pressure=(0.01,)))
    assert "a depth of 0.5 m below a period of 1 m makes the longest mode 5.6 % too stiff" in (
        caplog.text
    )


@pytest.mark.parametrize("load", [0.3, 1.0, 3.0])
def test_nodes_that_are_alike_leave_no_step_in_the_tangent_of_the_load(load):
    """Their forces can only change together, and the load forbids it, but for rounding."""
    x = np.cos(2.0 * np.pi * np.arange(8) / 8)
    waves = np.hypot(np.fft.fftfreq(8, 1 / 8)[:, None], np.arange(5))
    waves[0, 0] = 0.5
    gap = 1.0 - x[:, None] * x
    tight = {"load": load, "tolerance": 1e-12}
    value = solve_flat(SurfaceFilter(1.0 / waves), gap, np.ones((8, 8)), **tight).unwrap()
    np.testing.assert_allclose(value, value.T, atol=1e-9 * load)
    assert np.sum(value) == pytest.approx(load, rel=1e-12)
