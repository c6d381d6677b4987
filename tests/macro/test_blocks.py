r"""Elastic blocks against exact solutions.

Manufactured solution on the unit cube with zero displacement on its surface:
:math:`u_x = s(x)s(y)s(z)`, :math:`u_y = u_z = 0`, :math:`s(x) = \sin \pi x`.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy import cos, pi, sin
from scipy.sparse.linalg import spsolve
from skfem import (
    Basis,
    ElementHex1,
    ElementHex2,
    ElementHexS2,
    ElementTetP1,
    ElementTetP2,
    ElementVector,
    LinearForm,
    MeshQuad,
    MeshTet,
)
from skfem.models.elasticity import lame_parameters, linear_elasticity

from multiscale.fe.elasticity import (
    displacement_basis,
    elastic_matrix,
    mode_stiffness,
)
from multiscale.fe.faces import face_operator
from multiscale.fe.mesh_file import box_mesh
from multiscale.laws.bulk import AnisotropicElastic, Elastic

E, NU = 2.5, 0.3
LAME, SHEAR = E * NU / ((1.0 + NU) * (1.0 - 2.0 * NU)), E / (2.0 * (1.0 + NU))


def held_and_free(basis):
    scalar = basis.get_dofs().all()
    fixed = np.concatenate([3 * scalar + i for i in range(3)])
    return fixed, np.setdiff1d(np.arange(3 * basis.N), fixed)


@pytest.mark.parametrize(
    "element",
    [
        pytest.param(ElementHex1(), id="hex8"),
        pytest.param(ElementHexS2(), id="hex20"),
        pytest.param(ElementHex2(), id="hex27"),
    ],
)
def test_a_linear_displacement_is_exact_on_a_distorted_mesh(element):
    mesh = box_mesh((2.0, 1.0, 1.5), (3, 2, 2), origin=(-1.0, 0.0, 0.2))
    inner = np.setdiff1d(np.arange(mesh.p.shape[1]), mesh.boundary_nodes())
    points = mesh.p.copy()
    points[:, inner] += np.random.default_rng(seed=3).uniform(-0.1, 0.1, (3, inner.size))
    mesh = type(mesh)(points, mesh.t)
    basis = displacement_basis(mesh, element)
    gradient = np.random.default_rng(seed=4).normal(size=(3, 3))
    exact = (gradient @ basis.doflocs).T.ravel()
    fixed, free = held_and_free(basis)
    K = elastic_matrix(basis, Elastic(E, NU))
    u = exact.copy()
    u[free] = spsolve(K[free][:, free].tocsc(), -K[free][:, fixed] @ exact[fixed])
    np.testing.assert_allclose(u, exact, atol=1e-13 * np.abs(exact).max())


def body_force(x):
    s, c = sin(pi * x), cos(pi * x)
    return np.stack(
        [
            (LAME + 4.0 * SHEAR) * pi**2 * s[0] * s[1] * s[2],
            -(LAME + SHEAR) * pi**2 * c[0] * c[1] * s[2],
            -(LAME + SHEAR) * pi**2 * c[0] * s[1] * c[2],
        ]
    )


def displacement_error(mesh, element):
    basis = displacement_basis(mesh, element)
    fine = Basis(mesh, element, intorder=6)
    load = np.zeros(3 * basis.N)
    for i in range(3):
        load[i::3] = LinearForm(lambda v, w, i=i: body_force(w.x)[i] * v).assemble(fine)
    free = held_and_free(basis)[1]
    u = np.zeros(3 * basis.N)
    u[free] = spsolve(elastic_matrix(basis, Elastic(E, NU))[free][:, free].tocsc(), load[free])
    x = np.asarray(fine.global_coordinates())
    error = (np.asarray(fine.interpolate(u[0::3])) - np.prod(sin(pi * x), axis=0)) ** 2
    error = error + sum(np.asarray(fine.interpolate(u[i::3])) ** 2 for i in (1, 2))
    return np.sqrt(np.sum(error * fine.dx))


@pytest.mark.parametrize(
    ("mesh", "element", "rate", "largest"),
    [
        pytest.param(box_mesh, ElementHex1(), 2.0, 1e-2, id="hex8"),
        pytest.param(box_mesh, ElementHex2(), 3.0, 5e-4, id="hex27", marks=pytest.mark.slow),
        pytest.param(MeshTet, ElementTetP1(), 2.0, 6e-2, id="tet4"),
        pytest.param(MeshTet, ElementTetP2(), 3.0, 4e-3, id="tet10", marks=pytest.mark.slow),
    ],
)
def test_displacement_converges_at_the_expected_rate(mesh, element, rate, largest):
    errors = []
    for n in (4, 8):
        if mesh is box_mesh:
            errors.append(displacement_error(box_mesh((1.0, 1.0, 1.0), (n, n, n)), element))
        else:
            axis = np.linspace(0.0, 1.0, n + 1)
            errors.append(displacement_error(MeshTet.init_tensor(axis, axis, axis), element))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(rate, abs=0.3)
    assert errors[1] < largest, "the rate alone does not show that the right problem was solved"


def test_the_matrix_equals_a_vector_element():
    mesh = box_mesh((1.0, 2.0, 0.5), (2, 3, 2))
    basis = displacement_basis(mesh, ElementHex2())
    vector = Basis(mesh, ElementVector(ElementHex2()), intorder=4)
    expected = linear_elasticity(*lame_parameters(E, NU)).assemble(vector)
    difference = abs(elastic_matrix(basis, Elastic(E, NU)) - expected).max()
    assert difference < 1e-13 * abs(expected).max()


@pytest.mark.parametrize(
    "mesh", [box_mesh((1.0, 2.0, 0.5), (2, 3, 2)), MeshQuad.init_tensor([0, 1, 3], [0, 1])]
)
def test_the_matrix_of_an_isotropic_tensor_follows_from_its_moduli(mesh):
    C = np.diag([2.0 * SHEAR] * 3 + [SHEAR] * 3)
    C[:3, :3] += LAME
    basis = displacement_basis(mesh, mesh.elem())
    expected = elastic_matrix(basis, Elastic(E, NU))
    matrix = elastic_matrix(basis, AnisotropicElastic(C))
    assert abs(matrix - expected).max() < 1e-13 * abs(expected).max()


@pytest.mark.parametrize(
    "law", [Elastic(E, NU), AnisotropicElastic(np.diag([4.0, 3.0, 3.0, 1.0, 1.0, 2.0]))]
)
def test_incompatible_modes_leave_even_strain_and_rigid_motions_as_they_are(law):
    mesh = box_mesh((3.0, 1.0, 1.0), (3, 2, 2))
    moved = 0.1 * np.random.default_rng(0).uniform(-1.0, 1.0, mesh.p.shape)
    basis = displacement_basis(replace(mesh, doflocs=mesh.p + moved))
    share = np.linspace(0.5, 1.0, mesh.t.shape[1])
    K, less = (item(basis, law, share) for item in (elastic_matrix, mode_stiffness))
    x, y, z = basis.doflocs
    even = np.stack([x + 2.0 * y, 0.5 * z - x, y + 3.0 * z], axis=1).ravel()
    np.testing.assert_allclose(less @ even, 0.0, atol=1e-12)
    np.testing.assert_allclose((less - less.T).toarray(), 0.0, atol=1e-12)
    free = np.linalg.eigvalsh((K - less).toarray())
    np.testing.assert_allclose(free[:6], 0.0, atol=1e-9)
    assert free[6] > 1e-3


def test_incompatible_modes_bend_one_layer_of_flat_elements_as_a_beam():
    basis, law = displacement_basis(box_mesh((6.0, 1.0, 0.1), (3, 1, 1))), Elastic(E, 0.0)
    x, _, z = basis.doflocs
    bent = np.stack([x * (z - 0.05), 0.0 * x, -0.5 * x**2], axis=1).ravel()
    K, less = elastic_matrix(basis, law), mode_stiffness(basis, law)
    exact = E * 0.1**3 / 12.0 * 6.0  # E I, times the length, of a unit curvature
    assert bent @ ((K - less) @ bent) == pytest.approx(exact)
    assert bent @ (K @ bent) > 100.0 * exact


def test_the_face_operator_integrates_over_the_face():
    basis = displacement_basis(box_mesh((2.0, 3.0, 1.0), (2, 4, 1)), ElementHex2())
    operator, weight, position = face_operator(basis, "top", order=5)
    quadratic = basis.doflocs[0] ** 2 + basis.doflocs[0] * basis.doflocs[1]
    np.testing.assert_allclose(operator @ quadratic, position[0] ** 2 + position[0] * position[1])
    assert weight @ (operator @ quadratic) == pytest.approx(8.0 + 9.0)
    np.testing.assert_allclose(position[2], 1.0)
