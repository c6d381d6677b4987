"""The kernels of large strain against the pointwise laws, differences and homogeneous states."""

import numpy as np
import pytest
from skfem import Basis, ElementHex1

from multiscale.laws.bulk import J2, NeoHookean, Prony
from multiscale.micro import FiniteCell, Surface
from multiscale.micro.finite.large_strain import LargeStrainLayer
from multiscale.micro.finite.preconditioner import mixed_reference
from multiscale.micro.layer import GraphMesh
from tests.micro.elastic.test_stiffness import graph_mesh

LAYERS = 3
E, NU = 1.0, 0.3
LAWS = {
    "neo-Hookean": NeoHookean(E, NU),
    "elastic J2": J2(E, NU, 10.0),
    "linear hardening": J2(E, NU, 0.005, 0.05),
    "saturation": J2(E, NU, 0.005, 0.01, saturation_stress=0.02, saturation_rate=5.0),
    "Prony": Prony(E, NU, (0.4, 0.2), (1.0, 10.0)),
}
MIXED = pytest.mark.parametrize("mixed", [False, True], ids=["points", "pressures"])
LAW = pytest.mark.parametrize("law", [pytest.param(law, id=name) for name, law in LAWS.items()])


def noise(shape, seed, size=0.004):
    return size * np.random.default_rng(seed).standard_normal(shape)


def with_pressures(respond, u, mixed):
    """A displacement, with the pressures that meet its changes of volume if they are unknowns."""
    if not mixed:
        return u
    whole, unit = (
        np.concatenate([c * u, 0.0 * u[:, :, :1] + d], axis=2) for c, d in ((1, 0), (0, 1))
    )
    for _ in range(3):  # the tangent is in single precision
        response = respond(whole)
        whole[:, :, 3] -= response.force[:, :, 3] / response.tangent(unit)[:, :, 3]
    return whole


def loaded(mesh, law, mixed, u):
    """The response of a body after a first deformation."""
    body = LargeStrainLayer(mesh, law, mixed)
    respond = body.begin(body.rest(), 0.5)
    return body.begin(respond(with_pressures(respond, u, mixed)).state(), 2.0)


@pytest.mark.parametrize(
    "points",
    [
        pytest.param((6, 8), id="less than a batch"),
        pytest.param((4, 38), id="with a remainder"),
        pytest.param((6, 1), id="plane strain"),
        pytest.param((1, 8), id="plane strain across"),
    ],
)
@MIXED
@LAW
def test_the_tangent_is_the_derivative_of_the_forces(law, mixed, points):
    mesh = graph_mesh(points)
    shape = (points[0], LAYERS, 3, points[1])
    u = noise(shape, 1)
    respond = loaded(mesh, law, mixed, u)
    u = with_pressures(respond, u + noise(shape, 3, 0.003), mixed)
    v = noise(u.shape, 2, 1.0)
    result = respond(u).tangent(v)
    ahead, behind = (respond(u + s * v).force for s in (2e-7, -2e-7))
    difference = (ahead - behind) / 4e-7
    assert np.max(np.abs(result - difference)) < 1e-6 * np.max(np.abs(difference))


def gauss_gradients(mesh, u):
    """Deformation gradients (3, 3, elements, points) and weights from scikit-fem."""
    hexahedra = mesh.hexahedra()
    nx, ny, _ = mesh.shape
    basis = Basis(hexahedra, ElementHex1(), intorder=3)
    i, j = (
        np.rint(hexahedra.p[k] / step).astype(int) % n
        for k, step, n in zip(range(2), mesh.surface.spacing, (nx, ny), strict=True)
    )
    flat = hexahedra.p[2] / (1.0 + mesh.surface.heights[i, j] / mesh.planes[-1])
    plane = np.searchsorted(mesh.planes, flat - 1e-9)
    whole = np.concatenate([np.zeros((nx, 1, 3, ny)), u], axis=1)
    values = whole[i, plane, :, j].T
    gradient = np.array([basis.interpolate(component).grad for component in values])
    return gradient + np.eye(3)[:, :, None, None], basis.dx, basis, (i, plane, j)


