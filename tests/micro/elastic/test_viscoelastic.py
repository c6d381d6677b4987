"""Steady viscoelastic sliding against closed forms, a table, and the elastic limits."""

import numpy as np
import pytest

from multiscale.convergence import Status
from multiscale.laws import wlf_shift
from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.micro.elastic.viscoelastic import RelaxingSolid, solve_sliding
from tests.support import slow

LENGTH = 1e-3
RUBBER = RelaxingSolid(10e6, 0.5, (90e6,), (1.0,))
FLAT = Surface(np.zeros((16, 16)), (LENGTH, LENGTH))


def velocity(number):
    """Velocity at which the longest wave is loaded with ``number`` over the relaxation time."""
    return number * LENGTH / (2.0 * np.pi)


def random_waves(n, longest, shortest, slope):
    """Waves of equal phases on every grid: the surface of the table."""
    phase = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, (2 * shortest + 1,) * 2)
    number = np.arange(-shortest, shortest + 1)
    size = np.hypot(number[:, None], number)
    wave = np.zeros((n, n), dtype=complex)
    inside = (longest <= size) & (size <= shortest)
    a, b = np.nonzero(inside)
    wave[number[a], number[b]] = size[inside] ** -1.8 * np.exp(1j * phase[inside])
    heights = np.fft.ifft2(wave).real
    transform = np.fft.fft2(heights)
    q = 2.0 * np.pi * np.fft.fftfreq(n, 1.0 / n) / LENGTH
    slopes = [np.fft.ifft2(1j * k * transform).real for k in (q[:, None], q)]
    rms = np.sqrt(np.mean(slopes[0] ** 2 + slopes[1] ** 2))
    return Surface(heights * slope / rms, (LENGTH, LENGTH))


@pytest.mark.parametrize("number", [0.1, 1.0, 5.0])
def test_a_sinusoid_in_full_contact_dissipates_by_the_loss_modulus(number):
    n, amplitude, pressure = 32, 0.02e-3, 12e6
    q = 2.0 * np.pi / LENGTH
    x = np.arange(n) / n
    surface = Surface(amplitude * np.cos(2.0 * np.pi * x)[:, None] * np.ones(n), (LENGTH, LENGTH))
    result = solve_sliding(surface, RUBBER, pressure, velocity(number))
    loss = RUBBER.complex_modulus(np.array(q * velocity(number))).imag
    expected = 0.5 * q * amplitude**2 * q * loss / (2.0 * 0.75) / pressure
    assert result.status is Status.CONVERGED
    assert result.contact_fraction == 1.0
    assert result.friction == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("n", [5, 9, 15])
def test_on_an_odd_grid_the_shortest_wave_dissipates_in_full(n):
    amplitude, pressure, shortest = 0.02e-3 / n, 12e6, n // 2
    q = 2.0 * np.pi / LENGTH * shortest
    wave = amplitude * np.cos(2.0 * np.pi * shortest * np.arange(n) / n)
    surface = Surface(np.tile(wave[:, None], (1, 3)), (LENGTH, LENGTH))
    speed = velocity(1.0) / shortest
    result = solve_sliding(surface, RUBBER, pressure, speed)
    loss = RUBBER.complex_modulus(np.array(q * speed)).imag
    expected = 0.5 * q * amplitude**2 * q * loss / (2.0 * 0.75) / pressure
    assert result.friction == pytest.approx(expected, rel=1e-6)


def test_the_pressure_lies_on_the_slopes_that_the_half_space_climbs():
    """Its points move along +x: they meet a summit from the left and are pressed before it."""
    n, amplitude = 64, 0.02e-3
    x = np.arange(n) / n - 0.5
    surface = Surface(
        amplitude * np.tile(np.cos(2.0 * np.pi * x)[:, None], (1, 2)), (LENGTH, LENGTH)
    )
    # full contact, for a point of the half-space in its time
    full = solve_sliding(surface, RUBBER, 12e6, velocity(1.0)).pressure[:, 0] - 12e6
    time = 2.0 * np.pi * x  # x / v over the relaxation time: the point passes x from left to right
    stiffness = 2.0 * np.pi / LENGTH / (2.0 * 0.75) * amplitude
    # a Maxwell arm: its stress relaxes with rate 1 while the height changes
    arm = 90e6 * (np.cos(time) - np.sin(time)) / 2.0
    np.testing.assert_allclose(full, stiffness * (10e6 * np.cos(time) + arm), atol=1e-6 * 12e6)


@pytest.mark.parametrize("n", [64, *slow(128)])
def test_partial_contact_follows_the_independent_table(n):
    surface = random_waves(n, 2, 4, 0.1)
    expected = {0.01: 0.0180, 0.03: 0.0421, 0.1: 0.0512, 1.0: 0.0109}
    for number, friction in expected.items():
        result = solve_sliding(surface, RUBBER, 0.2e6, velocity(number))
        assert result.status is Status.CONVERGED
        assert result.friction == pytest.approx(friction, rel=0.01)


def test_a_temperature_shifts_the_velocity():
    surface = random_waves(32, 2, 4, 0.1)
    again = solve_sliding(surface, RUBBER, 0.2e6, velocity(0.1 * wlf_shift(286.0, 293.0)))
    shifted = solve_sliding(surface, RUBBER, 0.2e6, velocity(0.1), shift=wlf_shift(286.0, 293.0))
    assert shifted.friction == pytest.approx(again.friction, rel=1e-6)


@pytest.mark.parametrize(("number", "modulus"), [(0.0, 10e6), (1e7, 100e6)])
def test_very_slow_and_very_fast_sliding_are_elastic(number, modulus):
    # waves along the sliding only: those across it would stay relaxed at any velocity
    n = 32
    x = 2.0 * np.pi * np.arange(n) / n
    profile = np.cos(x) + 0.3 * np.cos(3.0 * x + 1.0)
    surface = Surface(2e-6 * np.tile(profile[:, None], (1, n)), (LENGTH, LENGTH))
    pressure = 0.1 * modulus * 0.02
    result = solve_sliding(surface, RUBBER, pressure, velocity(number))
    assert abs(result.friction) < 2e-3 * 0.02  # contribution of the edges of the contact
    body = Cell(surface, 4.0 * LENGTH, 30, modulus, 0.4999, geometry="flat")
    elastic = solve_cell(body, Path(pressure=(pressure,)))
    gap = float(elastic["mean_gap"].values[0, 0])
    assert result.mean_gap == pytest.approx(gap, rel=0.01)
