"""The general path: any scikit-fem mesh and element in the same contact loop."""

import numpy as np
import pytest
from skfem import ElementHex1, ElementTetP1, MeshHex, MeshTet

from multiscale.errors import CaseError
from multiscale.laws.bulk import Elastic, GradedElastic
from multiscale.micro import Cell, MeshCell, Path, Surface, run_ensemble, solve_cell
from multiscale.micro.damage import Cavities, spheres
from multiscale.micro.layer import GraphMesh, graded_planes
from multiscale.micro.mesh import mesh_cell
from multiscale.micro.mesh.mesh_cell import CellSides
from multiscale.micro.mesh.meshing import ElementKind, graph_mesh_cell
from tests.support import egg_box, rough_square

PATH = Path(pressure=(1e-3, 1e-2, 1e-1))


def named(mesh):
    """Name base, top and sides of a cell on the unit square."""
    facets = mesh.boundary_facets()
    middle = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    side = np.any(np.isclose(middle[:2], 0.0) | np.isclose(middle[:2], 1.0), axis=0)
    base = np.isclose(middle[2], 0.0)
    inner = np.linalg.norm(middle - np.array([[0.5], [0.5], [0.6]]), axis=0) < 0.25
    top = ~(side | base | inner)
    return mesh.with_boundaries({"base": facets[base], "sides": facets[side], "top": facets[top]})


def wavy_box(n, amplitude):
    mesh = MeshHex.init_tensor(*(np.linspace(0.0, 1.0, n + 1),) * 3)
    points = mesh.p.copy()
    points[2] *= 1.0 + amplitude * np.cos(2 * np.pi * points[0]) * np.cos(2 * np.pi * points[1])
    return MeshHex(points, mesh.t)


@pytest.mark.parametrize("kind", list(ElementKind))
def test_every_element_has_the_contact_nodes_and_the_answer_of_the_kernel(kind):
    surface = rough_square(8, 1.0, 0.5, 0.1, seed=2)
    cell = graph_mesh_cell(surface, 1.0, 4, Elastic(1.0, 0.3), kind)
    response = solve_cell(cell, PATH, keep_fields=True, tolerance=1e-12)
    kernel = solve_cell(Cell(surface, 1.0, 4, 1.0, 0.3), PATH, keep_fields=True, tolerance=1e-12)
    assert response["converged"].values.all()
    tolerance = 1e-9 if kind is ElementKind.HEX8 else 0.3  # of four points a wave
    for name in ("pressure", "gap", "mean_gap", "displacement_jump", "contact_fraction"):
        scale = np.max(np.abs(kernel[name].values))
        np.testing.assert_allclose(response[name], kernel[name], atol=tolerance * scale)


@pytest.mark.parametrize("kind", [ElementKind.HEX27, ElementKind.TET10])
def test_second_order_elements_carry_an_even_pressure_evenly(kind):
    flat = Surface(np.zeros((8, 8)), (1.0, 1.0))
    cell = graph_mesh_cell(flat, 1.0, 4, Elastic(1.0, 0.3), kind)
    response = solve_cell(cell, Path(pressure=(1e-3,)), keep_fields=True)
    np.testing.assert_allclose(response["pressure"], 1e-3, rtol=1e-8)


@pytest.mark.parametrize("obstacle", [False, True], ids=["flat", "rough"])
def test_general_path_agrees_with_the_fast_path_on_the_same_mesh(obstacle):
    surface = rough_square(12, 1.0, 0.5, 0.1, seed=2)
    mesh = named(GraphMesh(surface, graded_planes(1.0, 6, 1.0 / 12.0)).hexahedra())
    fast = solve_cell(Cell(surface, 1.0, 6, 1.0, 0.3), PATH, recover_stress=True, tolerance=1e-11)
    if obstacle:  # a flat obstacle, but as a graph: no longer one unknown per contact node
        flat = Surface(np.zeros((12, 12)), (1.0, 1.0))
        body = Cell(surface, 1.0, 6, 1.0, 0.3, flat)
        fast = solve_cell(body, PATH, recover_stress=True, tolerance=1e-11)
    general = solve_cell(
        MeshCell(mesh, ElementHex1(), Elastic(1.0, 0.3)), PATH, recover_stress=True
    )
    for name in ("traction", "displacement_jump", "mean_gap", "recovered_traction"):
        scale = np.max(np.abs(fast[name].values))
        np.testing.assert_allclose(general[name], fast[name], atol=1e-7 * scale)


def test_moduli_of_elements_agree_with_the_fast_path():
    n, layers = 8, 6
    modulus = 10.0 ** np.random.default_rng(seed=5).uniform(0.0, 2.0, (n, layers, n))
    surface, planes = egg_box(n, 0.01), graded_planes(1.0, layers, 1.0 / n)
    fast = solve_cell(Cell(surface, 1.0, layers, modulus, 0.3), PATH, recover_stress=True)
    flat = MeshHex.init_tensor(np.arange(n + 1) / n, np.arange(n + 1) / n, planes)
    middle = flat.p[:, flat.t].mean(axis=1)
    i, j = (np.floor(middle[k] * n).astype(int) for k in (0, 1))
    law = GradedElastic(modulus[i, np.searchsorted(planes, middle[2]) - 1, j], 0.3)
    body = MeshCell(named(GraphMesh(surface, planes).hexahedra()), ElementHex1(), law)
    general = solve_cell(body, PATH, recover_stress=True)
    for name in ("mean_gap", "traction", "recovered_traction", "displacement_jump"):
        np.testing.assert_allclose(fast[name], general[name], rtol=1e-4, atol=1e-9)


