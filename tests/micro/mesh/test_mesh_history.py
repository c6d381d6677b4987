"""Cells on meshes that flow or rub: the same elements as the compiled kernels, and closed forms."""

import numpy as np
import pytest

from multiscale.laws.bulk import J2, Elastic
from multiscale.micro import Cell, Path, Surface, run_ensemble, solve_cell
from multiscale.micro.mesh.meshing import ElementKind, graph_mesh_cell
from tests.support import rough_square

METAL = J2(1.0, 0.3, 0.005, 0.02)
MU = 0.3


def rough():
    return rough_square(8, 1.0, 0.5, 0.1, seed=2)


def assert_close(result, expected, names, tolerance):
    for name in names:
        first, other = result[name].values, expected[name].values
        np.testing.assert_allclose(first, other, atol=tolerance * np.nanmax(np.abs(other)))


@pytest.mark.slow  # compiles the kernel of plastic cells
def test_a_metal_of_hexahedra_is_the_metal_of_the_kernel():
    path = Path(approach=(0.02, 0.04, 0.03, 0.02))  # loads and unloads
    stored = {"keep_fields": True, "keep_spots": True, "tolerance": 1e-10}
    mesh = solve_cell(graph_mesh_cell(rough(), 1.0, 4, METAL), path, **stored)
    kernel = solve_cell(Cell(rough(), 1.0, 4, 1.0, 0.3, bulk=METAL), path, **stored)
    assert mesh["converged"].values.all()
    assert mesh["flowing_fraction"].values[0, 1] > 0.5
    assert_close(mesh, kernel, ("traction", "displacement_jump", "pressure", "gap"), 1e-8)
    # each node's area by its shape function, in place of a quarter of its facets
    assert_close(mesh, kernel, ("mean_gap", "contact_fraction"), 2e-4)


@pytest.mark.parametrize("kind", list(ElementKind))
def test_a_flat_metal_is_pressed_in_uniaxial_strain(kind):
    # of all elements, since the strain is uniform: elastic, then at a distance 2/3 sigma_y
    flat, limit = Surface(np.zeros((4, 4)), (1.0, 1.0)), 0.002
    metal = J2(1.0, 0.3, limit)
    approach = np.array([1e-3, 8e-3, 6e-3])
    cell = graph_mesh_cell(flat, 1.0, 2, metal, kind)
    response = solve_cell(cell, Path(approach=tuple(approach)), tolerance=1e-11)
    assert response["converged"].values.all()
    strain = np.log(1.0 - approach)
    shear, bulk = 1.0 / 2.6, 1.0 / 1.2
    flowing = bulk * strain[1] - 2.0 / 3.0 * limit
    kirchhoff = np.array(
        [
            (bulk + 4.0 / 3.0 * shear) * strain[0],
            flowing,
            flowing + (bulk + 4.0 / 3.0 * shear) * (strain[2] - strain[1]),
        ]
    )
    # the lateral stretch is 1, so that the nominal stress is the Kirchhoff stress over the stretch
    expected = kirchhoff / (1.0 - approach)
    np.testing.assert_allclose(response["traction"].values[0, :, 0], expected, rtol=1e-8)


@pytest.mark.parametrize(
    "kind",
    [
        ElementKind.TET4,
        *(pytest.param(kind, marks=pytest.mark.slow) for kind in ElementKind if kind != "tet4"),
    ],
)
def test_an_ensemble_of_metals_keeps_a_dent(kind, tmp_path):
    cells = [graph_mesh_cell(rough(), 1.0, 2, METAL, kind)]
    response = run_ensemble(cells, Path(pressure=(0.002, 0.004, 0.002)), folder=tmp_path)
    assert response["converged"].values.all()
    gap = response["mean_gap"].values[0]
    assert gap[1] < gap[2] < gap[0]
    assert list(response["branch"].values) == [0, 0, 1]


def test_friction_on_hexahedra_is_the_friction_of_the_kernel():
    a = 0.004
    slide = ((0, 0), (0, 0), (a, 0), (10 * a, 0), (-3 * a, 0), (-3 * a, a))
    path = Path(pressure=(0.005, 0.01, 0.01, 0.01, 0.01, 0.004), slide=slide)
    stored = {"keep_fields": True, "keep_spots": True, "tolerance": 1e-10}
    cell = graph_mesh_cell(rough(), 1.0, 4, Elastic(1.0, 0.3), friction_coefficient=MU)
    mesh = solve_cell(cell, path, **stored)
    kernel = solve_cell(Cell(rough(), 1.0, 4, 1.0, 0.3, friction_coefficient=MU), path, **stored)
    assert mesh["converged"].values.all()
    names = ("traction", "displacement_jump", "mean_gap", "contact_fraction", "pressure", "gap")
    names += ("traction_by_normal", "slip_fraction", "friction_work")
    assert_close(mesh, kernel, names, 1e-8)
    shares = mesh["spot_traction"].sum("spot")
    np.testing.assert_allclose(shares, mesh["traction"], atol=1e-12)


@pytest.mark.parametrize("kind", list(ElementKind))
def test_every_element_slips_at_the_bound_and_dissipates(kind):
    a = 0.004
    slide = ((0, 0), (a, 0), (12 * a, 0), (-12 * a, 0), (a, 0), (12 * a, 0))
    path = Path(pressure=(0.01,) * 6, slide=slide)
    cell = graph_mesh_cell(rough(), 1.0, 4, Elastic(1.0, 0.3), kind, friction_coefficient=MU)
    response = solve_cell(cell, path)
    assert response["converged"].values.all()
    normal, along, across = response["traction"].values[0].T
    full = np.array([2, 3, 5])
    np.testing.assert_allclose(np.hypot(along, across)[full], -MU * normal[full], rtol=1e-3)
    assert np.hypot(along, across)[1] < 0.9 * MU * 0.01  # the first step sticks in part
    assert np.all(np.diff(response["friction_work"].values[0]) >= 0.0)
