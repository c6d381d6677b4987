"""Viscoelastic sliding in time steps at finite strain against the steady linear solution."""

import numpy as np
import pytest

from multiscale.laws.bulk import Prony
from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.micro.elastic.viscoelastic import RelaxingSolid, solve_sliding

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


def friction_in_time(n, pressure, velocity, length, pieces):
    """Mean friction over the last quarter of a wavelength, sliding from rest.

    One point of the grid is passed in a number of time steps.
    """
    slide = np.arange(round(length * n) * pieces + 1) / (n * pieces)
    flat = Surface(np.zeros((n, 1)), (1.0, 1.0 / n))
    path = Path(
        pressure=(pressure,) * len(slide),
        slide=tuple((float(s), 0.0) for s in slide),
        time=tuple(slide / velocity),
    )
    cell = Cell(flat, 1.0, 14, 1.0, 0.45, obstacle=plane_wave(n, 1), bulk=LAW)
    response = solve_cell(cell, path, tolerance=1e-6)
    assert response["converged"].values.all()
    last = slice(-n * pieces // 4, None)
    normal, along, _ = np.moveaxis(response["traction"].values[0, last], -1, 0)
    return float(np.mean(-along / normal))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "number"),
    [
        pytest.param(3.0, 1.0, id="full contact"),
        pytest.param(0.3, 1.0, id="partial contact"),
        pytest.param(0.3, 0.3, id="partial contact, slower"),
    ],
)
def test_time_steps_at_small_slopes_tend_to_the_steady_linear_solution(share, number):
    n, fine, lines, solid = 32, 512, 2, linear_solid()
    velocity = number / (2.0 * np.pi)  # times the relaxation time over the wavelength
    length = max(2.0 * number, 0.75)  # 12 relaxation times, until the start is forgotten
    pressure = share * np.pi * solid.relaxed_modulus * AMPLITUDE
    below = Surface(-plane_wave(fine, lines).heights, (1.0, lines / fine))
    steady = solve_sliding(below, solid, pressure, velocity).friction
    errors = [
        abs(friction_in_time(n, pressure, velocity, length, pieces) / steady - 1.0)
        for pieces in (1, 2)
    ]
    assert errors[1] < 0.01
    assert errors[1] < max(0.5 * errors[0], 0.005)  # of the time step, down to the grid error
