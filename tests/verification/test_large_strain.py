"""Cells with friction and at large strain against tables, closed forms and identities."""

import numpy as np
import pytest

from multiscale.laws.bulk import J2, Elastic, NeoHookean
from multiscale.micro import Cell, Path, SecondBody, Surface, layer, solve_cell
from multiscale.micro.averages import HALF_SPACE
from multiscale.micro.elastic.flat_reference import element_edges
from tests.closed_forms import mindlin
from tests.support import egg_box, flat, observed_rate, rough_square, slow, sphere


@pytest.fixture
def uniform_layers(monkeypatch):
    """The tables were made on layers of equal thickness."""
    monkeypatch.setattr(
        layer, "graded_planes", lambda depth, layers, _: np.linspace(0.0, depth, layers + 1)
    )


def pressures(bulk, approaches):
    cell = Cell(egg_box(16, 0.04), 0.5, 8, 1.0, 0.3, bulk=bulk)
    response = solve_cell(cell, Path(approach=approaches))
    assert response["converged"].values.all()
    return -response["traction"].values[0, :, 0], response


@pytest.mark.usefixtures("uniform_layers")
def test_neo_hookean_pressures_equal_the_independent_code():
    # an independent implementation on the same mesh, to all its digits
    expected = [4.92230658e-4, 2.69177554e-3, 8.13993483e-3, 1.67685398e-2]
    computed, _ = pressures(NeoHookean(1.0, 0.3), (0.004, 0.01, 0.02, 0.03))
    np.testing.assert_allclose(computed, expected, rtol=1e-7)


@pytest.mark.slow
@pytest.mark.usefixtures("uniform_layers")
def test_plastic_pressures_equal_the_independent_code():
    expected = [3.107378e-4, 8.824388e-4, 2.703120e-3, 5.289840e-3]
    approaches = tuple(0.002 * np.arange(1, 16))  # the increments belong to the answer
    computed, response = pressures(J2(1.0, 0.3, 1.0 / 200.0, 0.01), approaches)
    assert np.all(response["increments"] == 1.0)
    np.testing.assert_allclose(computed[[1, 4, 9, 14]], expected, rtol=1e-6)


def test_rubber_on_a_fine_grid_takes_few_iterations():
    n = 64
    surface = rough_square(n, 1.0, 0.25, 0.2)
    cell = Cell(surface, 1.0, 16, 1.0, 0.3, bulk=NeoHookean(1.0, 0.3))
    response = solve_cell(cell, Path(pressure=(0.05,)))
    assert response["increments"].values[0, 0] == 1.0
    assert response["active_set_iterations"].values[0, 0] <= 8
    assert response["linear_iterations"].values[0, 0] <= 40


@pytest.mark.slow
def test_plastic_increments_take_few_iterations():
    approaches = tuple(0.002 * np.arange(1, 16))
    _, response = pressures(J2(1.0, 0.3, 1.0 / 500.0, 0.01), approaches)
    newton = response["active_set_iterations"].values[0]
    assert np.all(response["increments"] == 1.0)  # none was cut
    assert newton.max() <= 10
    assert response["linear_iterations"].values.sum() <= 12 * newton.sum()
    assert response["contact_fraction"].values[0, -1] > 0.28


@pytest.mark.slow
@pytest.mark.usefixtures("uniform_layers")
def test_plastic_pressures_tend_to_a_limit_as_increments_shrink():
    law = J2(1.0, 0.3, 1.0 / 200.0, 0.01)
    results = [pressures(law, tuple(np.linspace(0.0, 0.01, k + 1)[1:]))[0][-1] for k in (5, 10, 20)]
    first, second = results[1] - results[0], results[2] - results[1]
    limit = results[2] + second
    assert abs(second) < 0.8 * abs(first)
    assert limit == pytest.approx(8.8559e-4, rel=0.01)  # quartered steps of the independent code


