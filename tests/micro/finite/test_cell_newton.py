"""The Newton loop against the elastic solver, against its equations, and at its limits."""

import numpy as np
import pytest

from multiscale.convergence import Status
from multiscale.laws.bulk import J2, NeoHookean, Prony
from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.micro.finite.cell_newton import walk_step
from multiscale.micro.finite.finite_cell import current_weight, make_scene
from multiscale.micro.finite.surfaces import OppositeSide
from multiscale.micro.path import Target
from tests.micro.finite.conditions import check_contact
from tests.support import rough_square

N, LAYERS = 16, 6


def rough(slope=0.1, seed=0, n=N):
    return rough_square(n, 1.0, 0.5, slope, seed=seed)


def cell(**changes):
    given = {"youngs_modulus": 1.0, "poissons_ratio": 0.3} | changes
    return Cell(given.pop("surface", rough()), 0.5, LAYERS, **given)


STILL = ((0.0, 0.0),)


@pytest.mark.parametrize("obstacle", [None, rough(0.05, seed=5)], ids=["flat", "rough"])
@pytest.mark.parametrize("nu", [0.3, 0.45])
def test_without_friction_and_at_small_strain_it_is_the_elastic_solver(obstacle, nu):
    body = cell(obstacle=obstacle, poissons_ratio=nu)
    response = solve_cell(body, Path(pressure=(0.002, 0.02), slide=STILL * 2))
    expected = solve_cell(body, Path(pressure=(0.002, 0.02)))
    assert response["converged"].values.all()
    for name in ("displacement_jump", "mean_gap"):
        # a rough obstacle has slopes of second order here and of fourth order there
        atol = 1e-7 if obstacle is None else 2e-3 * float(np.max(np.abs(expected[name])))
        np.testing.assert_allclose(response[name], expected[name], rtol=1e-6, atol=atol)


@pytest.mark.parametrize(
    "bulk", [None, NeoHookean(1.0, 0.3), J2(1.0, 0.3, 0.01, 0.01)], ids=["elastic", "rubber", "J2"]
)
@pytest.mark.parametrize(
    "obstacle",
    [
        pytest.param(None, id="flat"),
        pytest.param(rough(0.1, seed=5), id="rough", marks=pytest.mark.slow),
    ],
)
def test_a_solution_satisfies_contact_and_coulombs_law(bulk, obstacle):
    mu = 0.3
    body = cell(bulk=bulk, friction_coefficient=mu, obstacle=obstacle)
    scene = make_scene(body)
    load = 0.01
    first = walk_step(
        scene, scene.rest(), Target(load, None, np.zeros(2), 0.0), increments=1, tolerance=1e-9
    ).state
    slide = np.array([0.004, 0.002])
    state = walk_step(
        scene, first, Target(load, None, slide, 0.0), increments=1, tolerance=1e-9
    ).state
    assert state.status is Status.CONVERGED
    pressure, tangential = check_contact(scene, state, load, mu, friction_error=1e-7)
    size = np.linalg.norm(tangential, axis=1)
    assert state.slipping.any()
    assert state.dissipation > 0.0
    np.testing.assert_allclose(size[state.slipping], mu * pressure[state.slipping], atol=1e-6)
    # slipping points are pulled along by the obstacle, the way it moves
    forward = np.sum(tangential[:, :2] * slide[None, :, None], axis=1)[state.slipping]
    assert np.mean(forward > 0.0) > 0.9
    internal = scene.begin(first.material, 0.0)(state.displacement).force
    scene.surface(internal)[:] -= state.force
    assert np.max(np.abs(internal)) < 1e-7 * pressure.max()


def test_full_slip_on_a_flat_gives_the_local_coefficient():
    body = cell(friction_coefficient=0.25)
    response = solve_cell(body, Path(pressure=(0.01,) * 2, slide=((0.0, 0.0), (0.0, 0.3))))
    normal, along_x, along_y = response["traction"].values[0, 1]
    assert along_y / -normal == pytest.approx(0.25, rel=2e-3)
    assert abs(along_x) < 5e-3 * abs(normal)
    assert response["slip_fraction"].values[0, 1] == 1.0


