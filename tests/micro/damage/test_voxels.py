"""The matrix-free stiffness of voxels against assembled bricks, and its inverse."""

import numpy as np
import pytest

from multiscale.executors import threads
from multiscale.micro.damage.voxels import VoxelOperator
from tests.micro.elastic.test_stiffness import element_stiffness

EDGES = (0.3, 0.5, 0.2)
SHAPES = [(4, 3, 5), (5, 4, 2), (1, 4, 3), (3, 1, 1), (2, 2, 1)]


def assembled(lame, shear, u):
    """Add up bricks with a stiffness by the strain matrices of hexahedra."""
    n = lame.shape
    corners = np.array(list(np.ndindex(2, 2, 2))) * EDGES
    by_lame, by_shear = (
        element_stiffness(corners, *moduli, mean_dilatation=False).reshape(2 * (2, 2, 2, 3))
        for moduli in ((1.0, 0.0), (0.0, 1.0))
    )
    force = np.zeros_like(u)
    for brick in np.ndindex(n):
        nodes = {
            corner: tuple((i + a) % m for i, a, m in zip(brick, corner, n, strict=True))
            for corner in np.ndindex(2, 2, 2)
        }
        total = np.zeros((2, 2, 2, 3))
        for corner, node in nodes.items():
            total[corner] = u[(slice(None), *node)]
        matrix = lame[brick] * by_lame + shear[brick] * by_shear
        answer = np.einsum("abcidefj,defj->abci", matrix, total)
        for corner, node in nodes.items():
            force[(slice(None), *node)] += answer[corner]
    return force


@pytest.fixture
def rng():
    return np.random.default_rng(seed=5)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_forces_equal_assembled_bricks(shape, rng):
    lame, shear = rng.uniform(0.0, 2.0, (2, *shape))
    lame.flat[0] = shear.flat[0] = 0.0  # a void
    u = rng.normal(size=(3, *shape))
    force = VoxelOperator(lame, shear, EDGES).forces(u)
    np.testing.assert_allclose(force, assembled(lame, shear, u), atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_mean_stress_is_the_transpose_of_the_forces_of_a_mean_strain(shape, rng):
    lame, shear = rng.uniform(0.1, 2.0, (2, *shape))
    operator, u = VoxelOperator(lame, shear, EDGES), rng.normal(size=(3, *shape))
    volume = np.prod(EDGES) * np.prod(shape)
    for strain in np.eye(6):
        work = np.vdot(u, operator.forces(np.zeros_like(u), strain))
        assert volume * operator.mean_stress(u, np.zeros(6)) @ strain == pytest.approx(
            work, abs=1e-13
        )
    uniform = operator.mean_stress(np.zeros_like(u), np.eye(6)[0])
    expected = [np.mean(lame + 2.0 * shear), lame.mean(), lame.mean(), 0.0, 0.0, 0.0]
    np.testing.assert_allclose(uniform, expected, atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_preconditioner_inverts_the_stiffness_of_a_uniform_box(shape, rng):
    operator = VoxelOperator(np.full(shape, 1.3), np.full(shape, 0.7), EDGES)
    u = rng.normal(size=(3, *shape))
    expected = u - u.mean(axis=(1, 2, 3), keepdims=True)
    np.testing.assert_allclose(operator.precondition(operator.forces(u)), expected, atol=1e-12)


def test_threads_do_not_change_the_forces(rng):
    lame, shear = rng.uniform(0.1, 2.0, (2, 7, 4, 6))
    operator, u = VoxelOperator(lame, shear, EDGES), rng.normal(size=(3, 7, 4, 6))
    with threads(1):
        force = operator.forces(u)
    with threads(2):
        np.testing.assert_allclose(operator.forces(u), force, rtol=1e-12, atol=1e-14)