@pytest.mark.parametrize(
    ("layers", "opposite"),
    [(16, None), (12, SecondBody(1.0, 12, Elastic(1.0, 0.3)))],
    ids=["one body", "two bodies"],
)
def test_tangential_over_normal_stiffness(layers, opposite):
    surface, nu, loads = rough_square(32, 0.5, 0.25, 0.02, seed=3), 0.3, (0.002, 0.00204)
    step = 1e-3 * surface.heights.std()
    pressed, sheared = (
        solve_cell(
            Cell(surface, 1.0, layers, 1.0, nu, friction_coefficient=mu, opposite=opposite), path
        )
        for mu, path in (
            (0.0, Path(pressure=loads)),
            (1e3, Path(pressure=loads[:1] * 2, slide=((0.0, 0.0), (step, 0.0)))),
        )
    )
    assert sheared["slip_fraction"].values[0, 1] == 0.0
    stiffness = [
        float(np.diff(response["traction"].values[0, :, k])[0])
        / float(np.diff(response["displacement_jump"].values[0, :, k])[0])
        for response, k in ((pressed, 0), (sheared, 1))
    ]
    assert stiffness[1] / stiffness[0] == pytest.approx(2.0 * (1.0 - nu) / (2.0 - nu), rel=0.05)


@pytest.mark.parametrize("bulk", [None, NeoHookean(1.0, 0.3)], ids=["small", "large strain"])
@pytest.mark.parametrize("mu", [*slow(0.0), 0.2])
def test_sliding_up_an_inclined_facet(bulk, mu):
    n, tangent, rise = 64, 0.1, 0.8
    x = np.arange(n) / n
    ramp = np.where(x < rise, tangent * x, tangent * rise * (1.0 - x) / (1.0 - rise))
    obstacle = np.tile(ramp[:, None], (1, 2))
    inside = (0.3 * rise < x) & (x < 0.6 * rise)
    body = obstacle - np.where(inside, 0.0, 0.02)[:, None]
    size = (1.0, 2.0 / n)
    cell = Cell(
        Surface(body, size),
        1.0,
        12,
        1.0,
        0.3,
        obstacle=Surface(obstacle, size),
        bulk=bulk,
        friction_coefficient=mu,
    )
    response = solve_cell(cell, Path(pressure=(1e-4,) * 3, slide=((0, 0), (0.02, 0), (-0.02, 0))))
    normal, along, across = np.moveaxis(response["traction"].values[0], -1, 0)
    assert response["converged"].values.all()
    # up the facet and down again
    expected = (tangent + mu) / (1.0 - mu * tangent), (tangent - mu) / (1.0 + mu * tangent)
    np.testing.assert_allclose(-along[1:] / normal[1:], expected, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(across, 0.0, atol=1e-10)


MU, CONTACT_RADIUS = 0.4, 0.16


def sheared_sphere(n, layers, shares, increments=1):
    """Press a sphere, nu = .499, and shear it to shares of the limit of friction.

    Returns the cell, its response, the forces over the limit, and the limit with the modulus.
    """
    nu, radius, a = 0.499, 10.0, CONTACT_RADIUS
    limit = MU * 4.0 / (1.0 - nu**2) * a**3 / (3.0 * radius)
    modulus = mindlin.tangential_modulus((1.0, nu))
    cell = Cell(flat(n), 1.0, layers, 1.0, nu, sphere(n, radius), friction_coefficient=MU)
    slides = [
        (float(np.sign(s) * mindlin.tangential_displacement(abs(s), limit, a, modulus)), 0.0)
        for s in (0.0, *shares)
    ]
    path = Path(pressure=(limit / MU,) * len(slides), slide=tuple(slides), increments=increments)
    response = solve_cell(cell, path, tolerance=1e-7)
    assert response["converged"].values.all()
    return cell, response, response["traction"].values[0, :, 1] / limit, (limit, a, modulus)


@pytest.mark.long
def test_the_stick_area_tends_to_the_area_of_cattaneo_and_mindlin_as_the_grid_is_refined():
    """Nodes in contact reach beyond its edge, and those that stick beyond theirs by less."""
    grids, a, errors, blurred = np.array([32, 64, 96]), CONTACT_RADIUS, [], []
    for n, layers in zip(grids, (16, 24, 30), strict=True):
        cell, response, ratio, _ = sheared_sphere(n, layers, (0.4, 0.8))
        stick, inner = (
            1.0 - response["slip_fraction"].values[0, 1:],
            mindlin.stick_radius(ratio[1:]),
        )
        errors.append(np.max(np.abs(stick / inner**2 - 1.0)))
        reach = element_edges(cell)[0].reach / (n * a)
        seen = (inner + HALF_SPACE.reach / (n * a)) / (1.0 + reach)
        blurred.append(np.max(np.abs(stick / seen**2 - 1.0)))
    assert observed_rate(1.0 / grids, errors) > 1.0
    assert errors[-1] < 0.02
    assert blurred[-1] < 0.01


@pytest.mark.long
def test_a_sphere_in_partial_slip_follows_cattaneo_and_mindlin():
    losses = []
    for increments in (4, 8):
        _, response, ratio, theory = sheared_sphere(64, 24, (0.8, -0.8, 0.8), increments)
        work = response["friction_work"].values[0]
        losses.append((work[3] - work[1]) / mindlin.loop_energy(ratio[3], *theory))
    assert ratio[3] == pytest.approx(ratio[1], rel=2e-3)  # the loop closes
    assert ratio[2] == pytest.approx(-ratio[1], rel=2e-3)
    # backward steps dissipate too much, in proportion to their length
    assert losses[1] == pytest.approx(1.0, abs=0.02)
    assert 2.0 * losses[1] - losses[0] == pytest.approx(1.0, abs=0.02)
    stick = 1.0 - response["slip_fraction"].values[0, 1]
    assert stick == pytest.approx(mindlin.stick_radius(ratio[1]) ** 2, abs=0.06)


@pytest.mark.slow
def test_the_work_of_friction_is_the_work_done_on_the_obstacle():
    """Over a closed loop the elastic energy returns, whatever the mean surface did."""
    surface = egg_box(16, 0.02)
    errors = []
    for increments in (8, 32):
        cell = Cell(surface, 1.0, 8, 1.0, 0.3, friction_coefficient=0.3)
        amplitude = 0.01
        turns = np.concatenate([[0.0, 1.0], np.linspace(1.0, -1.0, increments + 1)[1:]])
        turns = np.concatenate([turns, np.linspace(-1.0, 1.0, increments + 1)[1:]]) * amplitude
        path = Path(approach=(0.01,) * len(turns), slide=tuple((s, 0.0) for s in turns))
        response = solve_cell(cell, path)
        force = response["traction"].values[0, 1:, 1]
        work = float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(turns[1:])))
        loss = response["friction_work"].values[0]
        errors.append(abs((loss[-1] - loss[1]) / work - 1.0))
    assert errors[1] < 0.02
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.long
def test_a_sphere_on_a_perfectly_plastic_body_has_a_hardness_of_three_yield_stresses():
    n, yield_stress, radius = 64, 1e-3, 2.0
    law = J2(1.0, 0.3, yield_stress)
    cell = Cell(flat(n), 1.0, 20, 1.0, 0.3, obstacle=sphere(n, radius), bulk=law)
    path = Path(approach=(0.002, 0.003, 0.004, 0.005, 0.006))
    response = solve_cell(cell, path, tolerance=1e-4)
    area = response["contact_fraction"].values[0]
    share = np.sqrt(area / np.pi) / radius
    hardness = -response["traction"].values[0, :, 0] / area / yield_stress
    plastic = share / yield_stress / (1.0 - 0.3**2) > 65.0  # E* a / sigma_y R
    assert plastic.sum() == 3
    assert np.all(share < 0.1)
    assert np.all((hardness[plastic] > 2.8) & (hardness[plastic] < 3.0))
    assert np.ptp(hardness[plastic]) < 0.03  # the radius is 8 to 10 points and rises by a fourth


