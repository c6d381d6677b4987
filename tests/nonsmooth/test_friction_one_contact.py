"""The exact solver of one contact, the projection and the residuals of the law."""

import numpy as np
import pytest

from multiscale.nonsmooth.coulomb import natural_map, project_friction_cone
from multiscale.nonsmooth.friction_methods import solve_one_contact
from tests.support import alart_curnier


def test_an_opening_contact_carries_nothing():
    assert solve_one_contact(np.eye(3), 0.1, 5.0, -3.0, 0.5) == (0.0, 0.0, 0.0)


def test_a_slow_contact_sticks():
    block = np.diag([2.0, 4.0, 5.0])
    r = solve_one_contact(block, -2.0, 0.4, -0.5, 0.9)
    np.testing.assert_allclose(r, [1.0, -0.1, 0.1], rtol=1e-15)


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.7])
def test_a_fast_contact_slides_against_its_velocity(friction):
    # W = diag(w, w, w): r_N = -q_N / w, and friction opposes q_T
    r = solve_one_contact(0.5 * np.eye(3), -1.0, 3.0, 4.0, friction)
    np.testing.assert_allclose(r, [2.0, -1.2 * friction, -1.6 * friction], rtol=1e-14)


@pytest.mark.parametrize("rank", [1, 2, 3])
@pytest.mark.parametrize("friction", [0.0, 0.1, 1.0, 5.0])
def test_the_exact_solver_satisfies_the_law_for_random_blocks(friction, rank):
    rng = np.random.default_rng(seed=rank)
    for _ in range(300):
        G = rng.normal(size=(3, rank)) * 10.0 ** rng.uniform(-3.0, 3.0)
        W = G @ G.T
        q = G @ rng.normal(size=rank)  # within the range of W, so that an answer exists
        r = np.array(solve_one_contact(W, *q, friction))
        u = W @ r + q
        step = 3.0 / np.trace(W)
        error = natural_map(u[:, None], r[:, None], np.array([friction]), step) / step
        assert np.linalg.norm(error) <= 2e-7 * np.linalg.norm(q)
        if rank == 3:
            assert np.linalg.norm(error) <= 1e-10 * np.linalg.norm(q)


def test_projections_split_a_vector_into_orthogonal_parts():
    rng = np.random.default_rng(seed=1)
    for dim in (2, 3):
        vector, friction = rng.normal(size=(dim, 500)), rng.uniform(0.0, 3.0, 500)
        friction[:20] = 0.0
        inside = project_friction_cone(vector, friction)
        polar = vector - inside
        length = np.linalg.norm(inside[1:], axis=0)
        assert np.all(length <= friction * inside[0] * (1.0 + 1e-14) + 1e-15)
        assert np.all(inside[0] >= 0.0)
        np.testing.assert_allclose(np.sum(inside * polar, axis=0), 0.0, atol=1e-14)
        dual = vector + project_friction_cone(-vector, friction)  # Moreau's decomposition
        assert np.all(dual[0] >= friction * np.linalg.norm(dual[1:], axis=0) - 1e-14)
        np.testing.assert_allclose(np.sum(dual * (vector - dual), axis=0), 0.0, atol=1e-13)
        np.testing.assert_allclose(project_friction_cone(inside, friction), inside, atol=1e-15)
        # the polar part is minus a vector of the dual cone
        assert np.all(-polar[0] >= friction * np.linalg.norm(polar[1:], axis=0) - 1e-14)


def test_a_contact_without_friction_projects_onto_its_normal():
    vector = np.array([[-1.0, 2.0, -1.0], [0.0, 3.0, 2.0]])
    expected = np.array([[0.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(project_friction_cone(vector, 0.0), expected)


def test_both_residuals_vanish_together():
    rng = np.random.default_rng(seed=2)
    mu = rng.uniform(0.0, 2.0, 50)
    mu[:5] = 0.0
    for friction in mu:
        G = rng.normal(size=(3, 3))
        q = rng.normal(size=3)
        x = np.array(solve_one_contact(G @ G.T, *q, friction))
        v = (G @ G.T @ x + q)[:, None]
        for residual in (natural_map, alart_curnier):
            assert np.linalg.norm(residual(v, x[:, None], np.array([friction]))) < 1e-9
