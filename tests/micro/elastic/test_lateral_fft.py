"""The lateral-FFT inverse of the flat cell, and the compliance of its surface."""

import numpy as np
import pytest

from multiscale.laws.bulk.bulk_law import lame_parameters
from multiscale.micro import Surface
from multiscale.micro.elastic.lateral_fft import factorise_flat_cell
from multiscale.micro.elastic.stiffness import stiffness_operator
from multiscale.micro.layer import GraphMesh, graded_planes


def flat_cell(points, size, layers, modulus, nu=0.3, mean_dilatation=False):
    surface = Surface(np.zeros(points), size)
    planes = graded_planes(0.5, layers, min(surface.spacing))
    lame, shear = lame_parameters(np.broadcast_to(modulus, layers), nu)
    apply = stiffness_operator(
        GraphMesh(surface, planes), lame, shear, mean_dilatation=mean_dilatation
    )
    inverse = factorise_flat_cell(
        points, surface.spacing, planes, lame, shear, mean_dilatation=mean_dilatation
    )
    return apply, inverse


@pytest.mark.parametrize(
    ("points", "size"),
    [
        pytest.param((16, 16), (1.0, 1.0), id="square"),
        pytest.param((12, 20), (1.0, 0.7), id="oblong"),
        pytest.param((32, 1), (1.0, 0.1), id="plane-strain"),
        pytest.param((1, 12), (0.1, 1.0), id="plane-strain-across"),
    ],
)
@pytest.mark.parametrize("contrast", [1.0, 1e4], ids=["uniform", "layered"])
def test_inverse_undoes_the_stiffness_of_the_flat_cell(points, size, contrast):
    apply, inverse = flat_cell(points, size, 6, np.geomspace(1.0, contrast, 6))
    u = np.random.default_rng(seed=1).standard_normal((points[0], 6, 3, points[1]))
    error = np.linalg.norm(inverse.solve(apply(u)) - u) / np.linalg.norm(u)
    assert error < 1e-12 * max(1.0, contrast)


@pytest.mark.parametrize(("nu", "tolerance"), [(0.49, 1e-11), (0.499, 1e-10)])
def test_inverse_of_a_nearly_incompressible_cell(nu, tolerance):
    apply, inverse = flat_cell((16, 12), (1.0, 0.7), 6, 1.0, nu, mean_dilatation=True)
    u = np.random.default_rng(seed=1).standard_normal((16, 6, 3, 12))
    error = np.linalg.norm(inverse.solve(apply(u)) - u) / np.linalg.norm(u)
    assert error < tolerance


def test_correcting_the_surface_force_in_between_is_solving_for_both_forces():
    _, inverse = flat_cell((16, 12), (1.0, 0.7), 5, 1.0)
    rng = np.random.default_rng(seed=2)
    force = rng.standard_normal((16, 5, 3, 12))
    added = rng.standard_normal((16, 3, 12))
    seen = []

    def correct(displacement):
        seen.append(displacement)
        return added

    result = inverse.solve(force, correct)
    np.testing.assert_allclose(seen[0], inverse.solve(force)[:, -1], atol=1e-11)
    both = force.copy()
    both[:, -1] += added
    np.testing.assert_allclose(result, inverse.solve(both), atol=1e-11)
    np.testing.assert_allclose(
        inverse.surface_response(added),
        inverse.solve(both)[:, -1] - inverse.solve(force)[:, -1],
        atol=1e-11,
    )
