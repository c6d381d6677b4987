"""The matrix-free stiffness against the stiffness that scikit-fem assembles."""

import numpy as np
import pytest
from skfem import Basis, ElementHex1

from multiscale.errors import CaseError
from multiscale.fe.elasticity import assemble_elasticity
from multiscale.micro import Surface
from multiscale.micro.elastic.stiffness import stiffness_operator
from multiscale.micro.layer import GraphMesh, graded_planes

LAYERS = 3


def graph_mesh(points, size=(1.0, 0.7), slope=0.3):
    rng = np.random.default_rng(seed=11)
    heights = slope * min(np.divide(size, points)) * rng.uniform(-0.5, 0.5, points)
    return GraphMesh(Surface(heights, size), graded_planes(0.5, LAYERS, 0.05))


def scikit_fem_forces(mesh, lame, shear, u):
    """Unfold the periodic displacement, apply the assembled stiffness, fold the forces."""
    hexahedra = mesh.hexahedra()
    nx, ny, _ = mesh.shape
    basis = Basis(hexahedra, ElementHex1(), intorder=3)  # 2 x 2 x 2 Gauss points
    lateral = [
        np.rint(hexahedra.p[k] / step).astype(int) % n
        for k, step, n in zip(range(2), mesh.surface.spacing, (nx, ny), strict=True)
    ]
    flat = hexahedra.p[2] / (1.0 + mesh.surface.heights[tuple(lateral)] / mesh.planes[-1])
    plane = np.searchsorted(mesh.planes, flat - 1e-9)
    whole = np.concatenate([np.zeros((nx, 1, 3, ny)), u], axis=1)
    values = whole[lateral[0], plane, :, lateral[1]]
    layer = plane[hexahedra.t].min(axis=0)
    stiffness = assemble_elasticity(basis, lame[layer], shear[layer])
    forces = (stiffness @ values.ravel()).reshape(-1, 3)
    folded = np.zeros_like(whole)
    np.add.at(folded, (lateral[0], plane, slice(None), lateral[1]), forces)
    return folded[:, 1:]


@pytest.mark.parametrize(
    "points",
    [
        pytest.param((8, 8), id="smaller-than-a-batch"),
        pytest.param((4, 2), id="two-points-across"),
        pytest.param((6, 1), id="plane-strain"),
        pytest.param((1, 34), id="plane-strain-across"),
        pytest.param((4, 38), id="with-a-remainder"),
        pytest.param((6, 64), id="two-batches"),
    ],
)
@pytest.mark.parametrize("layered", [False, True], ids=["uniform", "layered"])
def test_operator_agrees_with_scikit_fem(points, layered):
    mesh = graph_mesh(points)
    lame = np.array([1.0, 3.0, 0.5]) if layered else np.full(LAYERS, 1.2)
    shear = np.array([0.7, 2.0, 1.0]) if layered else np.full(LAYERS, 0.8)
    u = np.random.default_rng(seed=3).standard_normal((points[0], LAYERS, 3, points[1]))

    expected = scikit_fem_forces(mesh, lame, shear, u)
    found = stiffness_operator(mesh, lame, shear)(u)

    assert np.max(np.abs(found - expected)) < 1e-13 * np.max(np.abs(expected))


def test_operator_is_symmetric():
    mesh = graph_mesh((16, 10))
    apply = stiffness_operator(mesh, np.ones(LAYERS), np.ones(LAYERS))
    rng = np.random.default_rng(seed=5)
    u, v = rng.standard_normal((2, 16, LAYERS, 3, 10))
    assert np.vdot(v, apply(u)) == pytest.approx(np.vdot(u, apply(v)), rel=1e-12)


def test_an_odd_number_of_points_is_refused_with_the_next_even_one():
    with pytest.raises(CaseError, match="got 5 x 8; resample the surface to 6 x 8"):
        GraphMesh(Surface(np.zeros((5, 8)), (1.0, 1.0)), np.linspace(0.0, 1.0, 3))


def test_a_valley_below_the_base_is_refused():
    heights = np.zeros((4, 4))
    heights[1, 1] = -1.1
    with pytest.raises(CaseError, match=r"folds over: its lowest valley is 1\.1 m"):
        GraphMesh(Surface(heights, (1.0, 1.0)), np.linspace(0.0, 1.0, 3))


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


@pytest.mark.parametrize("mean_dilatation", [False, True], ids=["plain", "b-bar"])
def test_operator_sums_the_stiffness_of_its_elements(mean_dilatation):
    mesh = graph_mesh((4, 6))
    (nx, ny, layers), (dx, dy) = mesh.shape, mesh.surface.spacing
    rng = np.random.default_rng(seed=12)
    lame, shear = rng.uniform(1.0, 50.0, (2, nx, layers, ny))
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
    found = stiffness_operator(mesh, lame, shear, mean_dilatation=mean_dilatation)(u)
    assert np.max(np.abs(found - forces[:, 1:])) < 1e-13 * np.max(np.abs(forces))
