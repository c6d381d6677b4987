"""Two deformable bodies against one body, against closed forms, and against an independent code."""

import numpy as np
import pytest

from multiscale.laws.bulk import J2, Elastic, NeoHookean
from multiscale.micro import Cell, Path, SecondBody, solve_cell
from multiscale.micro.finite.cell_newton import walk_step
from multiscale.micro.finite.finite_cell import make_scene
from multiscale.micro.layer import graded_planes
from multiscale.micro.path import Target
from tests.closed_forms import mindlin
from tests.support import egg_box, flat, sphere

STEEL = J2(1.0, 0.3, 0.005, 0.01)
RUBBER = NeoHookean(1.0, 0.3)


def body(bulk=None, modulus=1.0, layers=8):
    return SecondBody(0.5, layers, bulk or Elastic(modulus, 0.3))


@pytest.mark.parametrize(
    "bulk",
    [
        pytest.param(None, id="elastic"),
        pytest.param(RUBBER, id="rubber"),
        pytest.param(STEEL, id="steel", marks=pytest.mark.slow),
    ],
)
def test_two_equal_bodies_are_one_body_on_a_rigid_flat_half_way_between(bulk):
    """But for the splines of the second, which are not flat across the edge of a contact."""
    n, far = 16, 0.01
    direct, other = egg_box(n, 0.02), egg_box(n, -0.02)
    path = {"increments": 4}
    response = solve_cell(Cell(direct, 0.5, 8, 1.0, 0.3, bulk=bulk), Path(approach=(far,), **path))
    two = solve_cell(
        Cell(direct, 0.5, 8, 1.0, 0.3, bulk=bulk, obstacle=other, opposite=body(bulk)),
        Path(approach=(2.0 * far,), **path),
    )
    pressure = response["traction"].values[0, 0, 0]
    assert two["traction"].values[0, 0, 0] == pytest.approx(pressure, rel=1e-3)
    np.testing.assert_allclose(two["traction"].values[0, 0, 1:], 0.0, atol=1e-7 * abs(pressure))
    assert two["mean_gap"].values == pytest.approx(2.0 * response["mean_gap"].values, rel=1e-4)
    np.testing.assert_allclose(
        two["displacement_jump"].values[0, 0, 0],
        2.0 * response["displacement_jump"].values[0, 0, 0],
        rtol=1e-4,
    )
    area = response["contact_fraction"].values
    assert two["contact_fraction"].values == pytest.approx(area, rel=5e-3)


def test_two_equal_bodies_tend_to_one_at_third_order():
    errors = []
    for n, layers in ((8, 4), (16, 8), (32, 12)):
        direct = egg_box(n, 0.02)
        entry = Cell(direct, 0.5, layers, 1.0, 0.3)
        two = Cell(direct, 0.5, layers, 1.0, 0.3, egg_box(n, -0.02), opposite=body(layers=layers))
        pressure = [
            solve_cell(cell, Path(approach=(far,)))["traction"].values[0, 0, 0]
            for cell, far in ((entry, 0.01), (two, 0.02))
        ]
        errors.append(abs(pressure[1] / pressure[0] - 1.0))
    assert errors[0] < 1e-3
    assert errors[2] < 0.05 * errors[0]


def test_a_very_stiff_opposite_body_is_a_rigid_obstacle():
    n, errors = 16, []
    obstacle = egg_box(n, 0.02)
    path = Path(approach=(0.008,) * 2, slide=((0.0, 0.0), (0.1, 0.05)))
    rigid = Cell(
        egg_box(n, 0.02), 0.5, 8, 1.0, 0.3, obstacle, bulk=RUBBER, friction_coefficient=0.3
    )
    expected = solve_cell(rigid, path)["traction"].values[0]
    for modulus in (1e2, 1e4):
        cell = Cell(
            egg_box(n, 0.02), 0.5, 8, 1.0, 0.3, obstacle, bulk=RUBBER, friction_coefficient=0.3,
            opposite=body(modulus=modulus),
        )  # fmt: skip
        computed = solve_cell(cell, path)["traction"].values[0]
        errors.append(np.abs(computed - expected).max() / np.abs(expected).max())
    assert errors[1] < 3e-4
    assert errors[1] == pytest.approx(0.01 * errors[0], rel=0.2)


