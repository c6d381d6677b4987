"""Edges of contact between nodes: closed forms, refined grids, and invariants."""

import numpy as np
import pytest

from multiscale.laws.bulk import J2, NeoHookean
from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.micro.averages import HALF_SPACE, contact_fraction, edge_layer
from multiscale.micro.elastic.viscoelastic import RelaxingSolid, solve_sliding
from tests.closed_forms import westergaard

THETA = np.linspace(0.0, np.pi, 2049)
SINE = np.append(1.0, 0.5 * THETA[1:] / np.sin(0.5 * THETA[1:]))  # C = 1 / (2 sin(theta / 2))


def compliance_ratio(a):
    """Compliance of the nodes with the inverse factor sqrt(1 - z) exp(-a z)."""
    return SINE * np.exp(2.0 * a * (np.cos(THETA) - 1.0))


def forces_at_an_edge(a, alpha, beta, n):
    """Coefficients of (alpha + beta z) (1 - z)^(-3/2) exp(-a z)."""
    root, growth = np.ones(n), np.ones(n)
    for j in range(1, n):
        root[j] = root[j - 1] * (j + 0.5) / j
        growth[j] = growth[j - 1] * -a / j if j < 30 else 0.0
    both = np.convolve(root, growth)[:n]
    return alpha * both + beta * np.append(0.0, both[:-1])


@pytest.mark.parametrize("a", [-0.2, 0.0, 0.1])
def test_the_layer_at_an_edge_follows_wiener_and_hopf(a):
    layer = edge_layer(compliance_ratio(a))
    assert layer.reach == pytest.approx(0.25 - a, abs=1e-5)
    assert layer.ratio == pytest.approx(0.5 - a, abs=1e-5)


@pytest.mark.parametrize("a", [-0.2, 0.0, 0.1])
@pytest.mark.parametrize("share", [0.1, 0.4, 0.7, 0.99])
def test_two_forces_find_where_the_square_root_ends(a, share):
    n = 4000
    force = forces_at_an_edge(a, share, 1.0 - share, n)
    square = (force[-1] / force[-2]) ** 2  # (n - 1 + s) / (n - 2 + s)
    place = 1.0 / (square - 1.0) - (n - 2)
    strip = np.concatenate([force, force[::-1], np.zeros(n)])[:, None]
    fraction = contact_fraction(
        strip, np.ones_like(strip), edges=(edge_layer(compliance_ratio(a)),) * 2
    )
    assert 0.5 * fraction * len(strip) - n + 0.5 == pytest.approx(place, abs=0.03)


@pytest.mark.parametrize(
    ("geometry", "nu"), [("flat", 0.3), ("conforming", 0.3), ("conforming", 0.45)]
)
def test_the_ends_of_westergaards_contact_lie_within_an_eighth_of_an_element(geometry, nu):
    n, amplitude = 32, 1e-4
    ratio = np.linspace(0.05, 0.5, 10)
    full = westergaard.full_contact_pressure(amplitude, 1.0, contact_modulus=1.0)
    wave = amplitude * np.cos(2.0 * np.pi * np.arange(n) / n)[:, None]
    cell = Cell(Surface(wave, (1.0, 1.0 / n)), 1.5, 24, 1.0 - nu**2, nu, geometry=geometry)
    response = solve_cell(
        cell, Path(pressure=tuple(ratio * full)), recover_stress=False, keep_fields=True
    )
    exact = westergaard.contact_fraction(ratio)
    error = 0.5 * n * (response["contact_fraction"].values[0] - exact)
    counted = 0.5 * n * ((response["pressure"].values[0] > 0.0).mean(axis=(1, 2)) - exact)
    assert np.mean(counted) > 0.1  # the bias that is taken away
    assert abs(np.mean(error)) < 0.04
    assert np.max(np.abs(error)) < 0.125


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_spots_of_few_nodes_have_the_area_of_a_fine_grid(turn):
    def area(n, start):
        wave = np.cos(2.0 * np.pi * (np.arange(n) + start) / n)
        cell = Cell(
            Surface(1e-4 * wave[:, None] * wave, (1.0, 1.0)), 1.5, 8, 1.0, 0.3, geometry="flat"
        )
        return solve_cell(cell, Path(pressure=pressure))["contact_fraction"].values[0]

    pressure = tuple(np.array([0.1, 0.3, 0.6]) * np.sqrt(2.0) * np.pi * 1e-4 / 0.91)
    fine = area(128, 0.0)
    np.testing.assert_allclose(fine, (0.1905, 0.514, 0.776), rtol=5e-3)  # 512 points
    np.testing.assert_allclose(area(32, turn), fine, rtol=0.012)  # counted: 10, 4, 1.3 % more