def test_sliding_sides_equal_periodic_sides_by_symmetry():
    mesh = named(wavy_box(6, 0.02))
    periodic, sliding = (
        solve_cell(MeshCell(mesh, ElementHex1(), Elastic(1.0, 0.3), kind), PATH)
        for kind in (CellSides.PERIODIC, CellSides.SLIDING)
    )
    np.testing.assert_allclose(periodic["mean_gap"], sliding["mean_gap"], atol=1e-10)


def test_uniform_displacement_and_traction_bound_the_energy_of_periodic_sides():
    surface, path = rough_square(8, 1.0, 0.5, 0.1, seed=2), np.linspace(0.0, 0.06, 9)
    energy = {}
    for sides in CellSides:
        cell = graph_mesh_cell(surface, 1.0, 4, Elastic(1.0, 0.3), sides=sides)
        response = solve_cell(cell, Path(approach=tuple(path)), tolerance=1e-10)
        assert response["converged"].values.all()
        energy[sides] = np.trapezoid(-response["traction"].values[0, :, 0], path)
    lower, upper = energy[CellSides.TRACTION], energy[CellSides.DISPLACEMENT]
    assert 0.5 * upper < lower < 0.99 * energy[CellSides.PERIODIC]
    assert lower < 0.999 * energy[CellSides.SLIDING]
    assert max(energy[CellSides.PERIODIC], energy[CellSides.SLIDING]) < 0.95 * upper


@pytest.mark.parametrize("sides", [CellSides.PERIODIC, CellSides.DISPLACEMENT])
@pytest.mark.parametrize("kind", [ElementKind.HEX8, ElementKind.TET10])
def test_multigrid_and_factors_have_one_answer(kind, sides, monkeypatch):
    surface = rough_square(8, 1.0, 0.5, 0.1, seed=2)
    cell = graph_mesh_cell(surface, 1.0, 4, Elastic(1.0, 0.3), kind, sides=sides)
    factors = solve_cell(cell, PATH, keep_fields=True)
    monkeypatch.setattr(mesh_cell, "MOST_FACTORED", 0)
    assert "multigrid" in cell.needs().built
    multigrid = solve_cell(cell, PATH, keep_fields=True)
    assert multigrid["converged"].values.all()
    assert np.all(multigrid["linear_iterations"] > 1)
    for name in ("pressure", "mean_gap", "traction"):
        scale = np.max(np.abs(factors[name].values))
        np.testing.assert_allclose(multigrid[name], factors[name], atol=1e-6 * scale)
    by_approach = Path(approach=tuple(-multigrid["displacement_jump"].values[0, :, 0] + 0.01))
    assert solve_cell(cell, by_approach)["converged"].values.all()


def test_a_small_pore_takes_the_share_of_a_dilute_sphere_from_the_stiffness_of_a_layer():
    """Eshelby: K falls by (3 K + 4 G)/4 G of itself and G by 5 (3 K + 4 G)/(9 K + 8 G), times v."""
    nu, radius = 0.3, 0.2
    K, G = 1.0 / (3.0 * (1.0 - 2.0 * nu)), 0.5 / (1.0 + nu)
    lost = K * (3 * K + 4 * G) / (4 * G) + 4 / 3 * G * 5 * (3 * K + 4 * G) / (9 * K + 8 * G)
    share = 4.0 / 3.0 * np.pi * radius**3 * lost / (K + 4.0 / 3.0 * G)
    flat = Surface(np.zeros((8, 8)), (1.0, 1.0))
    pore = Cavities((1.0, 1.0, 1.0), [spheres([[0.02, 0.48, 0.5]], radius)])  # across the sides
    solid, porous = (
        solve_cell(
            graph_mesh_cell(flat, 1.0, 8, Elastic(1.0, nu), pores=item), Path(approach=(1e-3,))
        )["traction"].values[0, 0, 0]
        for item in (None, pore)
    )
    assert solid / porous - 1.0 == pytest.approx(share, rel=0.1)


def test_a_mesh_with_sides_that_do_not_match_is_refused():
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, 1.0, 4),) * 3)
    points = mesh.p.copy()
    edge = np.isclose(points[0], 1.0) & (points[1] > 0.1) & (points[1] < 0.9)
    points[1, edge] += 0.05
    with pytest.raises(CaseError, match=r"not periodic: 8 of 28 nodes on the sides"):
        solve_cell(
            MeshCell(named(MeshTet(points, mesh.t)), ElementTetP1(), Elastic(1.0, 0.3)), PATH
        )


def test_an_ensemble_of_general_meshes_is_solved_and_resumed(tmp_path):
    mesh, path = named(wavy_box(4, 0.02)), Path(pressure=(0.001, 0.01))
    cells = [MeshCell(mesh, ElementHex1(), Elastic(modulus, 0.3)) for modulus in (1.0, 2.0)]
    response = run_ensemble(cells, path, folder=tmp_path)
    assert response.sizes["realisation"] == 2
    for k, cell in enumerate(cells):
        alone = solve_cell(cell, path)["mean_gap"].values
        np.testing.assert_allclose(response["mean_gap"].values[[k]], alone, rtol=1e-12)
    again = run_ensemble(cells, path, folder=tmp_path)
    np.testing.assert_array_equal(again["wall_time"], response["wall_time"])