@pytest.mark.parametrize("slide", [0.0, 0.013], ids=["aligned", "shifted"])
@pytest.mark.parametrize("points", [16, 8], ids=["same grid", "half the points"])
def test_flat_bodies_carry_a_uniform_pressure(points, slide):
    """The patch test through the interface."""
    cell = Cell(flat(16), 0.5, 4, 1.0, 0.3, flat(points), opposite=body(layers=4))
    response = solve_cell(
        cell, Path(pressure=(0.01,), slide=((slide, 0.0),)), keep_fields=True, tolerance=1e-12
    )
    np.testing.assert_allclose(response["pressure"].values, 0.01, rtol=1e-9)
    assert response["contact_fraction"].values == pytest.approx(1.0)


def test_flat_bodies_on_grids_that_do_not_match_err_by_motions_between_nodes():
    """Forces of nodes are no pressure for the other side unless its points divide them."""
    cell = Cell(flat(16), 0.5, 4, 1.0, 0.3, flat(12), opposite=body(layers=4))
    response = solve_cell(cell, Path(pressure=(0.01,)), keep_fields=True)
    np.testing.assert_allclose(response["pressure"].values, 0.01, rtol=0.1)
    # the mean is exact, as in oedometers: two layers with their shares of one pressure
    oedometer = 0.5 * (1.0 + 0.3) * (1.0 - 2.0 * 0.3) / (1.0 - 0.3)
    approach = -response["displacement_jump"].values[0, 0, 0]
    assert abs(approach) < 1e-2 * 2.0 * 0.01 * oedometer


def test_the_work_of_friction_is_the_load_times_the_slip():
    mu, pressure, far = 0.25, 0.002, 0.2
    cell = Cell(
        flat(8), 0.5, 4, 1.0, 0.3, flat(8), friction_coefficient=mu, opposite=body(layers=4)
    )
    response = solve_cell(
        cell, Path(pressure=(pressure,) * 3, slide=((0, 0), (far, 0), (2 * far, 0)))
    )
    normal, along, across = response["traction"].values[0, -1]
    assert along == pytest.approx(-mu * normal, rel=1e-6)
    assert abs(across) < 1e-9 * pressure
    work = response["friction_work"].values[0]
    assert work[2] - work[1] == pytest.approx(mu * pressure * far, rel=1e-6)


def over_one_wavelength(n, layers, mu, *, steps=8, bulk=None):
    """Table: two equal egg boxes of amplitude .02, .044 nearer than first touch."""
    amplitude = 0.02
    cell = Cell(
        egg_box(n, amplitude), 0.5, layers, 1.0, 0.3, egg_box(n, -amplitude),
        bulk=bulk, friction_coefficient=mu, opposite=body(bulk, layers=layers),
    )  # fmt: skip
    slide = tuple((place, 0.0) for place in (np.arange(steps) + 0.5) / steps)
    response = solve_cell(cell, Path(approach=(2.2 * amplitude,) * steps, slide=slide))
    assert response["converged"].values.all()
    normal, along, _ = np.moveaxis(response["traction"].values[0], -1, 0)
    return -normal, along


@pytest.mark.parametrize(("n", "layers"), [(16, 8), pytest.param(32, 12, marks=pytest.mark.slow)])
def test_friction_over_one_wavelength_agrees_with_the_independent_code(n, layers):
    pressure, shear = over_one_wavelength(n, layers, 0.2)
    # an independent implementation, n = 32: mean .1998, between .13 and .27
    assert shear.sum() / pressure.sum() == pytest.approx(0.1998, rel=0.01)
    assert (shear / pressure).min() == pytest.approx(0.13, abs=0.005)
    assert (shear / pressure).max() == pytest.approx(0.27, abs=0.005)
    if n == 32:
        expected = [0.01719, 0.01517, 0.01125, 0.00653, 0.00632, 0.01086, 0.01476, 0.01702]
        np.testing.assert_allclose(pressure, expected, rtol=0.003)