def test_an_area_depends_on_neither_place_nor_turn_nor_unit():
    force = np.maximum(np.random.default_rng(seed=2).normal(size=(24, 18)), 0.0)
    weight = np.random.default_rng(seed=3).uniform(0.5, 1.5, force.shape)
    plain = contact_fraction(force, weight)
    for other, area in (
        (np.roll(force, (5, 7), (0, 1)), np.roll(weight, (5, 7), (0, 1))),
        (force[::-1], weight[::-1]),
        (force.T, weight.T),
        (1e-200 * force, 1e-12 * weight),
    ):
        assert contact_fraction(other, area) == pytest.approx(plain, rel=1e-12)
    assert contact_fraction(np.ones((4, 4)), np.ones((4, 4))) == 1.0
    assert contact_fraction(np.zeros((4, 4)), np.ones((4, 4))) == 0.0


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_an_even_pressure_that_drops_at_once_covers_its_load(share):
    force = np.zeros((20, 1))
    force[3:9] = 2.0
    force[9] = 2.0 * share
    fraction = contact_fraction(force, np.ones_like(force), flowing=True)
    assert fraction == pytest.approx((6.0 + share) / 20.0)


@pytest.mark.parametrize("n", [16, 32])
def test_rubber_at_large_strain_has_the_area_of_a_fine_grid(n):
    heights = 0.04 * np.cos(2.0 * np.pi * np.arange(n) / n)[:, None]
    cell = Cell(Surface(heights, (1.0, 1.0 / n)), 0.5, 8, 1.0, 0.3, bulk=NeoHookean(1.0, 0.3))
    response = solve_cell(cell, Path(pressure=(0.005, 0.01, 0.02, 0.04)), recover_stress=False)
    fine = (0.1202, 0.1703, 0.2431, 0.3526)  # 256 points; 16 counted have 8 to 55 % more
    np.testing.assert_allclose(response["contact_fraction"].values[0], fine, rtol=0.012)


@pytest.mark.slow
def test_a_metal_that_flows_touches_where_its_even_pressure_carries_the_load():
    areas = []
    for n in (16, 32):
        wave = np.cos(2.0 * np.pi * np.arange(n) / n)
        surface = Surface(0.04 * wave[:, None] * wave, (1.0, 1.0))
        cell = Cell(surface, 0.5, 8, 1.0, 0.3, bulk=J2(1.0, 0.3, 1.0 / 200.0, 0.01))
        path = Path(pressure=(0.002, 0.004), increments=8)
        response = solve_cell(cell, path, keep_fields=True, tolerance=1e-5)
        areas.append(response["contact_fraction"].values[0])
    pressure = response["pressure"].values[0, -1]
    even = np.median(pressure[pressure > 0.8 * pressure.max()])
    # the surface of the spots is 5 % wider than before it flowed
    assert 1.05 * 0.004 / even == pytest.approx(areas[1][1], rel=0.02)
    fine = (0.1325, 0.2525)  # 64 points, 16 layers; 16 counted have 24 and 14 % more
    np.testing.assert_allclose(areas, np.tile(fine, (2, 1)), rtol=0.04)


def test_rubber_that_slides_has_the_area_of_a_fine_grid():
    rubber = RelaxingSolid(10e6, 0.5, (90e6,), (1.0,))

    def area(n):
        x = 2.0 * np.pi * np.arange(n) / n
        heights = 2e-5 * np.tile(np.cos(x)[:, None], (1, 4))
        velocity = 1e-3 / (2.0 * np.pi)
        result = solve_sliding(Surface(heights, (1e-3, 1e-3)), rubber, 0.5e6, velocity)
        return result.contact_fraction, float((result.pressure > 0.0).mean())

    fine, _ = area(512)
    errors = np.array([area(n) for n in (31, 32, 33, 63, 64, 65)]) / fine - 1.0
    assert np.max(np.abs(errors[:, 0])) < 0.015
    assert np.max(np.abs(errors[:, 1])) > 0.1  # counted


def test_the_exact_layer_is_the_limit_of_its_integrals():
    assert HALF_SPACE.reach == pytest.approx(edge_layer(np.ones(4097)).reach, abs=1e-4)
    assert HALF_SPACE.ratio == pytest.approx(edge_layer(np.ones(4097)).ratio, abs=1e-4)
