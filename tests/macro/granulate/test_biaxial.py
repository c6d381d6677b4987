"""Biaxial compression of a periodic cell of grains: closed forms, balance, plausible friction."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.macro import granulate
from multiscale.macro.granulate import ContactLaw, Grains, Model, Solver, simulate_grains
from multiscale.macro.granulate.grain_motion import initial_state, step_grains
from tests.support import slow

PRESSURE, RADIUS = 1e3, 0.01  # Pa, m


def lattice(friction, rate):
    """Discs in a triangular lattice with rows along x, four by four, and a resolving step."""
    column, row = (k.ravel() for k in np.meshgrid(np.arange(4), np.arange(4)))
    a, b = RADIUS, 3.0**0.5 * RADIUS
    position = np.column_stack([(2.0 * column + row % 2) * a, 0.0 * row, row * b])
    grains = Grains(position, RADIUS, thickness=1.0)
    step = 0.2 * float(np.sqrt(grains.mass[0] / PRESSURE))
    model = Model(
        grains,
        law=ContactLaw(friction),
        gravity=(0.0, 0.0, 0.0),
        period=(8.0 * a, np.inf, 4.0 * b),
        damping_rate=float(np.log(2.0)) / step,
        pressure=PRESSURE,
        strain_rate=(None, None, -rate / step),
    )
    return model, step


@pytest.mark.slow
@pytest.mark.parametrize("friction", [*slow(0.0, 0.2), 0.4])
def test_a_triangular_lattice_of_discs_follows_rowes_closed_form(friction):
    # rows part along x, so that contacts inclined at the angle t bear the load: where they slip,
    # the stress ratio is tan(t) tan(t + atan(mu)) (Rowe, 1962). Rows that roll keep below it.
    model, step = lattice(friction, 1e-5)
    result = simulate_grains(model, 40 * step, step, solver=Solver(1e-8, 20000))
    assert result["converged"].values.all()
    a, b = result["period"].values[-1, 0] / 8.0, result["period"].values[-1, 2] / 4.0
    assert a**2 + b**2 == pytest.approx(4.0 * RADIUS**2, rel=1e-7)
    axial, lateral = -result["stress"].values[-1, [2, 0]]
    assert lateral == pytest.approx(PRESSURE, rel=1e-6)
    angle, ratio = np.arctan(b / a), axial / lateral
    slips = np.tan(angle) * np.tan(angle + np.arctan(friction))
    if friction == 0.0:
        assert ratio == pytest.approx(slips, rel=1e-4)
    else:
        assert (b / a) ** 2 < ratio < slips
    curve = granulate.biaxial_curve(result).isel(step=-1)
    assert float(curve["axial_strain"]) == pytest.approx(4e-4, rel=1e-4)
    assert float(curve["stress_ratio"]) == pytest.approx((ratio - 1.0) / (ratio + 1.0), rel=1e-12)
    b = 3.0**0.5 * RADIUS * np.exp(-4e-4)
    dilated = 4e-4 - np.log(np.sqrt(4.0 * RADIUS**2 - b**2) / RADIUS)
    assert float(curve["volumetric_strain"]) == pytest.approx(dilated, rel=1e-3)


@pytest.fixture(scope="module", params=[*slow(0.0), 0.5])
def test_run(request):
    """Friction, model, step and 8 % of axial strain of a small packing of discs."""
    radii = np.where(np.arange(100) % 2, 0.01, 0.014)
    law = ContactLaw(request.param, compliance=0.02)
    _, step = granulate.biaxial_cell(radii[:30], PRESSURE, 0.0, law, planar=True)
    rate = 4e-4 / step
    solver = Solver(max_iterations=500)
    model, step = granulate.biaxial_cell(radii, PRESSURE, rate, law, planar=True, solver=solver)
    return request.param, model, step, simulate_grains(model, 0.08 / rate, step)


def test_friction_of_the_bulk_is_small_without_friction_and_plausible_with_it(test_run):
    friction, _, _, result = test_run
    curve = granulate.biaxial_curve(result)
    late = float(curve["mobilised_friction"][result.sizes["step"] // 2 :].mean())
    low, high = (0.03, 0.2) if friction == 0.0 else (0.25, 0.45)
    assert low < late < high
    np.testing.assert_allclose(curve["mobilised_friction"], curve["stress_ratio"], rtol=1e-12)
    assert np.abs(curve["volumetric_strain"].values).max() < 0.05


def test_lateral_stress_and_pressure_balance_the_cell_in_every_step(test_run):
    _, model, step, result = test_run
    width = np.append(model.period[0], result["period"].values[:, 0])
    height = np.append(model.period[2], result["period"].values[:, 2])
    rate = np.append(0.0, (width[1:] / width[:-1] - 1.0) / step)
    inertia = float(model.grains.mass.sum()) * (2.0 * float(model.grains.radius.mean())) ** 2
    lateral = PRESSURE + inertia * np.diff(rate) / (step * width[:-1] * height[:-1])
    np.testing.assert_allclose(-result["stress"].values[:, 0], lateral, rtol=1e-9)
    late = -result["stress"].values[result.sizes["step"] // 2 :, 0]
    assert late.mean() == pytest.approx(PRESSURE, rel=5e-3)


@pytest.mark.slow
def test_at_rest_the_lateral_stress_is_the_pressure_and_the_network_bears_it(test_run):
    _, model, step, result = test_run
    period = tuple(result["period"].values[-1].tolist())
    last = result["position"].values[-1]
    changed = replace(
        model,
        grains=model.grains.moved(last, np.zeros_like(last)),
        law=replace(model.law, compliance=0.0),
        period=period,
        strain_rate=(None, None, 0.0),
    )
    rest = simulate_grains(changed, 400 * step, step, solver=Solver(1e-6, 5000))
    assert float(rest["strain"].values[-1, 2]) == 0.0
    assert -float(rest["stress"].values[-1, 0]) == pytest.approx(PRESSURE, rel=1e-5)
    _, force, branch = granulate.network(rest)
    volume = float(np.prod(rest["period"].values[-1][[0, 2]]))
    stress = -force.T @ branch / volume  # Love and Weber
    assert stress[0, 0] == pytest.approx(-PRESSURE, rel=1e-3)
    assert stress[0, 2] == pytest.approx(stress[2, 0], abs=1e-2 * PRESSURE)


def test_energy_of_rigid_grains_never_grows_without_work(test_run):
    _, model, step, _ = test_run
    rigid = replace(model, law=replace(model.law, compliance=0.0))
    result = simulate_grains(rigid, 60 * step, step, solver=Solver(max_iterations=3000))
    energy = (result["kinetic_energy"] - result["work"]).values
    scale = float(np.abs(result["work"]).max())
    assert np.diff(energy).max() < 1e-6 * scale
    lost = sum(result[f"{name}_dissipation"] for name in ("contact", "numerical", "damping"))
    assert np.ptp((energy + lost).values) < 1e-12 * scale


def sine(stress):
    """Sine of the mobilised friction of a stress in the plane x, z."""
    across, shear = 0.5 * (stress[2, 2] - stress[0, 0]), 0.5 * (stress[0, 2] + stress[2, 0])
    return 2.0 * np.hypot(across, shear) / abs(stress[0, 0] + stress[2, 2])


def plane_strain(seed, inertial):
    """Sine of the friction that 100 spheres mobilise, shortened along z without strain along y."""
    radii, solver = granulate.draw_radii(100, 0.004, 0.006, seed=seed), Solver(1e-2, 300, 0)
    packing = granulate.compact(
        radii, PRESSURE, ContactLaw(0.5), max_steps=400, solver=solver, seed=seed
    )
    grains = Grains(packing["position"].values[-1], packing["radius"].values)
    rate = 0.5 * inertial / 0.01 * np.sqrt(PRESSURE / 2600.0)
    step = 2e-3 * np.sqrt(2600.0 / PRESSURE)
    model = Model(
        grains,
        (),
        ContactLaw(0.5),
        (0.0, 0.0, 0.0),
        tuple(packing["period"].values[-1]),
        np.log(2.0) / step,
        PRESSURE,
        (None, 0.0, -rate),
    )
    stress = simulate_grains(model, 0.4 / rate, step, solver=solver)["stress"].values
    return sine(np.diag(stress[len(stress) // 4 :].mean(axis=0)))


def test_grains_that_fly_in_a_short_period_are_pressed_to_the_same_height_at_all_pressures():
    radii = granulate.draw_radii(60, 0.004, 0.006, seed=0)
    pressed = (
        granulate.shear_layer(
            radii, (0.05, 0.04), p, 0.5, ContactLaw(0.5), solver=Solver(1e-2, 300, 0), seed=1
        )[0]
        for p in (5e2, 3.2e4)
    )
    low, high = (model.walls[1].point[2] for model in pressed)
    assert low == pytest.approx(high, rel=1e-6)  # rigid grains have no scale of pressure
    assert 2.0 * radii.max() < low < 0.05


def plane_shear(seed, inertial, rough):
    """Sine of the friction in the middle half of sheared spheres, and their share of the rate.

    Grains next to a rough plate move with it; the plate is ten times as heavy as all grains.
    """
    n, edge, d = 200, 0.05, 0.01
    law, solver = ContactLaw(0.5), Solver(1e-2, 300, 0)
    radii = granulate.draw_radii(n, 0.004, 0.006, seed=seed)
    model, step = granulate.shear_layer(
        radii, (edge, edge), PRESSURE, 0.0, law, plate_mass=0.1, solver=solver, seed=seed
    )
    grains, (low, high) = model.grains, model.walls
    z, top = grains.position[:, 2], high.point[2]
    held, moved = (rough * (way - grains.radius < 0.3 * d) > 0 for way in (z, top - z))
    speed = inertial * (top - 2.0 * d * rough) / d * np.sqrt(PRESSURE / 2600.0)
    if rough:
        weight, density = 10.0 * grains.mass.sum(), np.full(n, 2600.0)
        density[moved] *= weight / grains.mass[moved].sum()
        density[held] *= 1e6
        fall = (0.0, 0.0, -PRESSURE * edge**2 / weight)
        floor = granulate.PlaneWall((0.0, 0.0, -3.0 * d), (0.0, 0.0, 1.0))
        heavy = Grains(grains.position, grains.radius, density)
        model = Model(heavy, (floor,), law, fall, model.period)
    else:
        model = replace(model, walls=(low, replace(high, velocity=(speed, 0.0, 0.0))))
    state, stress, rates = initial_state(model), [], []
    step = min(step, 0.1 * d / speed)
    steps = int(10.0 * d / (speed * step))
    for k in range(steps):
        velocity, position = state.velocity.copy(), state.position.copy()
        rise = velocity[:n][moved, 2].mean() if rough else 0.0
        velocity[:n][held], velocity[:n][moved] = 0.0, 0.0
        velocity[:n][moved, :3] = speed, 0.0, rise
        position[held] = grains.position[held]
        state, _ = step_grains(
            model, replace(state, velocity=velocity, position=position), step, solver
        )
        if k < steps // 3:
            continue
        contacts, z = state.contacts, state.position[:, 2]
        i, j = contacts.ends.T
        height = 0.5 * (z[i] + np.append(z, [0.0, 0.0])[j])
        bulk = (j < n) & (np.abs(height / top - 0.5) < 0.25)
        stress.append(contacts.vectors[bulk].T @ contacts.branch[bulk])
        x = state.velocity[:n, 0]
        quarters = [x[np.abs(z / top - place) < 0.1].mean() for place in (0.3, 0.7)]
        rates.append(np.diff(quarters)[0] / 0.4 / speed)
    return sine(np.mean(stress, axis=0)), np.mean(rates)


@pytest.mark.slow
def test_the_bulk_between_rough_plates_has_the_friction_of_a_cell_in_plane_strain():
    """Smooth plates slide before the bulk flows."""
    inertial = 0.02
    cells = [plane_strain(seed, inertial) for seed in range(3)]
    sheared, rates = zip(*(plane_shear(seed, inertial, True) for seed in range(2)), strict=True)
    assert abs(np.mean(sheared) - np.mean(cells)) < 0.09  # means of .38 and .42
    assert min(rates) > 0.8
    smooth, rate = plane_shear(0, inertial, False)
    assert smooth < 0.75 * np.mean(cells)
    assert rate < 0.5
