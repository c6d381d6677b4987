"""Biaxial compression of a periodic cell of grains: closed forms, balance, plausible friction."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.macro import granulate
from multiscale.macro.granulate import ContactLaw, Grains, Model, Solver, simulate_grains
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


@pytest.mark.long
def test_the_bulk_of_spheres_bears_more_shear_than_smooth_plates_pass_on():
    # spheres roll on the plates of a simple shear, which slide before the bulk yields
    radii, law = granulate.draw_radii(300, 0.009, 0.011), ContactLaw(0.5, compliance=0.02)
    _, step = granulate.biaxial_cell(radii, PRESSURE, 0.0, law)
    model, step = granulate.biaxial_cell(radii, PRESSURE, 4e-4 / step, law)
    result = simulate_grains(model, 250 * step, step)
    bulk = float(granulate.biaxial_curve(result)["mobilised_friction"][125:].mean())
    assert 0.25 < bulk < 0.45  # 20 degrees or so for spheres of 0.5
    shear = granulate.shear_response(
        radii, (0.14, 0.14), [PRESSURE], [0.05], law, n_realisations=1, n_steps=300
    )
    plates = -float(shear["traction"][0, 0, 1] / shear["traction"][0, 0, 0])
    assert 0.05 < plates < bulk
