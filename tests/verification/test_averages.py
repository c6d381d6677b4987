"""Identities of the averages, eqs (2) and (3), for contact without friction."""

import numpy as np
import pytest
from skfem import Basis, ElementHex1

from multiscale.fe.elasticity import assemble_elasticity
from multiscale.laws.bulk.bulk_law import lame_parameters
from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.micro.averages import average_traction
from multiscale.micro.elastic.elastic_cells import assemble_graph_cell
from multiscale.micro.layer import GraphMesh, graded_planes
from tests.support import egg_box, observed_rate, rough_square


def rough(n, slope=0.1, seed=5):
    return rough_square(n, 0.5, 0.25, slope, seed=seed)


def sawtooth(n, gentle, tangent):
    """Rise with the given tangent over the gentle share of the period, then fall back."""
    x = np.arange(n) / n
    height = np.where(x < gentle, tangent * x, tangent * gentle * (1.0 - x) / (1.0 - gentle))
    return np.tile(height[:, None], (1, 2))


def reversed_x(heights):
    """Mirror a periodic map about x = 0."""
    return np.roll(heights[::-1], 1, axis=0)


def base_reaction(cell, displacement):
    """Force of the base on the body, from the stiffness that scikit-fem assembles."""
    planes = graded_planes(cell.depth, cell.layers, min(cell.surface.spacing))
    mesh = GraphMesh(cell.surface, planes).hexahedra()
    nx, ny = cell.surface.heights.shape
    i = np.rint(mesh.p[0] / cell.surface.spacing[0]).astype(int) % nx
    j = np.rint(mesh.p[1] / cell.surface.spacing[1]).astype(int) % ny
    flat = mesh.p[2] / (1.0 + cell.surface.heights[i, j] / cell.depth)
    plane = np.searchsorted(planes, flat - 1e-9 * cell.depth)
    whole = np.concatenate([np.zeros((nx, 1, 3, ny)), displacement], axis=1)
    moduli = lame_parameters(cell.law.youngs_modulus, cell.law.poissons_ratio)
    stiffness = assemble_elasticity(Basis(mesh, ElementHex1(), intorder=3), *map(float, moduli))
    forces = (stiffness @ whole[i, plane, :, j].ravel()).reshape(-1, 3)
    return forces[plane == 0].sum(axis=0)


@pytest.mark.parametrize("obstacle", [None, "rough"], ids=["flat", "rough"])
def test_average_traction_is_the_base_reaction_over_the_nominal_area(obstacle):
    other = Surface(rough(32, slope=0.05, seed=8).heights, (1.0, 1.0)) if obstacle else None
    cell = Cell(rough(32), 1.0, 10, youngs_modulus=2.0, poissons_ratio=0.3, obstacle=other)
    problem = assemble_graph_cell(cell)
    state = problem.solve(load=0.01, tolerance=1e-11)
    averages = average_traction(problem.surface(state).force, problem.area)
    reaction = -base_reaction(cell, state.displacement) / problem.area
    np.testing.assert_allclose(averages[[1, 2, 0]], reaction, atol=1e-8 * abs(averages[0]))


@pytest.mark.slow
def test_tangential_average_vanishes_without_friction_on_small_slopes():
    n, slope = 256, 1e-3  # 16 points in the shortest wave
    surface = rough_square(n, 0.25, 1.0 / 16.0, slope, seed=5)
    flat = Surface(np.zeros((n, n)), (1.0, 1.0))
    # the rough side is the obstacle: its normals carry the horizontal traction
    cell = Cell(flat, 1.0, 16, 0.91, 0.3, obstacle=Surface(-surface.heights, (1.0, 1.0)))
    response = solve_cell(cell, Path(pressure=(0.05 * slope, 0.2 * slope)))
    normal, *tangential = np.moveaxis(response["traction"].values[0], -1, 0)
    assert np.max(np.abs(tangential / normal)) <= 5e-4 * slope


@pytest.mark.parametrize("orientation", [1.0, -1.0], ids=["rising", "falling"])
@pytest.mark.parametrize("gentle", [0.5, 0.8], ids=["symmetric", "asymmetric"])
def test_an_inclined_facet_gives_its_slope_as_traction_ratio(gentle, orientation):
    n, tangent = 128, 0.1
    obstacle = sawtooth(n, gentle, tangent)
    x = np.arange(n) / n
    inside = (0.2 * gentle < x) & (x < 0.7 * gentle)  # the only part of the body that can touch
    body = obstacle - np.where(inside, 0.0, 0.01)[:, None]
    if orientation < 0.0:
        obstacle, body = reversed_x(obstacle), reversed_x(body)
    size = (1.0, 2.0 / n)
    cell = Cell(Surface(body, size), 1.0, 24, 1.0, 0.3, obstacle=Surface(obstacle, size))
    response = solve_cell(cell, Path(pressure=(1e-5, 1e-4, 1e-3)), recover_stress=True)
    normal, along_x, along_y = np.moveaxis(response["traction"].values[0], -1, 0)
    np.testing.assert_allclose(along_x / normal, -orientation * tangent, rtol=1e-9)
    np.testing.assert_allclose(along_y, 0.0, atol=1e-12)
    normal, along_x, _ = np.moveaxis(response["recovered_traction"].values[0], -1, 0)
    np.testing.assert_allclose(along_x / normal, -orientation * tangent, rtol=0.05)


def test_a_cell_turned_by_a_right_angle_gives_turned_averages():
    surface, obstacle = rough(32), rough(32, slope=0.2, seed=9)
    results = []
    for turn in (np.asarray, np.transpose):
        cell = Cell(
            Surface(turn(surface.heights), (1.0, 1.0)),
            1.0,
            10,
            1.0,
            0.3,
            obstacle=Surface(turn(obstacle.heights), (1.0, 1.0)),
        )
        results.append(solve_cell(cell, Path(pressure=(0.01,))))
    first, second = (response["traction"].values[0, 0] for response in results)
    np.testing.assert_allclose(first, second[[0, 2, 1]], atol=1e-8 * abs(first[0]))


def test_recovered_stress_tends_to_the_multipliers_under_refinement():
    sizes, errors = [], []
    for n in (16, 32, 64):
        cell = Cell(egg_box(n, 0.02), 1.0, n // 2, 1.0, 0.3)
        response = solve_cell(cell, Path(pressure=(0.005, 0.02)), recover_stress=True)
        recovered, traction = (
            response[name].values[0, :, 0] for name in ("recovered_traction", "traction")
        )
        sizes.append(1.0 / n)
        errors.append(recovered / traction - 1.0)
    for k in range(2):
        # the pressure falls like a square root at the edge of a contact spot: less than order two
        assert observed_rate(sizes, [error[k] for error in errors]) > 1.0
        assert abs(errors[-1][k]) < 5e-3


def test_mean_gap_is_the_first_mean_gap_plus_the_mean_normal_jump():
    surface = rough(32)
    response = solve_cell(Cell(surface, 1.0, 10, 1.0, 0.3), Path(pressure=(0.001, 0.02)))
    first = surface.heights.max() - surface.heights.mean()
    np.testing.assert_allclose(
        response["mean_gap"].values[0],
        first + response["displacement_jump"].values[0, :, 0],
        rtol=1e-12,
    )
