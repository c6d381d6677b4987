"""Contact spots: their sums are the averages, whatever the kind of cell."""

import numpy as np
import pytest

from multiscale.laws.bulk import Elastic
from multiscale.micro import Cell, Path, Surface, run_ensemble, solve_cell
from multiscale.micro.averages import ContactSurface, Keep, average_surface
from multiscale.micro.mesh.meshing import ElementKind, graph_mesh_cell
from tests.support import rough_square

PATH = Path(pressure=(1e-3, 1e-2))


def rough(n=16):
    return rough_square(n, 0.5, 0.25, 0.1, seed=3)


CELLS = {
    "flat": lambda: Cell(rough(), 1.0, 6, 1.0, 0.3, geometry="flat"),
    "conforming": lambda: Cell(rough(), 1.0, 6, 1.0, 0.3),
    "obstacle": lambda: Cell(
        Surface(np.zeros((16, 16)), (1.0, 1.0)), 1.0, 6, 1.0, 0.3, Surface(-rough().heights, (1, 1))
    ),
    "mesh": lambda: graph_mesh_cell(rough(12), 1.0, 4, Elastic(1.0, 0.3), ElementKind.TET10),
    "frictional": lambda: Cell(rough(), 1.0, 6, 1.0, 0.3, friction_coefficient=0.2),
}


@pytest.mark.parametrize("kind", CELLS)
def test_sums_over_spots_are_the_averages(kind):
    response = solve_cell(CELLS[kind](), PATH, keep_spots=True)
    traction = response["traction"].values
    np.testing.assert_allclose(
        response["spot_traction"].sum("spot"), traction, atol=1e-12 * np.abs(traction).max()
    )
    nominal = 1.0
    np.testing.assert_allclose(
        response["spot_area"].sum("spot") / nominal, response["contact_fraction"], rtol=1e-12
    )
    count = np.isfinite(response["spot_area"].values[0]).sum(axis=1)
    assert count.max() > 1
    assert np.all(response["spot_traction"].values[0, 1, : count[1], 0] < 0.0)


def test_friction_parts_each_spot_into_normal_and_tangential_tractions():
    cell = Cell(rough(), 1.0, 6, 1.0, 0.3, friction_coefficient=0.2)
    path = Path(pressure=(1e-2, 1e-2), slide=((0.0, 0.0), (2e-3, 0.0)))
    response = solve_cell(cell, path, keep_spots=True)
    by_normal = response["traction_by_normal"].values
    np.testing.assert_allclose(
        response["spot_traction_by_normal"].sum("spot"),
        by_normal,
        atol=1e-12 * np.abs(by_normal).max(),
    )
    shear = response["spot_traction"] - response["spot_traction_by_normal"]
    assert float(np.abs(shear[0, 1, :, 1]).sum()) > 0.1 * 0.2 * 1e-2


def test_a_spot_goes_on_across_the_periodic_edge():
    pressing, up = np.zeros((6, 4)), np.zeros((6, 3, 4))
    for place in ((0, 1), (5, 1), (0, 0), (0, 3), (2, 2), (3, 3)):  # the last two touch at a corner
        pressing[place] = 1.0
    up[:, 2] = 1.0
    force, area = -pressing[:, None] * up, np.ones((6, 4))
    surface = ContactSurface(force, up, pressing, area, area, area, np.zeros(3), 1.0)
    averages = average_surface(surface, Keep(spots=True))
    assert len(averages["spot_area"]) == 3
    assert np.argmax(averages["spot_area"]) == 0
    np.testing.assert_allclose(averages["spot_traction"][:, 0], [-4 / 24, -1 / 24, -1 / 24])


def test_an_ensemble_keeps_the_spots_of_all_realisations(tmp_path):
    cells = [
        Cell(rough_square(16, 0.5, 0.25, 0.1, seed=k), 1.0, 6, 1.0, 0.3, geometry="flat")
        for k in (1, 2)
    ]
    response = run_ensemble(cells, PATH, folder=tmp_path, keep_spots=True)
    alone = [solve_cell(cell, PATH, keep_spots=True) for cell in cells]
    assert response.sizes["spot"] == max(item.sizes["spot"] for item in alone)
    assert alone[0].sizes["spot"] != alone[1].sizes["spot"]
    np.testing.assert_allclose(
        response["spot_area"].sum("spot"), response["contact_fraction"], rtol=1e-12
    )
