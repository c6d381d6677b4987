"""Krylov methods on small matrices: exact after as many steps as there are unknowns."""

import numpy as np
import pytest

from multiscale.numerics.krylov import Anderson, conjugate_gradients


@pytest.fixture
def matrix():
    root = np.random.default_rng(seed=1).standard_normal((6, 6))
    return root @ root.T + np.eye(6)


def test_conjugate_gradients_end_after_as_many_steps_as_unknowns(matrix):
    b, inverse = np.arange(1.0, 7.0), 1.0 / matrix.diagonal()
    x, steps = conjugate_gradients(
        lambda v: matrix @ v, b, lambda r: inverse * r, goal=1e-9, limit=8
    )
    np.testing.assert_allclose(x, np.linalg.solve(matrix, b), rtol=1e-8)
    assert steps <= 7


def test_first_iterate_is_relaxed_and_a_linear_map_ends_after_its_unknowns(matrix):
    matrix, b = matrix / np.linalg.norm(matrix, 2), np.arange(1.0, 7.0)
    x, anderson = np.zeros(6), Anderson(6, relaxation=0.4)
    for k in range(9):
        residual = b - matrix @ x
        x = anderson.next(x, x + residual, residual, float(np.linalg.norm(residual)))
        if k == 0:
            np.testing.assert_allclose(x, 0.4 * b, rtol=1e-14)
    np.testing.assert_allclose(x, np.linalg.solve(matrix, b), rtol=1e-4)


def test_a_restart_lies_between_the_last_iterate_and_its_image():
    x, image, anderson = np.array([1.0, 3.0, -2.0]), np.array([2.0, -4.0, 1.0]), Anderson(3)
    anderson.next(x, image, image - x, 1.0)
    restarted = anderson.next(x, image, image - x, 100.0)
    np.testing.assert_allclose(restarted, 0.5 * (x + image), rtol=1e-15)
