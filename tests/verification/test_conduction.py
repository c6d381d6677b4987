"""Conductance of a rough interface by its stiffness, and by conduction through its spots."""

import numpy as np
import pyamg
import pytest
from scipy.sparse import csr_array
from scipy.sparse.linalg import cg
from skfem import Basis, BilinearForm, ElementHex1, MeshHex
from skfem.helpers import dot, grad

from multiscale.micro import Path, solve_cell
from multiscale.surfaces import Surface, rms_height
from tests.support import flat_cell, rough_square

LENGTH, YOUNG, NU = 4e-4, 210e9, 0.3  # m, Pa
CONTACT_MODULUS = YOUNG / (1.0 - NU**2)


@BilinearForm
def conduct(u, v, w):
    return dot(grad(u), grad(v))


POINTS = 32


@pytest.fixture(scope="module")
def half_space():
    """Conductance of hexahedra that are finest at the face, with periodic sides; its depth, m."""
    m = 2 * POINTS
    h, depth, step = LENGTH / m, [0.0], LENGTH / m
    while depth[-1] < LENGTH:
        depth.append(depth[-1] + step)
        step = min(1.3 * step, LENGTH / 8)
    mesh = MeshHex.init_tensor(*[np.linspace(0.0, LENGTH, m + 1)] * 2, np.array(depth))
    i, j = np.round(mesh.p[:2] / h).astype(int) % m
    layer = np.abs(mesh.p[2][:, None] - depth).argmin(axis=1)
    periodic = csr_array((np.ones(i.size), (np.arange(i.size), (layer * m + i) * m + j)))
    matrix = conduct.assemble(Basis(mesh, ElementHex1()))
    return csr_array(periodic.T @ matrix @ periodic), depth[-1]


def constriction(half_space, touching):
    """Resistance per area of spots on a half-space of unit conductivity, m: a square each.

    A square has two elements along its side; the flux at the far end is even.
    """
    (matrix, depth), m = half_space, 2 * POINTS
    nearest = np.floor(np.arange(m) / 2 + 0.5).astype(int) % POINTS
    spots = np.flatnonzero(touching[np.ix_(nearest, nearest)])
    free = np.setdiff1d(np.arange(matrix.shape[0]), spots)
    flux = np.zeros(matrix.shape[0])
    flux[-m * m :] = (LENGTH / m) ** 2
    inner = csr_array(matrix[free][:, free])
    levels = pyamg.smoothed_aggregation_solver(inner)
    potential = np.zeros(flux.size)
    potential[free], unsolved = cg(inner, flux[free], rtol=1e-8, M=levels.aspreconditioner())
    assert not unsolved
    return potential[-m * m :].mean() - depth


@pytest.mark.slow
def test_spots_conduct_by_the_stiffness_of_the_interface(half_space):
    """Within 2 % at three pressures: h = 2 K k / E*, of a half-space on a perfect conductor."""
    rough = rough_square(POINTS, 2e-4, 1e-4, 0.02, seed=1, size=LENGTH)
    surface = Surface(4e-7 / rms_height(rough) * rough.heights, rough.size)
    cell = flat_cell(surface, YOUNG, NU)
    for pressure in (4e7, 1e8, 2e8):
        around = pressure * np.array([0.99, 1.0, 1.01])
        response = solve_cell(cell, Path(pressure=tuple(around)), keep_fields=True)
        gap = np.ravel(response["mean_gap"].values)
        stiffness = -(around[2] - around[0]) / (gap[2] - gap[0])
        touching = np.squeeze(response["pressure"].values)[1] > 0.0
        expected = CONTACT_MODULUS / (2.0 * stiffness)
        assert constriction(half_space, touching) == pytest.approx(expected, rel=0.02)