def test_a_rotated_cell_gives_a_rotated_answer():
    turned = Surface(rough().heights.T, (1.0, 1.0))
    first, second = (
        solve_cell(
            cell(surface=surface, friction_coefficient=0.3, bulk=NeoHookean(1.0, 0.3)),
            Path(pressure=(0.01, 0.01), slide=((0.0, 0.0), slide)),
        )["traction"].values[0, 1]
        for surface, slide in ((rough(), (0.003, 0.001)), (turned, (0.001, 0.003)))
    )
    np.testing.assert_allclose(first, second[[0, 2, 1]], rtol=1e-5)


def test_inverted_elements_are_caught_by_shorter_increments():
    body = cell(surface=rough(0.5), bulk=NeoHookean(1.0, 0.3))
    height = float(np.ptp(body.surface.heights))
    response = solve_cell(body, Path(approach=(0.9 * height,)), tolerance=1e-7)
    assert response["converged"].values.all()


def test_pulling_away_leaves_nothing():
    body = cell(bulk=NeoHookean(1.0, 0.3), friction_coefficient=0.2)
    response = solve_cell(body, Path(approach=(0.01, -0.01)))
    assert response["converged"].values.all()
    np.testing.assert_allclose(response["traction"].values[0, 1], 0.0, atol=1e-12)


def test_a_viscous_cell_relaxes_to_its_soft_state():
    law = Prony(1.0, 0.3, (0.5,), (1.0,))
    path = Path(approach=(0.01, 0.01, 0.01), time=(0.0, 0.7, 60.0))
    pressure = -solve_cell(cell(bulk=law), path)["traction"].values[0, :, 0]
    at_once = -solve_cell(cell(bulk=NeoHookean(1.0, 0.3)), Path(approach=(0.01,)))["traction"]
    assert pressure[0] == pytest.approx(float(at_once.values[0, 0, 0]), rel=1e-7)
    assert pressure[0] > pressure[1] > pressure[2] > 0.4 * pressure[0]


def test_the_projected_area_of_a_deformed_surface_is_the_nominal_area():
    moved = 0.01 * np.random.default_rng(3).standard_normal((N, 3, N))
    assert current_weight(cell(), moved).sum() == pytest.approx(1.0, rel=1e-12)
    assert current_weight(cell(), 0.0 * moved) == pytest.approx(1.0 / N**2)


def test_a_rough_obstacle_is_smooth_periodic_and_moves():
    obstacle = OppositeSide(Surface(np.zeros((N, N)), (1.0, 1.0)), rough(0.3))

    def meet(moved, slide):
        return obstacle.meet(lambda u: [u], moved, 0.0, np.array(slide))

    still = np.zeros((N, 3, N))
    there, back = meet(still, (0.0, 0.0)), meet(still, (1.0, -2.0))
    np.testing.assert_allclose(back.gap, there.gap, atol=1e-12)
    next_point = meet(still, (1.0 / N, 0.0))
    np.testing.assert_allclose(next_point.gap, np.roll(there.gap, 1, axis=0), atol=1e-12)
    # nodes that move with the obstacle see no change; normals turn by their derivative
    moved = still.copy()
    moved[:, 0] = 0.013
    np.testing.assert_allclose(meet(moved, (0.013, 0.0)).gap, there.gap, atol=1e-12)
    here, step = meet(moved, (0.0, 0.0)), np.zeros_like(moved)
    step[:, 0], step[:, 2] = here.normal[:, 2], -here.normal[:, 0]  # along the obstacle
    turned = here.turn(step, 0.0, np.ones((N, N)), 0.0 * moved, 0.0 * moved)
    ahead = meet(moved + 1e-6 * step, (0.0, 0.0))
    np.testing.assert_allclose((here.normal - ahead.normal) / 1e-6, turned, atol=1e-3)
