"""Cells at large strain where it is hard: steep, incompressible, soft, with much friction."""

import numpy as np
import pytest

from multiscale.laws.bulk import J2, NeoHookean
from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.micro.finite import cell_newton
from tests.support import rough_square

RUBBER = NeoHookean(1.0, 0.3)


def rough(slope, n=16):
    return rough_square(n, 1.0, 0.5, slope)


def press(bulk, path, slope=0.1, n=16, **changes):
    cell = Cell(rough(slope, n), 0.5, 6, 1.0, bulk.poissons_ratio, bulk=bulk, **changes)
    return solve_cell(cell, path, tolerance=1e-6)


@pytest.mark.parametrize("mu", [0.0, 1.5])
def test_steep_rubber_in_almost_full_contact_converges(mu):
    response = press(RUBBER, Path(pressure=(0.05, 0.3)), 0.5, friction_coefficient=mu)
    assert response["converged"].values.all()
    assert response["contact_fraction"].values[0, 1] > 0.7


def test_much_friction_and_a_reversal_at_every_step_converge():
    slides = tuple(((-1.0) ** k * 0.01, 0.0) for k in range(4))
    path = Path(pressure=(0.02,) * 4, slide=slides)
    response = press(RUBBER, path, 0.2, friction_coefficient=1.5)
    assert response["converged"].values.all()
    forward, back = response["traction"].values[0, 2:, 1]
    assert forward * back < 0.0


def test_reversals_of_the_load_at_every_step_converge():
    response = press(
        RUBBER, Path(pressure=(0.02, 0.005, 0.03, 0.0, 0.02)), 0.2, friction_coefficient=1.5
    )
    assert response["converged"].values.all()


@pytest.mark.slow
@pytest.mark.parametrize("hardening", [0.01, 0.0], ids=["hardening", "perfect"])
def test_a_very_soft_metal_is_pressed_and_released(hardening):
    path = Path(approach=(0.002, 0.005, 0.003))
    response = press(J2(1.0, 0.3, 1e-4, hardening), path)
    assert response["converged"].values.all()
    pressure = -response["traction"].values[0, :, 0]
    assert pressure[0] < pressure[1]
    assert pressure[2] < 0.1 * pressure[1]


def test_a_step_that_creeps_is_given_up_with_the_state_it_reached(monkeypatch):
    monkeypatch.setattr(cell_newton, "MOST", 2)
    path = Path(pressure=(1e-4, 0.02))
    response = press(J2(1.0, 0.3, 0.01, 0.01), path, n=8)
    assert response["converged"].values.tolist() == [[1, 0]]
    assert np.isfinite(response["traction"].values[0, 0]).all()
    assert "step 1 ended after" in response.attrs["ended"]


def test_a_step_that_has_spent_its_linear_iterations_is_given_up(monkeypatch):
    monkeypatch.setattr(cell_newton, "LINEAR", (0, 20))
    response = press(NeoHookean(1.0, 0.3), Path(pressure=(1e-4, 0.02), increments=4), n=8)
    assert response["converged"].values.tolist() == [[1, 0]]
    assert 20 <= response["linear_iterations"].values[0, 1] < 60
    assert "linear iterations: the limit on linear iterations" in response.attrs["ended"]


def test_a_steep_nearly_incompressible_body_is_pressed():
    response = press(NeoHookean(1.0, 0.4999), Path(pressure=(0.05, 0.3)), 0.5)
    assert response["increments"].values.tolist() == [[1.0, 1.0]]
    newton, linear = response["active_set_iterations"].values, response["linear_iterations"].values
    assert np.all(linear <= 12 * newton)


def test_the_mean_surface_sinks_only_by_the_change_of_the_volume():
    """Pressures of any shape on a flat layer make it thinner like their mean."""
    nu, depth = 0.4999, 0.5
    flat = Surface(np.zeros((16, 16)), (1.0, 1.0))
    cell = Cell(flat, depth, 6, 1.0, nu, bulk=NeoHookean(1.0, nu), obstacle=rough(1e-4))
    response = solve_cell(cell, Path(approach=(1e-6,)), tolerance=1e-7)
    sunk = 1e-6 + float(response["displacement_jump"].values[0, 0, 0])
    pressure = -float(response["traction"].values[0, 0, 0])
    thinner = (1.0 + nu) * (1.0 - 2.0 * nu) / (1.0 - nu) * pressure * depth
    assert 0.0 < float(response["contact_fraction"].values[0, 0]) < 0.5
    assert sunk == pytest.approx(thinner, rel=2e-3)