def stresses(law, F, state, weight, mixed):
    """First Piola-Kirchhoff stresses by the pointwise law, F-bar by the element's mean."""
    shape = law.respond_shape(F, state)
    det = np.linalg.det(np.moveaxis(F, (0, 1), (-2, -1)))
    inverse = np.moveaxis(np.linalg.inv(np.moveaxis(F, (0, 1), (-2, -1))), (-1, -2), (0, 1))
    ratio = det
    if mixed:
        mean = np.sum(weight * det, axis=-1) / np.sum(weight, axis=-1)
        ratio = np.broadcast_to(mean[:, None], det.shape)
    return shape.stress + law.respond_volume(ratio)[0] * det * inverse, shape.state


@MIXED
@LAW
def test_forces_equal_the_pointwise_law(law, mixed):
    mesh, shape = graph_mesh((4, 38)), (4, LAYERS, 3, 38)
    first, u = noise(shape, 1), noise(shape, 2)
    respond = loaded(mesh, law, mixed, first)

    at_first, at_second = law, law
    if isinstance(law, Prony):
        at_first, at_second = law.over(0.5), law.over(2.0)
    F, weight, basis, nodes = gauss_gradients(mesh, first)
    state = at_first.respond_shape(F, law.initial_state(F.shape[2:])).state
    F, *_ = gauss_gradients(mesh, u)
    stress, _ = stresses(at_second, F, state, weight, mixed)

    expected = np.zeros((4, LAYERS + 1, 3, 38))
    i, plane, j = nodes
    for a in range(8):
        grad = basis.basis[a][0].grad
        force = np.einsum("ijeq,jeq,eq->ie", stress, grad, weight)
        vertex = basis.mesh.t[a]
        np.add.at(expected, (i[vertex], plane[vertex], slice(None), j[vertex]), force.T)
    entry = respond(with_pressures(respond, u, mixed)).force
    scale = np.max(np.abs(expected))
    assert np.max(np.abs(entry[:, :, :3] - expected[:, 1:])) < 1e-12 * scale
    assert np.all(np.abs(entry[:, :, 3:]) < 1e-12 * scale)


def test_elements_that_fold_are_reported():
    mesh = graph_mesh((6, 8))
    body = LargeStrainLayer(mesh, LAWS["linear hardening"], True)
    u = np.zeros(body.shape)
    u[2, -1, 2, 3] = -1.0
    response = body.begin(body.rest(), 0.0)(u)
    assert not response.least_dilatation > 0.0
    assert np.all(np.isfinite(response.force))


@pytest.mark.parametrize("nu", [0.3, 0.4999])
def test_the_flat_cell_with_pressures_is_inverted(nu):
    cell = FiniteCell(Surface(np.zeros((6, 8)), (1.0, 0.7)), 0.5, LAYERS, J2(E, nu, 10.0))
    mesh = GraphMesh(cell.surface, cell.planes)
    body = LargeStrainLayer(mesh, cell.law, True)
    u = noise(body.shape, 6)
    force = body.begin(body.rest(), 0.0)(0.0 * u).tangent(u)
    result = mixed_reference(cell, mesh).solve(force, None)
    assert np.max(np.abs(result - u)) < 1e-5 * np.max(np.abs(u))  # single precision


@pytest.mark.slow
def test_pressures_do_not_lock():
    """A coarse, nearly incompressible block answers a wave of pressure like a fine block."""
    answers = {}
    for layers, mixed in ((6, True), (6, False), (14, True)):
        n = 2 * layers
        flat = Surface(np.zeros((n, 1)), (1.0, 1.0 / n))
        mesh = GraphMesh(flat, np.linspace(0.0, 0.5, layers + 1))
        law = NeoHookean(1.0, 0.4999)
        body = LargeStrainLayer(mesh, law, mixed)
        tangent = body.begin(None, 0.0)(np.zeros(body.shape)).tangent
        matrix = np.array([tangent(e).ravel() for e in unit_vectors(body.shape)])
        load = np.zeros(body.shape)
        load[:, -1, 2, 0] = np.cos(2.0 * np.pi * np.arange(n) / n) / n * flat.spacing[1]
        fixed = np.arange(load.size) % body.shape[2] != 1  # plane strain
        moved = np.linalg.solve(matrix[np.ix_(fixed, fixed)], load.ravel()[fixed])
        answers[layers, mixed] = float(load.ravel()[fixed] @ moved) / flat.spacing[1]
    assert answers[6, True] == pytest.approx(answers[14, True], rel=0.1)
    assert answers[6, False] < 0.8 * answers[14, True]


def unit_vectors(shape):
    for k in range(int(np.prod(shape))):
        unit = np.zeros(shape)
        unit.flat[k] = 1.0
        yield unit
