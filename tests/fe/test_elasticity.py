"""Finite elements: tangents, uniform strain, locking, and bodies turned inside out."""

import numpy as np
import pytest
from skfem import MeshHex, MeshQuad, MeshTet, MeshTri

from multiscale.fe.elasticity import (
    displacement_basis,
    elastic_matrix,
    element_response,
    prepare_elements,
)
from multiscale.laws.bulk import J2, Elastic, NeoHookean
from multiscale.macro import Body, FiniteAssembly, solve_contact
from tests.contact_scenes import block, distorted

MESHES = [
    pytest.param(MeshTri, id="tri"),
    pytest.param(MeshQuad, id="quad"),
    pytest.param(MeshTet, id="tet"),
    pytest.param(MeshHex, id="hex"),
]


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize(
    "law", [NeoHookean(2.0, 0.3), J2(2.0, 0.3, 0.05, 0.1)], ids=["rubber", "metal"]
)
def test_the_element_tangent_is_the_derivative_of_the_force(kind, law):
    mesh = distorted(kind)
    elements = prepare_elements(mesh)
    rng = np.random.default_rng(seed=1)
    u, way = rng.normal(scale=[[0.02], [1.0]], size=(2, elements.size))
    state = law.initial_state(elements.weight.shape)
    _, tangent, _, smallest = element_response(elements, law, u, state)
    ahead, back = (element_response(elements, law, u + s * way, state)[0] for s in (1e-7, -1e-7))
    assert smallest > 0.0
    difference = (ahead - back) / 2e-7
    np.testing.assert_allclose(tangent @ way, difference, atol=1e-6 * np.abs(difference).max())


@pytest.mark.parametrize("kind", [MeshTri, MeshTet])
def test_elastic_elements_equal_the_scalar_forms(kind):
    mesh = distorted(kind)
    elements = prepare_elements(mesh)
    law = Elastic(2.0, 0.3)
    rest = law.initial_state(elements.weight.shape)
    response = element_response(elements, law, np.zeros(elements.size), rest)[1]
    expected = elastic_matrix(displacement_basis(mesh, mesh.elem()), Elastic(2.0, 0.3))
    assert abs(response - expected).max() < 1e-13


@pytest.mark.parametrize("kind", MESHES)
def test_a_uniform_strain_is_in_equilibrium_inside(kind):
    mesh = distorted(kind)
    elements = prepare_elements(mesh)
    gradient = np.random.default_rng(seed=2).normal(scale=0.1, size=(mesh.dim(),) * 2)
    law = NeoHookean(2.0, 0.3)
    rest = law.initial_state(elements.weight.shape)
    force, *_ = element_response(elements, law, (gradient @ mesh.p).T.ravel(), rest)
    inside = np.setdiff1d(np.arange(mesh.p.shape[1]), mesh.boundary_nodes())
    np.testing.assert_allclose(force.reshape(-1, mesh.dim())[inside], 0.0, atol=1e-14)


def test_a_body_that_is_turned_inside_out_is_noticed():
    elements = prepare_elements(distorted(MeshQuad))
    u = np.zeros(elements.size)
    u[0] = 2.0
    law = NeoHookean(1.0, 0.3)
    rest = law.initial_state(elements.weight.shape)
    force, _, _, smallest = element_response(elements, law, u, rest)
    assert smallest <= 0.0
    assert np.all(np.isnan(force))
    # up to there the smallest volume ratio is the ratio of the most compressed point
    mild = element_response(elements, law, 1e-3 * u, rest)[3]
    milder = element_response(elements, law, 5e-4 * u, rest)[3]
    assert mild < milder < 1.0


@pytest.mark.parametrize("kind", [MeshQuad, MeshHex])
def test_an_incompressible_body_does_not_lock(kind):
    # a cantilever in bending hardly notices Poisson's ratio; with locking it stiffens tenfold
    d = kind().dim()
    mesh = block(kind, (16, *(1,) * (d - 2), 4), (0.0,) * d, (8.0, *(1.0,) * (d - 1)))
    tips = []
    for nu in (0.3, 0.4999):
        shear = {"right": (*(0.0,) * (d - 1), 1e-4)}
        fixed = {"left": (0.0,) * d}
        if d == 3:  # plane strain
            fixed |= {"front": (None, 0.0, None), "back": (None, 0.0, None)}
        body = Body(mesh, Elastic(1.0 - nu**2, nu), fixed, shear)
        step = solve_contact(FiniteAssembly({"beam": body}))[-1].unwrap()
        tips.append(step.displacement["beam"][-1].max())
    assert tips[1] == pytest.approx(tips[0], rel=0.05)
