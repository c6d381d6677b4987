"""All methods find the same motion; the hybrid solves all their problems and more."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from multiscale.bench.nonsmooth_scenes import block_tower, sphere_pile, wedged_block
from multiscale.nonsmooth import friction_interior_point as interior_point
from multiscale.nonsmooth.coulomb import verify_friction
from multiscale.nonsmooth.friction import FRICTION_METHODS, solve_friction
from multiscale.nonsmooth.friction_methods import linearise
from multiscale.nonsmooth.friction_problem import Progress, scale_friction
from tests.nonsmooth.friction_problems import (
    plane_stack,
    random_problem,
    random_stack,
)
from tests.support import alart_curnier


@pytest.mark.parametrize("method", sorted(FRICTION_METHODS))
@pytest.mark.parametrize("rank", [None, 40], ids=["full", "deficient"])
def test_every_method_finds_the_same_velocity_and_energy(method, rank):
    # deficient: 60 impulses, 40 of them independent; velocities are unique, impulses are not
    rng = np.random.default_rng(seed=3)
    W, q, mu = random_problem(20, rng, rank=rank, friction=0.1)
    reference = solve_friction(W, q, mu, tolerance=1e-11)
    result = solve_friction(W, q, mu, method=method)
    r, s = reference.unwrap(), result.unwrap()
    scale = np.linalg.norm(q)
    assert np.linalg.norm(W @ (r - s)) < 1e-6 * scale
    assert s @ (W @ s) == pytest.approx(r @ (W @ r), rel=1e-6)
    assert result.trail in ((method,), ())


@pytest.mark.parametrize("method", sorted(FRICTION_METHODS))
def test_a_verified_answer_of_one_method_starts_the_others_at_the_end(method):
    W, q, mu = random_problem(10, np.random.default_rng(seed=4))
    r = solve_friction(W, q, mu, tolerance=1e-11).unwrap()
    again = solve_friction(W, q, mu, method=method, start=r)
    assert again.converged
    assert len(again.residuals) == 2
    np.testing.assert_allclose(again.value, r, rtol=1e-8, atol=1e-10)


def test_without_friction_the_answer_solves_the_complementarity_problem():
    rng = np.random.default_rng(seed=5)
    W, q, _ = random_problem(30, rng)
    r = solve_friction(W, q, np.zeros(30), tolerance=1e-11).unwrap().reshape(-1, 3)
    A, b, x = W.toarray()[::3, ::3], q[::3], np.zeros(30)
    for _ in range(20000):  # projected Gauss-Seidel: slow and obviously right
        for i in range(30):
            x[i] = max(0.0, x[i] - (A[i] @ x + b[i]) / A[i, i])
        if np.linalg.norm(x - np.maximum(0.0, x - (A @ x + b))) < 1e-13:
            break
    np.testing.assert_allclose(r[:, 0], x, atol=1e-9)
    np.testing.assert_array_equal(r[:, 1:], 0.0)


def test_a_plane_problem_equals_the_same_problem_in_space():
    bodies = plane_stack(6, np.random.default_rng(seed=6), mass_ratio=100.0)
    W, q, mu = bodies.condensed()
    plane = solve_friction(W, q, mu, tolerance=1e-10).unwrap().reshape(-1, 2)
    n = mu.size
    full, load = np.zeros((n, 3, n, 3)), np.zeros((n, 3))
    full[:, :2, :, :2] = W.toarray().reshape(n, 2, n, 2)
    full[np.arange(n), 2, np.arange(n), 2] = 1.0
    load[:, :2] = q.reshape(n, 2)
    space = solve_friction(full.reshape(3 * n, 3 * n), load.ravel(), mu, tolerance=1e-10)
    moved = W @ (plane - space.unwrap().reshape(n, 3)[:, :2]).ravel()
    assert np.linalg.norm(moved) < 1e-7 * np.linalg.norm(q)


@pytest.mark.parametrize(
    "problem",
    [
        pytest.param(sphere_pile(30, np.random.default_rng(seed=1)), id="pile"),
        pytest.param(block_tower(5, np.random.default_rng(seed=1)), id="tower"),
        pytest.param(block_tower(6, np.random.default_rng(seed=1)), id="higher tower"),
        pytest.param(wedged_block(0.3), id="wedge slides"),
        pytest.param(wedged_block(1.5), id="wedge jams"),
        pytest.param(random_stack(7), id="stack"),
    ],
)
def test_bodies_in_contact_dissipate_energy_and_keep_their_balance(problem):
    W, q, mu = problem.condensed()
    r = solve_friction(W, q, mu).unwrap()
    assert verify_friction(W, q, mu, r).accepted
    # r . (q + u) / 2 is the energy that the impact adds: never positive
    assert r @ (q + 0.5 * (W @ r)) <= 1e-9 * abs(r @ q)


def test_most_of_a_few_stacks_are_solved():
    solved = [solve_friction(*random_stack(seed).condensed()).converged for seed in range(10)]
    assert sum(solved) >= 9


@pytest.mark.long
def test_99_percent_of_200_stacks_are_solved():
    solved = [solve_friction(*random_stack(seed).condensed()).converged for seed in range(200)]
    assert sum(solved) >= 198


def test_plane_stacks_with_mass_ratio_1e6_are_solved():
    for seed in range(5):
        rng = np.random.default_rng(seed=seed)
        bodies = plane_stack(10, rng, mass_ratio=1e6, push=0.6)
        assert solve_friction(*bodies.condensed()).converged


def test_history_has_a_time_for_every_residual_and_the_callback_sees_them():
    seen = []
    W, q, mu = random_stack(1).condensed()
    solution = solve_friction(W, q, mu, callback=lambda i, residual: seen.append((i, residual)))
    assert len(solution.seconds) == len(solution.residuals) == len(seen) + 1
    assert np.all(np.diff(solution.seconds) >= 0.0)
    assert [residual for _, residual in seen] == list(solution.residuals[:-1])
    assert solution.trail[0] == "gauss_seidel"


@pytest.mark.parametrize(
    "name",
    [
        "capsules-i100-1090", "confeti-ex13", "contrast1e8", "kaplas-tower", "one-object-499",
        "periodic-box", "spheres-i099", "stack20", "stack20-mass1e6",
    ],
)  # fmt: skip
def test_public_instances_are_solved(reference_data, name):
    data = np.load(reference_data / "friction" / f"{name}.npz")
    W = csr_array((data["data"], data["ind"], data["ptr"]), shape=tuple(data["shape"]))
    solution = solve_friction(W, data["q"], data["mu"])
    assert solution.converged
    assert verify_friction(W, data["q"], data["mu"], solution.value).accepted


def test_the_newton_matrix_is_the_derivative_of_the_residual():
    rng = np.random.default_rng(seed=8)
    u, r = rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    mu = rng.uniform(0.2, 2.0, 40)
    _, A, B = linearise(u, r, mu)
    h = 1e-7
    for du, dr in ((rng.normal(size=(40, 3)), 0.0 * r), (0.0 * u, rng.normal(size=(40, 3)))):
        ahead = linearise(u + h * du, r + h * dr, mu)[0]
        behind = linearise(u - h * du, r - h * dr, mu)[0]
        expected = np.einsum("iab,ib->ia", A, du) + np.einsum("iab,ib->ia", B, dr)
        np.testing.assert_allclose((ahead - behind) / (2.0 * h), expected, atol=1e-6)
    np.testing.assert_allclose(linearise(u, r, mu)[0], alart_curnier(u.T, r.T, mu).T, atol=1e-15)


@pytest.mark.parametrize(
    "bodies",
    [
        pytest.param(block_tower(3, np.random.default_rng(seed=9)), id="tower"),
        pytest.param(wedged_block(0.5), id="wedge"),
    ],
)
def test_an_interior_point_ends_as_fast_as_newton(bodies):
    # 6 to 8 steps; an error in De Saxcé's term leaves the answer right and doubles the path
    problem = scale_friction(*bodies.condensed())
    progress = Progress(problem, 1e-9)
    interior_point.friction_interior_point(problem, progress)
    assert progress.smallest <= 1e-9
    assert len(progress.residuals) <= 11


def test_a_step_of_the_interior_point_solves_the_linearised_equations():
    rng = np.random.default_rng(seed=11)
    lorentz, _ = interior_point.lorentz_problem(scale_friction(*wedged_block(0.5).condensed()))
    z, y = rng.normal(size=(8, 3)), rng.normal(size=(8, 3))
    for point in (z, y):
        point[:, 0] = 0.5 + np.hypot(point[:, 1], point[:, 2])
    g = rng.uniform(0.5, 1.0, 8)
    scaling, defect, direction = interior_point.linearise_cones(lorentz, (z, y, g))
    k, h = rng.normal(size=(8, 3)), rng.normal(size=8)
    (F, inverse, square), (dz, dy, dg) = scaling, direction(k, h)
    apply = interior_point.apply
    change = lorentz.respond(dz) - lorentz.velocity - np.column_stack([dg, dy[:, 1:]])
    np.testing.assert_allclose(change, -defect, atol=1e-10)
    np.testing.assert_allclose(z[:, 0] * dg + g * dz[:, 0], h, atol=1e-10)
    np.testing.assert_allclose(apply(F, dz) + apply(inverse, dy), k, atol=1e-10)
    np.testing.assert_allclose(apply(F, z), apply(inverse, y), atol=1e-12)
    np.testing.assert_allclose(F @ F, square, atol=1e-10)
