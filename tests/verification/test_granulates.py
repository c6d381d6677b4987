"""Granulates against closed forms and published numbers; the tolerances are theirs."""

import numpy as np
import pytest
from scipy.optimize import curve_fit

from multiscale.macro import granulate
from multiscale.macro.granulate import ContactLaw, Solver
from multiscale.upscaling import fit_law, friction_observations
from tests.closed_forms import janssen


def silo_profile(result, frame, diameter, above):
    """Mean vertical stress at levels of a silo from the balance of what lies above, Pa."""
    n, area = result.sizes["grain"], 0.25 * np.pi * diameter**2
    ends, force, _ = granulate.network(result, frame)
    step = int(result["frame_step"][frame])
    z = result["position"].values[frame, :, 2] - float(result["wall_position"][step, 0, 2])
    top = np.sort(z + result["radius"].values)[-10]
    weight, wall = 9.81 * result["mass"].values, ends[:, 1] == n + 1
    levels = np.linspace(above, top - above, 8)
    stress = [
        (weight[z > level].sum() - force[wall, 2][z[ends[wall, 0]] > level].sum()) / area
        for level in levels
    ]
    return top - levels, np.array(stress), float(weight.sum()) / (9.81 * area * top)


@pytest.mark.long
def test_the_wall_of_a_silo_bears_the_weight_as_by_janssen():
    radii, diameter, friction = granulate.draw_radii(1200, 0.003, 0.0035), 0.05, 0.5
    law = ContactLaw(0.5, compliance=0.05)
    model = granulate.silo(radii, diameter, law, wall_friction=friction, sinking=0.005)
    result = granulate.simulate_grains(model, 0.8, 1e-3, n_frames=17)
    assert result["converged"].values.mean() >= 0.99
    profiles = [silo_profile(result, frame, diameter, 0.02) for frame in range(-5, 0)]
    depth, stress, density = (np.mean(parts, axis=0) for parts in zip(*profiles, strict=True))

    def stress_at(depth, ratio):
        length = janssen.screening_length(diameter, friction, ratio)
        return janssen.vertical_stress(depth, density, length)

    (ratio,), _ = curve_fit(stress_at, depth, stress, p0=[0.5])
    assert 0.3 < ratio < 0.8  # of the order of Rankine's active state and of rest
    np.testing.assert_allclose(stress, stress_at(depth, ratio), rtol=0.15)


def front_of_heap(result):
    """Where the heap first has a hole of two diameters; beyond it single discs roll on, m."""
    x = np.sort(result["position"].values[-1, :, 0])
    holes = np.flatnonzero(np.diff(x) > 4.0 * float(result["radius"].mean()))
    return float(x[holes[0]] if holes.size else x[-1])


@pytest.mark.long
@pytest.mark.parametrize("aspect", [1.0, 3.0])
def test_a_column_runs_as_predicted_by_its_height(aspect):
    # Staron and Hinch (2005): (r - r0) / r0 = 2.5 a below a = 2, 3.25 a^0.7 above
    radii, width = granulate.draw_radii(500, 0.003, 0.004), 0.14 / aspect**0.5
    law, solver = ContactLaw(1.0, compliance=0.05), Solver(max_iterations=500)
    model = granulate.column(radii, width, law)
    still = granulate.simulate_grains(model, 0.6, 1e-3, solver=solver)
    column = granulate.release(model, granulate.final_grains(model, still))
    a = np.quantile(column.grains.position[:, 2], 0.98) / width
    result = granulate.simulate_grains(column, 1.0, 1e-3, solver=solver)
    front = front_of_heap(result)
    expected = 2.5 * a if a < 2.0 else 3.25 * a**0.7
    assert front / width - 1.0 == pytest.approx(expected, rel=0.25)


@pytest.mark.long
@pytest.mark.parametrize(
    ("planar", "number", "fraction"),
    [pytest.param(False, 6.0, 0.64, id="spheres"), pytest.param(True, 4.0, 0.842, id="discs")],
)
def test_grains_without_friction_jam_isostatically(planar, number, fraction):
    n = 200
    radii = np.full(n, 0.01) if not planar else np.where(np.arange(n) % 2, 0.01, 0.014)
    # the steps on the way need not be exact, the last steps are
    solver = Solver(max_iterations=500)
    packing = granulate.compact(radii, 1e3, ContactLaw(0.0), planar=planar, solver=solver)
    assert packing.attrs["failure"] == ""
    assert packing.attrs["stress_error"] == pytest.approx(0.0, abs=1e-3)
    ends, _, _ = granulate.network(packing)
    computed, _ = granulate.coordination(ends, n, rattlers_below=3 if planar else 4)
    assert computed == pytest.approx(number, rel=0.03)
    assert packing.attrs["solid_fraction"] == pytest.approx(fraction, rel=0.03)


@pytest.mark.long
def test_friction_of_sheared_grains_depends_on_the_inertial_number_and_is_fitted():
    # pressure p and speed v with one v / sqrt(p): the same motion in other units of time
    radii, law = granulate.draw_radii(60, 0.004, 0.006), ContactLaw(0.2, compliance=0.05)
    pressure, speed = np.array([1e3, 1e4]), 0.05 * np.array([1.0, 10.0**0.5])
    response = granulate.shear_response(
        radii, (0.05, 0.05), pressure, speed, law, n_realisations=3, n_steps=300
    )
    seen = friction_observations(response)
    np.testing.assert_allclose(seen.values[:, 0], seen.values[:, 1], rtol=1e-2)
    fitted = fit_law(seen, family="coulomb")
    mean = float(seen.values.mean())
    assert float(fitted["friction_coefficient"]) == pytest.approx(mean, rel=1e-6)
    assert 0.0 < mean < 0.2, "grains that roll slide with less than their own friction"
