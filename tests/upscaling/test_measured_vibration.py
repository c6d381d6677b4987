"""Measured vibrations of a mass on a joint: frequency, damping, and calibrated friction."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.special import ive

from multiscale.errors import CaseError
from multiscale.upscaling import (
    assume_shear,
    by_differences,
    calibrate,
    fit_branches,
    read_vibration,
    tangential_values,
)
from multiscale.upscaling.budget import NORMAL
from multiscale.upscaling.measured.joints import BedCurve, Curve, MeasuredLoop
from multiscale.upscaling.measured.vibrations import MeasuredVibration
from tests.upscaling.responses import exponential_gaps, response_of

P, AMPLITUDE, MASS = 2e7, 1e-6 * np.geomspace(0.02, 0.4, 7), 4e4  # Pa, m, kg/m²
X = np.linspace(np.log(5e3), np.log(2e8), 300)
HEAD = "preload (MPa), amplitude (um), frequency (Hz), damping (%)"


def interface(friction=0.3, ratio=0.8):
    """An interface of the stiffness p / .45 um."""
    rates = np.array([np.ones(X.size), X])
    return BedCurve(Curve(X, X - np.log(0.45e-6), rates), ratio, friction)


def vibration(amplitude=AMPLITUDE, bodies=0.0):
    n = 2 * amplitude.size
    given = ("vibration", np.full(n, P), np.ones(n), np.ones(n), {"frame": 1e-15, "offset": 3e5})
    return MeasuredVibration(*given, bodies, displacement=np.tile(amplitude, 2), mass=MASS)


def harmonics(table):
    """Stiffness and loss stiffness of the frequency and the damping of a table."""
    frequency, damping = table.answer(interface(), {})[0].reshape(2, -1)
    stiffness = MASS * (2.0 * np.pi * frequency) ** 2
    return stiffness, 2.0 * damping * stiffness


@pytest.fixture
def write(tmp_path):
    def _write(rows, head=HEAD):
        (tmp_path / "vibration.csv").write_text("\n".join([head, *rows]))
        return tmp_path / "vibration.csv"

    return _write


def test_vibrations_have_stiffness_and_loss_of_the_closed_form():
    """B = mu p (1 - exp(-delta / s)) with s = mu u_0 / kappa, of the stiffness p / u_0."""
    a, mu, s = AMPLITUDE, 0.3, 0.3 * 0.45e-6 / 0.8
    stiffness, loss = harmonics(vibration())
    first = -mu * P * np.expm1(-a / s)
    work = 8.0 * (mu * P * a - s * first) - 4.0 * a * first
    harmonic = 4.0 * mu * P / a * ive(1, a / (2.0 * s))  # by the modified Bessel function
    np.testing.assert_allclose(stiffness, harmonic, rtol=1e-5)
    np.testing.assert_allclose(loss, work / (np.pi * a**2), rtol=1e-5)


def test_stiffnesses_are_the_harmonics_of_a_closed_loop():
    """The shear over a cycle by Masing's rule, a loop as it is measured."""
    n = 400
    angle = 2.0 * np.pi * np.arange(n + 1) / n
    of_loops = []
    for a in AMPLITUDE:
        u = a * np.cos(angle)
        rows = ("loop", np.full(n + 1, P), u, np.ones(n + 1), {})
        shear = MeasuredLoop(*rows, displacement=u).answer(interface(), {})[0][:n]
        of_loops.append(2.0 / a * np.mean(shear * np.exp(1j * angle[:n])))
    stiffness, loss = harmonics(vibration())
    np.testing.assert_allclose(stiffness - 1j * loss, of_loops, rtol=1e-3)


def test_gradients_are_the_differences():
    table, at = vibration(bodies=1e-14), {"frame": 7e-16, "offset": 4e5}
    gradient = table.answer(interface(), at)[1]
    by_steps = by_differences(lambda table, *given: table.answer(*given)[0], step=1e-4)
    differences = by_steps(table, interface(), at)[1]
    assert np.all(np.abs(gradient - differences) <= 1e-6 * np.abs(gradient).max(axis=0))


@pytest.fixture(scope="module")
def law():
    fitted = fit_branches(response_of(exponential_gaps(8, spread=0.1)), n_samples=80)
    return assume_shear(fitted, friction=0.3, stiffness_ratio=0.8)


def test_outliers_name_the_damping_and_the_row_of_the_table(law):
    value = vibration().answer(interface(), {})[0]
    n = value.size // 2
    wrong = value * np.where(np.arange(2 * n) == n + 2, 1.5, 1.0)
    table = replace(vibration(), value=wrong, deviation=0.02 * value)
    assert "vibration, damping of row 3: 0.05117 at 20 MPa" in " ".join(
        calibrate(law, [table]).sentences
    )


def test_a_table_of_vibrations_recovers_friction_and_ratio(law, write):
    true = vibration().answer(interface(0.2, 0.75), {})[0]
    rows = [
        f"{1e-6 * P}, {1e6 * a}, {f}, {100.0 * damping}"
        for a, f, damping in zip(AMPLITUDE, *true.reshape(2, -1), strict=True)
    ]
    table = read_vibration(write(rows), mass=MASS, error=0.02, frame=0.0, offset=0.0)
    np.testing.assert_allclose(table.value, true, rtol=1e-9)
    calibration = calibrate(law, [table])
    drawn = tangential_values(calibration.law)
    assert drawn["friction"] == pytest.approx(0.2, rel=0.1)
    rows = {row.name: row for row in calibration.parameters}
    friction = rows["friction coefficient"]
    assert abs(friction.value - 0.2) < friction.half_width < 0.2 * friction.prior_half_width
    assert friction.learned > 0.9


def test_modes_of_a_structure_calibrate_like_a_mass(law, write):
    """The structure is the mass, without a gradient; its table has no preload."""

    def structure(amplitudes, half=0.0):
        answer = by_differences(lambda _, bed, none: vibration(amplitudes).answer(bed, none)[0])
        return P, np.full(2 * amplitudes.size, half), answer

    true = vibration().answer(interface(0.2, 0.75), {})[0].reshape(2, -1)
    rows = [f"{1e6 * a}, {f}, {d}" for a, f, d in zip(AMPLITUDE, *true, strict=True)]
    file = write(rows, "amplitude (um), frequency (Hz), damping")
    table = read_vibration(file, structure=structure, error=0.02)
    rough = read_vibration(file, structure=partial(structure, half=0.1), error=0.02)
    assert rough.deviation[-1] == pytest.approx(np.hypot(table.deviation[-1], 0.1 / NORMAL))
    calibration = calibrate(law, [table])
    friction = {row.name: row for row in calibration.parameters}["friction coefficient"]
    assert abs(friction.value - 0.2) < friction.half_width < 0.2 * friction.prior_half_width
    assert {row.unit for row in calibration.rows} == {"Hz", "1"}
    with pytest.raises(CaseError, match="either a mass or a structure"):
        read_vibration(file, structure=structure, mass=MASS, error=0.02)