@pytest.mark.parametrize(
    "bulk",
    [pytest.param(None, id="elastic"), pytest.param(RUBBER, id="rubber", marks=pytest.mark.slow)],
)
def test_without_friction_a_wavelength_costs_nothing(bulk):
    pressure, shear = over_one_wavelength(16, 8, 0.0, bulk=bulk)
    assert abs(shear.sum()) < 1e-8 * pressure.sum()
    assert np.abs(shear / pressure).max() > 0.05


@pytest.mark.long
def test_equal_spheres_in_partial_slip_follow_cattaneo_and_mindlin():
    """Equal bodies have no coupling of normal and tangential motion, at any Poisson's ratio."""
    n, layers, nu, mu, radius, a = 64, 16, 0.3, 0.4, 10.0, 0.16
    modulus = 1.0 / (2.0 * (1.0 - nu**2))
    force = 4.0 * modulus * a**3 / (3.0 * radius)
    far = float(
        mindlin.tangential_displacement(
            0.8, mu * force, a, mindlin.tangential_modulus((1.0, nu), (1.0, nu))
        )
    )
    cell = Cell(
        flat(n), 1.0, layers, 1.0, nu, sphere(n, radius), friction_coefficient=mu,
        opposite=SecondBody(1.0, layers, Elastic(1.0, nu)),
    )  # fmt: skip
    path = Path(pressure=(force,) * 2, slide=((0.0, 0.0), (far, 0.0)), increments=4)
    response = solve_cell(cell, path, tolerance=1e-7)
    assert response["converged"].values.all()
    area = response["contact_fraction"].values[0]
    assert np.sqrt(area[0] / np.pi) == pytest.approx(a, rel=0.05)
    ratio = response["traction"].values[0, 1, 1] / (mu * force)
    assert 0.5 < ratio < 0.95
    stick = 1.0 - response["slip_fraction"].values[0, 1]
    assert stick == pytest.approx(mindlin.stick_radius(ratio) ** 2, abs=0.06)


def plough(increments, mu):
    """Work per area of an elastic egg box that ploughs a flat of steel, and where it went."""
    n, layers, far = 16, 5, 0.006
    cell = Cell(
        flat(n), 0.5, layers, 1.0, 0.3, egg_box(n, 0.02), bulk=STEEL, friction_coefficient=mu,
        opposite=body(layers=layers),
    )  # fmt: skip
    scene = make_scene(cell)
    down = [(far * share, 0.0) for share in np.linspace(0.0, 1.0, 7)[1:]]
    along = [(far, share) for share in np.linspace(0.0, 0.25, increments + 1)[1:]]
    up = [(far * share, 0.25) for share in np.linspace(1.0, -0.2, 9)[1:]]
    state, work = scene.rest(), 0.0
    for approach, slide in down + along + up:
        before = state
        target = Target(None, approach, np.array([slide, 0.0]))
        walk = walk_step(scene, state, target, increments=1, tolerance=1e-6)
        assert walk.reached == 1.0
        state = walk.state
        force = 0.5 * (before.force + state.force).sum((0, 2))
        work += force[0] * (state.slide - before.slide)[0]
        work -= force[2] * (state.approach - before.approach)
    plastic = state.material[0][..., 6, :n]  # accumulated strain at the Gauss points
    heights = np.diff(graded_planes(0.5, layers, 1.0 / n))
    volume = heights[None, :, None, None, None] / n**2 / 8.0
    taken = STEEL.yield_stress * plastic + 0.5 * STEEL.hardening_modulus * plastic**2
    return np.array([work, float(np.sum(volume * taken)), state.dissipation])


@pytest.mark.long
@pytest.mark.parametrize("mu", [0.0, 0.2], ids=["smooth", "friction"])
def test_ploughing_costs_what_plastic_flow_and_friction_take(mu):
    coarse, fine = plough(16, mu), plough(32, mu)
    work, plastic, friction = 2.0 * fine - coarse  # errors in proportion to the increments
    assert abs(fine[0] - coarse[0]) < 0.15 * fine[0]
    left = work - plastic - friction  # elastic energy of stresses that remain
    assert 0.0 < left < 0.25 * plastic
    assert friction == 0.0 if mu == 0.0 else friction > plastic
