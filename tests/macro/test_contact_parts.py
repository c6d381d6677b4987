"""The parts of a contact problem: elements, mortar integrals, local law, mesh files."""

import meshio
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from skfem import MeshHex, MeshQuad, MeshTet, MeshTri

from multiscale.errors import CaseError
from multiscale.laws.bulk import J2, Elastic, NeoHookean
from multiscale.macro import Body, Contact, ContactProblem, Plane, load_mesh, solve_contact
from multiscale.macro.continuum import displacement_basis, stiffness_matrix
from multiscale.macro.continuum.coulomb import linearise
from multiscale.macro.continuum.elements import element_response, prepare_elements
from multiscale.macro.continuum.mortar import couple
from multiscale.macro.continuum.surface import facet_normals, nodal_areas, surface_of
from multiscale.nonsmooth.coulomb import alart_curnier
from tests.contact_scenes import block, moved
from tests.support import keep_ignoring_broken_pipes

MESHES = [
    pytest.param(MeshTri, id="tri"),
    pytest.param(MeshQuad, id="quad"),
    pytest.param(MeshTet, id="tet"),
    pytest.param(MeshHex, id="hex"),
]


def distorted(kind, seed=0):
    d = kind().dim()
    mesh = block(kind, (3,) * d, (0.0,) * d, (1.0,) * d)
    noise = np.random.default_rng(seed).uniform(-0.07, 0.07, size=mesh.p.shape)
    return moved(mesh, mesh.p + noise)


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
def test_elastic_elements_are_those_of_the_scalar_forms(kind):
    mesh = distorted(kind)
    elements = prepare_elements(mesh)
    law = Elastic(2.0, 0.3)
    rest = law.initial_state(elements.weight.shape)
    found = element_response(elements, law, np.zeros(elements.size), rest)[1]
    expected = stiffness_matrix(displacement_basis(mesh, mesh.elem()), 2.0, 0.3)
    assert abs(found - expected).max() < 1e-13


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


@pytest.mark.parametrize("kind", [MeshQuad, MeshHex])
def test_an_incompressible_body_does_not_lock(kind):
    # a cantilever in bending hardly notices Poisson's ratio; with locking it stiffens tenfold
    d = kind().dim()
    mesh = block(kind, (16, *(1,) * (d - 2), 4), (0.0,) * d, (8.0, *(1.0,) * (d - 1)))
    tips = []
    for nu in (0.3, 0.4999):
        shear = {"right": (*(0.0,) * (d - 1), 1e-4)}
        held = {"left": (0.0,) * d}
        if d == 3:  # plane strain
            held |= {"front": (None, 0.0, None), "back": (None, 0.0, None)}
        body = Body(mesh, Elastic(1.0 - nu**2, nu), held, shear)
        step = solve_contact(ContactProblem({"beam": body}))[-1].unwrap()
        tips.append(step.displacement["beam"][-1].max())
    assert tips[1] == pytest.approx(tips[0], rel=0.05)


def test_facets_look_outwards_and_their_nodes_share_the_area():
    for kind in (MeshTri, MeshQuad, MeshTet, MeshHex):
        mesh = distorted(kind, seed=3)
        d = mesh.dim()
        for side, axis, sign in (("top", d - 1, 1.0), ("left", 0, -1.0)):
            surface = surface_of(mesh, side)
            x = mesh.p.T[surface.nodes]
            normal = facet_normals(x[surface.facets])
            assert np.all(sign * normal[:, axis] > 0.0)
            areas = nodal_areas(surface, x)
            # facets of distorted hexahedra are warped: their area exceeds that of their normals
            assert areas.sum() == pytest.approx(np.linalg.norm(normal, axis=1).sum(), rel=2e-2)


def surfaces(d, kinds, seed):
    """Two flat surfaces that overlap in part, turned in space."""
    low = np.zeros(d)
    one = block(kinds[0], (3, 4, 1)[-d:], low, np.ones(d))
    high = np.full(d, 1.3)
    two = block(kinds[1], (4, 3, 1)[-d:], low + 0.2, high)
    top, bottom = surface_of(one, "top"), surface_of(two, "bottom")
    x1, x2 = one.p.T[top.nodes].copy(), two.p.T[bottom.nodes].copy()
    x1[:, -1], x2[:, -1] = 0.0, 0.1
    turn = Rotation.random(random_state=seed).as_matrix() if d == 3 else rotation_2d(seed)
    return top.facets, bottom.facets, x1 @ turn.T, x2 @ turn.T


