"""The matrix-free stiffness against the sum of the matrices of its elements."""

import numpy as np
import pytest

from multiscale.micro import Surface
from multiscale.micro.elastic.stiffness import stiffness_operator
from multiscale.micro.layer import GraphMesh, graded_planes

LAYERS = 3


def graph_mesh(points, size=(1.0, 0.7), slope=0.3):
    rng = np.random.default_rng(seed=11)
    heights = slope * min(np.divide(size, points)) * rng.uniform(-0.5, 0.5, points)
    return GraphMesh(Surface(heights, size), graded_planes(0.5, LAYERS, 0.05))


def test_planes_grow_from_the_given_top_thickness_to_the_whole_depth():
    planes = graded_planes(2.0, 10, 0.05)
    thickness = np.diff(planes)
    assert planes[0] == 0.0
    assert planes[-1] == 2.0
    assert thickness[-1] == pytest.approx(0.05)
    np.testing.assert_allclose(thickness[:-1] / thickness[1:], thickness[0] / thickness[1])


def element_stiffness(corners, lame, shear, mean_dilatation):
    """Stiffness of one trilinear hexahedron from its strain matrices, corner by corner."""
    corner = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)
    point = 0.5 + (corner - 0.5) / np.sqrt(3.0)
    strains, volumes, weights = [], [], []
    for p in point:
        value = np.where(corner, p, 1.0 - p)
        slope = np.where(corner, 1.0, -1.0)
        local = np.stack([slope[:, k] * np.prod(np.delete(value, k, 1), axis=1) for k in range(3)])
        jacobian = local @ corners
        gradient = np.linalg.solve(jacobian, local)  # (3, 8)
        strain = np.zeros((3, 3, 8, 3))
        for i in range(3):
            for j in range(3):
                strain[i, j, :, i] += 0.5 * gradient[j]
                strain[i, j, :, j] += 0.5 * gradient[i]
        strains.append(strain.reshape(3, 3, 24))
        volumes.append(gradient.T.ravel())
        weights.append(np.linalg.det(jacobian) / 8.0)
    mean = np.average(volumes, axis=0, weights=weights)
    stiffness = np.zeros((24, 24))
    for strain, volume, weight in zip(strains, volumes, weights, strict=True):
        divergence = mean if mean_dilatation else volume
        deviator = strain - np.eye(3)[:, :, None] * volume / 3.0
        stiffness += weight * 2.0 * shear * np.einsum("ijm,ijn->mn", deviator, deviator)
        stiffness += weight * (lame + 2.0 * shear / 3.0) * np.outer(divergence, divergence)
    return stiffness


@pytest.mark.parametrize(
    ("points", "layered"),
    [
        pytest.param((4, 6), False, id="smaller-than-a-batch"),
        pytest.param((4, 2), True, id="layers"),
        pytest.param((6, 1), False, id="plane-strain"),
        pytest.param((1, 34), True, id="plane-strain-across"),
        pytest.param((2, 38), False, id="with-a-remainder"),
        pytest.param((1, 64), False, id="two-batches"),
    ],
)
@pytest.mark.parametrize("mean_dilatation", [False, True], ids=["plain", "b-bar"])
def test_operator_sums_the_stiffness_of_its_elements(points, mean_dilatation, layered):
    mesh = graph_mesh(points)
    (nx, ny, layers), (dx, dy) = mesh.shape, mesh.surface.spacing
    rng = np.random.default_rng(seed=12)
    moduli = rng.uniform(1.0, 50.0, (2, layers) if layered else (2, nx, layers, ny))
    lame, shear = np.broadcast_to(
        moduli[:, None, :, None] if layered else moduli, (2, nx, layers, ny)
    )
    u = rng.standard_normal((nx, layers, 3, ny))
    whole = np.concatenate([np.zeros((nx, 1, 3, ny)), u], axis=1)
    forces = np.zeros_like(whole)
    for i, layer, j in np.ndindex(nx, layers, ny):
        nodes = [
            ((i + a) % nx, layer + c, (j + b) % ny) for a in (0, 1) for b in (0, 1) for c in (0, 1)
        ]
        corners = np.array(
            [
                (
                    (i + a) * dx,
                    (j + b) * dy,
                    mesh.planes[layer + c]
                    + mesh.map_factor[layer + c] * mesh.surface.heights[(i + a) % nx, (j + b) % ny],
                )
                for a in (0, 1)
                for b in (0, 1)
                for c in (0, 1)
            ]
        )
        matrix = element_stiffness(corners, lame[i, layer, j], shear[i, layer, j], mean_dilatation)
        local = matrix @ np.concatenate([whole[x, z, :, y] for x, z, y in nodes])
        for k, (x, z, y) in enumerate(nodes):
            forces[x, z, :, y] += local[3 * k : 3 * k + 3]
    result = stiffness_operator(mesh, *moduli, mean_dilatation=mean_dilatation)(u)
    assert np.max(np.abs(result - forces[:, 1:])) < 1e-13 * np.max(np.abs(forces))
