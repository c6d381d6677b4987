"""Contact of regular wavy surfaces against closed forms and tight numerical values."""

import numpy as np
import pytest

from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.surfaces import rms_slope
from tests.closed_forms import full_contact, johnson, westergaard
from tests.support import egg_box, rough_square, wave


def test_westergaards_wave_in_plane_strain():
    n, amplitude = 512, 1e-5
    cell = Cell(wave((n, 2), amplitude), 1.5, 100, youngs_modulus=0.91, poissons_ratio=0.3)
    ratio = np.array([0.1, 0.25, 0.5, 0.75])
    full = westergaard.full_contact_pressure(amplitude, 1.0, contact_modulus=1.0)
    response = solve_cell(cell, Path(pressure=tuple(ratio * full)), keep_fields=True)
    assert response["converged"].values.all()

    fraction = response["contact_fraction"].values[0]
    np.testing.assert_allclose(fraction, westergaard.contact_fraction(ratio), atol=1.0 / n)
    highest = response["pressure"].values[0].max(axis=(1, 2)) / (ratio * full)
    np.testing.assert_allclose(highest, westergaard.largest_pressure(ratio), rtol=1e-4)
    gap = response["mean_gap"].values[0] / amplitude
    np.testing.assert_allclose(gap, westergaard.mean_gap(ratio), rtol=1e-2)


@pytest.mark.parametrize(
    ("n", "ratio", "fraction", "gap"),
    [
        # a spot of the lightest load is 20 points across only on the finest grid
        pytest.param(512, 0.01, 0.0361, 0.818, id="light", marks=pytest.mark.slow),
        pytest.param(128, 0.1, 0.191, 0.385, id="moderate"),
        pytest.param(128, 0.75, 0.869, 0.0069, id="heavy"),
    ],
)
def test_the_egg_box_against_a_fine_boundary_element_solution(n, ratio, fraction, gap):
    amplitude = 1e-4  # fraction and gap: half-space solved on 256 x 256 points by Fourier methods
    cell = Cell(egg_box(n, amplitude), 1.5, 24, youngs_modulus=0.91, poissons_ratio=0.3)
    full = johnson.full_contact_pressure(amplitude, 1.0, contact_modulus=1.0)
    response = solve_cell(cell, Path(pressure=(ratio * full,)))
    assert response["contact_fraction"].item() == pytest.approx(fraction, rel=2e-2)
    assert response["mean_gap"].item() / amplitude == pytest.approx(gap, rel=2e-2)


def test_the_egg_box_near_full_contact_obeys_johnson():
    n, amplitude = 128, 1e-4
    cell = Cell(egg_box(n, amplitude), 1.5, 24, youngs_modulus=0.91, poissons_ratio=0.3)
    ratio = np.array([0.9, 0.95])
    full = johnson.full_contact_pressure(amplitude, 1.0, contact_modulus=1.0)
    response = solve_cell(cell, Path(pressure=tuple(ratio * full)))
    fraction = response["contact_fraction"].values[0]
    np.testing.assert_allclose(fraction, johnson.contact_fraction_high(ratio), rtol=3e-3)


def test_pressure_and_energy_of_full_contact():
    n = 128  # 16 points in the shortest wave
    surface = rough_square(n, 0.5, 0.125, 1e-5, seed=3)
    cell = Cell(surface, 1.5, 40, youngs_modulus=0.91, poissons_ratio=0.3)
    response = solve_cell(cell, Path(pressure=(5e-5,)), keep_fields=True)
    assert response["contact_fraction"].item() == 1.0

    pressure = response["pressure"].values[0, 0].T
    expected = full_contact.rms_pressure(rms_slope(surface), contact_modulus=1.0)
    assert pressure.std() == pytest.approx(expected, rel=1e-2)
    wavenumber = 2.0 * np.pi * np.fft.fftfreq(n, 1.0 / n)
    amplitude = np.abs(np.fft.fft2(surface.heights)) / n**2
    energy = full_contact.elastic_energy(
        np.hypot(wavenumber[:, None], wavenumber), amplitude, contact_modulus=1.0
    )
    work = 0.5 * np.mean((pressure - pressure.mean()) * surface.heights)
    assert work == pytest.approx(energy, rel=1e-2)


def test_a_single_asperity_obeys_hertz():
    n, radius = 128, 50.0
    x = (np.arange(n) - n // 2) / n
    cap = np.maximum(-(x[:, None] ** 2 + x**2) / (2.0 * radius), -0.02 / radius)
    cell = Cell(Surface(cap, (1.0, 1.0)), 2.0, 40, youngs_modulus=0.91, poissons_ratio=0.3)
    width = 0.1  # contact radius
    load = 4.0 * width**3 / (3.0 * radius)
    response = solve_cell(cell, Path(pressure=(load,)), keep_fields=True)
    highest = 1.5 * load / (np.pi * width**2)
    assert response["pressure"].values.max() == pytest.approx(highest, rel=1e-2)
    assert response["contact_fraction"].item() == pytest.approx(np.pi * width**2, rel=3e-2)