def rotation_2d(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


PAIRS = [
    pytest.param(2, (MeshQuad, MeshTri), id="segments"),
    pytest.param(3, (MeshHex, MeshHex), id="quadrilaterals"),
    pytest.param(3, (MeshTet, MeshHex), id="triangle on quadrilateral"),
    pytest.param(3, (MeshTet, MeshTet), id="triangles"),
]


@pytest.mark.parametrize(("d", "kinds"), PAIRS)
def test_mortar_integrals_are_exact_on_the_common_area(d, kinds):
    f1, f2, x1, x2 = surfaces(d, kinds, seed=4)
    D, M = couple((f1, f2), (x1, x2))
    common = 0.8 ** (d - 1)
    assert D.sum() == pytest.approx(common, rel=1e-13)
    np.testing.assert_allclose(D.sum(axis=1), M.sum(axis=1), atol=1e-15)
    # a linear field is the same on both sides but for the gap of 0.1 along the normal
    jump = M @ x2 - D @ x1
    normal = facet_normals(x1[f1])[0]
    normal /= np.linalg.norm(normal)
    np.testing.assert_allclose(jump, 0.1 * np.outer(D.sum(axis=1), normal), atol=1e-14)


def test_surfaces_beyond_reach_or_back_to_back_do_not_see_each_other():
    f1, f2, x1, x2 = surfaces(3, (MeshHex, MeshHex), seed=5)
    assert couple((f1, f2), (x1, x2), reach=0.05)[0].sum() == 0.0
    assert couple((f1, f2[:, ::-1]), (x1, x2))[0].sum() == 0.0


def local_data(components, seed=6):
    rng = np.random.default_rng(seed)
    n = 200
    reaction, jump = rng.normal(size=(2, n, components))
    kept = np.ones((n, components), dtype=bool)
    return reaction, jump, rng.uniform(0.0, 1.0, n), rng.uniform(0.5, 2.0, n), kept


@pytest.mark.parametrize("components", [1, 2, 3])
def test_the_local_law_is_alart_and_curniers(components):
    r, j, mu, rho, kept = local_data(components)
    found = linearise(r, j, mu, rho, kept).residual
    np.testing.assert_allclose(found.T, alart_curnier(j.T, r.T, mu, rho), atol=1e-14)


@pytest.mark.parametrize("components", [1, 2, 3])
def test_the_derivatives_of_the_local_law_are_differences(components):
    r, j, mu, rho, kept = local_data(components)
    kept[:40, -1] = False  # a component that a support holds
    law = linearise(r, j, mu, rho, kept)
    for k in range(components):
        step = np.zeros((1, components))
        step[0, k] = 1e-7
        by_r = (
            linearise(r + step, j, mu, rho, kept).residual
            - linearise(r - step, j, mu, rho, kept).residual
        )
        by_j = (
            linearise(r, j + step, mu, rho, kept).residual
            - linearise(r, j - step, mu, rho, kept).residual
        )
        np.testing.assert_allclose(law.by_reaction[:, :, k], by_r / 2e-7, atol=1e-6)
        np.testing.assert_allclose(law.by_jump[:, :, k], by_j / 2e-7, atol=1e-6)


SHAPES = {
    "triangle": MeshTri,
    "quad": MeshQuad,
    "tetra": MeshTet,
    "hexahedron": MeshHex,
}


@pytest.mark.parametrize("kind", SHAPES)
def test_a_mesh_file_keeps_its_shape_and_its_names(kind, tmp_path):
    d = SHAPES[kind]().dim()
    mesh = block(SHAPES[kind], (3, 2, 2)[:d], (0.0,) * d, (2.0, 1.0, 3.0)[:d])
    cells = mesh.t.T
    if kind == "hexahedron":  # scikit-fem numbers the corners otherwise than VTK
        cells = cells[:, [0, 3, 6, 2, 1, 5, 7, 4]]
    facet = {"triangle": "line", "quad": "line", "tetra": "triangle", "hexahedron": "quad"}[kind]
    surface = surface_of(mesh, "top")
    facets = surface.nodes[surface.facets]
    points = np.vstack([mesh.p, np.zeros((3 - d, mesh.p.shape[1]))]).T
    tags = [np.full(len(cells), 1), np.full(len(facets), 2)]
    meshio.Mesh(
        points,
        [(kind, cells), (facet, facets)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"solid": np.array([1, d]), "top": np.array([2, d - 1])},
    ).write(tmp_path / "block.msh", file_format="gmsh22", binary=False)

    found = load_mesh(tmp_path / "block.msh", scale=1e-3)
    assert isinstance(found, SHAPES[kind])
    elements = prepare_elements(found)
    assert elements.weight.min() > 0.0
    assert elements.weight.sum() == pytest.approx(1e-3**d * (2.0 if d == 2 else 6.0))
    assert len(found.boundaries["top"]) == len(facets)
    middle = found.p[:, found.facets[:, found.boundaries["top"]]].mean(axis=1)
    np.testing.assert_allclose(middle[-1], 1e-3 * (1.0, 3.0)[d - 2])


def test_a_mesh_of_gmsh_is_pressed_between_plates(tmp_path):
    gmsh = pytest.importorskip("gmsh", exc_type=Exception)
    gmsh.initialize(interruptible=False)
    keep_ignoring_broken_pipes()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addRectangle(0.0, 0.0, 0.0, 2.0, 1.0, 1)
    gmsh.model.occ.synchronize()
    for tag, name in ((1, "bottom"), (3, "top")):
        gmsh.model.addPhysicalGroup(1, [tag], name=name)
    gmsh.model.addPhysicalGroup(2, [1], name="solid")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
    gmsh.model.mesh.generate(2)
    gmsh.write(str(tmp_path / "block.msh"))
    gmsh.finalize()

    mesh = load_mesh(tmp_path / "block.msh")
    body = Body(mesh, Elastic(1e9, 0.3), {"bottom": (0.0, 0.0)})
    plate = Plane((0.0, 1.0), (0.0, -1.0), motion=(0.0, -1e-3))
    problem = ContactProblem({"block": body}, {"plate": Contact(("block", "top"), plate)})
    surface = solve_contact(problem)[-1].unwrap().contact["plate"]
    assert np.sum(surface.area) == pytest.approx(2.0)
    assert np.all(surface.pressure > 0.0)


def test_files_that_hold_no_body_are_refused(tmp_path):
    with pytest.raises(CaseError, match="no mesh file"):
        load_mesh(tmp_path / "absent.msh")
    (tmp_path / "text.msh").write_text("not a mesh")
    with pytest.raises(CaseError, match="cannot be read as a mesh"):
        load_mesh(tmp_path / "text.msh")
    lines = meshio.Mesh(np.eye(3), [("line", [[0, 1]])])
    lines.write(tmp_path / "lines.vtk")
    with pytest.raises(CaseError, match="a body needs elements of one kind"):
        load_mesh(tmp_path / "lines.vtk")