@pytest.mark.long
def test_the_mean_pressure_of_rough_plastic_contact_over_the_yield_stress_is_a_curve():
    """Spots of a metal carry about three yield stresses until they grow together."""
    n = 16
    surface = rough_square(n, 1.0, 0.25, 0.2)
    height = 0.5 * float(np.ptp(surface.heights))
    path = Path(approach=tuple(height * np.array([0.2, 0.4, 0.6, 0.8, 1.0])))
    curves, areas = [], []
    for ratio in (100.0, 500.0):
        cell = Cell(surface, 0.5, 6, 1.0, 0.3, bulk=J2(1.0, 0.3, 1.0 / ratio, 0.01))
        response = solve_cell(cell, path, tolerance=1e-5)
        assert response["converged"].values.all()
        areas.append(response["contact_fraction"].values[0])
        curves.append(-response["traction"].values[0, :, 0] / areas[-1] * ratio)
    hard, soft = curves
    # the first spots are few points; hardening, elasticity and the depth raise the rest
    np.testing.assert_allclose(hard[1:], 3.0, rtol=0.15)
    np.testing.assert_allclose(soft[1:], 4.0, rtol=0.15)
    assert np.all(np.diff(areas, axis=1) > 0.0)
    assert np.all(areas[1] > areas[0])
    assert np.all(soft > 0.8 * hard)
