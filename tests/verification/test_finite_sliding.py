"""Viscoelastic sliding in time steps at finite strain against the steady linear solution."""

import numpy as np
import pytest

from multiscale.laws.bulk import Prony
from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.micro.sliding import RelaxingSolid, solve_sliding

AMPLITUDE = 0.002  # of the wave, for a wavelength of 1: a slope of .013
LAW = Prony(1.0, 0.45, weights=(0.5,), times=(1.0,))


def linear_solid():
    r"""The law at small strain: half-spaces answer with M = 4 G (lambda + G) / (lambda + 2 G).

    With G of one relaxation time and an elastic lambda, M is a Prony series of two times.
    """
    lame, stiff = LAW.volume_modulus, LAW.shear_modulus
    soft = stiff * (1.0 - sum(LAW.weights))

    def modulus(s):
        shear = (soft + stiff * s) / (1.0 + s)
        return 4.0 * shear * (lame + shear) / (lame + 2.0 * shear)

    times = np.array([1.0, (lame + 2.0 * stiff) / (lame + 2.0 * soft)])
    s = np.array([[0.5], [2.0]])
    parts = np.linalg.solve(s * times / (1.0 + s * times), modulus(s[:, 0]) - modulus(0.0))
    return RelaxingSolid(modulus(0.0), 0.0, tuple(parts), tuple(times))


def plane_wave(n, lines):
    wave = AMPLITUDE * np.cos(2.0 * np.pi * np.arange(n) / n)
    return Surface(np.tile(wave[:, None], (1, lines)), (1.0, lines / n))


def friction_in_time(n, pressure, velocity, length):
    """Mean friction over the last quarter of a wavelength, sliding from rest."""
    slide = np.arange(round(length * n) + 1) / n
    flat = Surface(np.zeros((n, 1)), (1.0, 1.0 / n))
    path = Path(
        pressure=(pressure,) * len(slide),
        slide=tuple((float(s), 0.0) for s in slide),
        time=tuple(slide / velocity),
    )
    cell = Cell(flat, 1.0, 14, 1.0, 0.45, obstacle=plane_wave(n, 1), bulk=LAW)
    response = solve_cell(cell, path, recover_stress=False, tolerance=1e-6)
    assert response["converged"].values.all()
    normal, along, _ = np.moveaxis(response["traction"].values[0, -n // 4 :], -1, 0)
    return float(np.mean(-along / normal))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "number", "tolerance"),
    [
        pytest.param(3.0, 1.0, 0.015, id="full contact"),
        pytest.param(0.3, 1.0, 0.04, id="partial contact"),
        pytest.param(0.3, 0.3, 0.04, id="partial contact, slower"),
    ],
)
def test_time_steps_at_small_slopes_end_in_the_steady_linear_solution(share, number, tolerance):
    n, solid = 32, linear_solid()
    velocity = number / (2.0 * np.pi)  # times the relaxation time over the wavelength
    pressure = share * np.pi * solid.relaxed_modulus * AMPLITUDE
    lines = 2
    below = Surface(-plane_wave(n, lines).heights, (1.0, lines / n))
    steady = solve_sliding(below, solid, pressure, velocity)
    found = friction_in_time(n, pressure, velocity, 1.2)
    assert found == pytest.approx(steady.friction, rel=tolerance)
