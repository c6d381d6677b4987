"""Substructures of modules with slack links: monotone law, smoothed strains, error of specimens."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.macro import solve_static, tensegrity_grid
from multiscale.macro.continuum.plate import plate_elements, smooth_at
from multiscale.macro.links import EquivalentPlate, plate_cell, solve_plate, with_specimen_error

FACTORS = [0.1, 0.5, 1.0, 4.0]


def modules(n, parts, m=None, other=None):
    """Plate of a grid whose prestress rises with the tensions under its load."""
    options = {"prestress": 2550.0 * (n / 16.0) ** 2}
    cell = plate_cell(tensegrity_grid(1, **options), (1.0, 1.0))
    return EquivalentPlate(tensegrity_grid(n, m, **options), cell, (parts, other or parts))


@pytest.fixture(scope="module")
def solved():
    """Modules with their errors by specimens, and links of the whole, of two grids."""
    pairs = []
    for shapes in (((16, 4), (8, 4)), ((24, 6, 16, 4), (12, 6, 8, 4))):
        plate, specimen = (modules(*shape) for shape in shapes)
        result = solve_plate(plate, FACTORS, links=True)
        result = with_specimen_error(result, plate, specimen)
        pairs.append((result, solve_static(plate.system, FACTORS)))
    return pairs


@pytest.mark.parametrize("grid", [0, 1])
def test_errors_of_a_specimen_contain_those_of_a_larger_structure(solved, grid):
    result, links = solved[grid]
    off = np.abs(result["tension"] - links["tension"])
    within = (off <= result["tension_error"]).mean("link")
    assert np.all(within > 0.95)
    assert np.all(result["tension_error"].mean("link") < 0.2 * links["tension"].max("link"))
    u = links["displacement"]
    size = np.sqrt((u**2).sum("component")).max("node")
    moved = np.sqrt(((result["displacement"] - u) ** 2).sum("component")).max("node")
    assert np.all(moved < result["largest_displacement_error"] * size)
    assert np.all(result["largest_displacement_error"] < 0.2)
    pull, pulled = (data["tension"].max("link") for data in (result, links))
    assert np.all(np.abs(pull - pulled) < result["largest_tension_error"] * pull)
    slack, slackened = ((data["slack"] > 0.0).sum("link") for data in (result, links))
    assert np.all(np.abs(slack - slackened) <= result["slack_links_error"])
    assert slackened[-1] > 0.15 * links.sizes["link"]


def test_the_law_of_a_module_is_monotone_and_exact_while_taut():
    cell = plate_cell(tensegrity_grid(1), (1.0, 1.0))
    strain = np.random.default_rng(seed=5).normal(scale=1e-3, size=(2, 200, 8))
    first, second = (cell.respond(each) for each in strain)
    assert first.slack.any(axis=1).mean() > 0.9
    work = np.sum((first.resultant - second.resultant) * (strain[0] - strain[1]), axis=1)
    assert np.all(work > 0.0)
    taut = cell.respond(1e-3 * strain[0])
    np.testing.assert_allclose(
        taut.resultant, 1e-3 * strain[0] @ cell.stiffness, rtol=1e-8, atol=1e-7
    )


def test_tensions_balance_the_resultants_of_their_cells():
    plate = modules(8, 4)
    u = np.zeros(plate.plate.n)
    u[plate.free] = 1e-4 * np.random.default_rng(seed=6).normal(size=plate.free.size)
    tension = np.clip(plate.elastic_tension(u), *plate.system.bounds)[plate.members]
    response = plate.cell.respond(plate.smooth @ plate.plate.strain(u))
    assert response.slack.any()
    np.testing.assert_allclose(
        tension @ plate.cell.strain, response.resultant, rtol=1e-9, atol=1e-9 * 2550.0
    )


def test_smoothed_values_are_exact_where_they_are_bilinear():
    size, elements = (3.0, 2.0), (3, 4)
    places = np.random.default_rng(seed=7).uniform(size=(2, 20)) * np.array(size)[:, None]
    plate = plate_elements(size, elements, places)
    x, y = plate.position
    u = np.zeros((x.size, 5))
    u[:, 0], u[:, 1] = x**2 * y, x * y**2  # with the strains 2 x y and x^2 + y^2
    smoothed = smooth_at(size, elements, places) @ plate.strain(u.ravel())
    np.testing.assert_allclose(smoothed[:, :2], 2.0 * (places[0] * places[1])[:, None] * [1, 1])
    # of a quadratic function only the oscillation within elements is left out
    off = smoothed[:, 2] - np.sum(places**2, axis=0)
    assert 0.0 < np.abs(off).max() < (1.0 + 0.25) / 6.0 + 1e-12


def test_specimens_that_show_nothing_are_refused():
    plate = modules(16, 2)
    result = solve_plate(plate, [0.1, 1.0], links=True)
    with pytest.raises(CaseError, match="specimen of 256 modules has no fewer than the structure"):
        with_specimen_error(result, plate, plate)
    with pytest.raises(CaseError, match=r"no links as far from the edge .* at least 5 modules"):
        with_specimen_error(result, plate, modules(8, 2, 4))
    refused = with_specimen_error(result, plate, modules(8, 2))
    assert not refused["converged"].values.any()
    assert np.isnan(refused["tension"]).all()
    assert "leave their law, and their specimen is off by" in refused.attrs["failure"]


def test_links_without_cells_are_refused():
    plate = modules(4, 4)
    plate.system.group[:] = np.arange(plate.system.n_links) % 2
    with pytest.raises(CaseError, match="must be equal to its cell, with the same"):
        solve_plate(EquivalentPlate(plate.system, plate.cell, (4, 4)), [1.0], links=True)
