"""Paths past limit points against closed forms of von Mises trusses and a guyed mast."""

import numpy as np
import pytest

from multiscale.laws.link import Bar, Cable
from multiscale.macro import LinkSystem, solve_past_limit, solve_static

EA, FORCE = 1e6, 1000.0  # N


def dome(bars, rise, *, sideways=False):
    """Bars from a ring of radius 1 m to an apex that is pressed down."""
    angle = 2.0 * np.pi * np.arange(bars) / bars
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(bars)])
    fixed = np.ones((bars + 1, 3), dtype=bool)
    fixed[-1] = [not sideways, True, False]
    load = np.zeros((bars + 1, 3))
    load[-1, 2] = -FORCE
    ends = np.column_stack([np.arange(bars), np.full(bars, bars)])
    position = np.vstack([ring, [0.0, 0.0, rise]])
    return LinkSystem(position, ends, (Bar(EA),), np.zeros(bars, int), fixed, load)


def resist(bars, rise, length):
    """Force on the apex of a dome with bars of a length, N; k (L0 - L) sqrt(L^2 - 1) / L each."""
    start = np.hypot(1.0, rise)
    return bars * EA / start * (start - length) * np.sqrt(length**2 - 1.0) / length


@pytest.mark.parametrize(("bars", "rise"), [(2, 0.1), (2, 0.3), (6, 0.2)])
def test_a_shallow_dome_snaps_at_its_closed_form_and_comes_out_below(bars, rise):
    start = np.hypot(1.0, rise)
    limit = resist(bars, rise, start ** (1.0 / 3.0)) / FORCE  # L^3 = L0 b^2
    path = solve_past_limit(dome(bars, rise), 1.2 * limit)
    assert "failure" not in path.attrs
    assert path.attrs["critical"] == "limit point"
    assert float(path.critical_factor) == pytest.approx(limit, rel=1e-8)
    np.testing.assert_allclose(path.critical_mode.values[-1], [0.0, 0.0, 1.0], atol=1e-9)
    # the load falls to the opposite limit and rises again, every point in equilibrium
    factor, height = path.load_factor.values, rise + path.displacement.values[:, -1, 2]
    carried = np.sign(height) * resist(bars, rise, np.hypot(1.0, height))
    np.testing.assert_allclose(carried, factor * FORCE, atol=1e-8 * limit * FORCE)
    assert factor.min() < -0.98 * limit
    assert factor[-1] == pytest.approx(1.2 * limit)
    assert height[-1] < -rise
    signs = np.sign(path.stability_eigenvalue.values)
    assert signs[0] == signs[-1] == 1.0
    assert (signs < 0.0).any()


def test_a_steep_truss_buckles_sideways_before_its_limit():
    rise = 3.0
    start = np.hypot(1.0, rise)
    # K_xx = 0: L^3 - L0 L^2 + L0 = 0 with b = 1
    roots = np.roots([1.0, -start, 0.0, start])
    length = max(root.real for root in roots if abs(root.imag) < 1e-9 and root.real < start)
    expected = resist(2, rise, length) / FORCE
    path = solve_past_limit(dome(2, rise, sideways=True), 1.2 * expected)
    assert path.attrs["critical"] == "bifurcation"
    assert float(path.critical_factor) == pytest.approx(expected, rel=1e-7)
    np.testing.assert_allclose(path.critical_mode.values[-1], [1.0, 0.0, 0.0], atol=1e-6)


def test_without_a_limit_the_path_ends_where_statics_does():
    system = dome(3, 0.5)
    pulled = solve_past_limit(system, -2.0)
    assert "critical_factor" not in pulled
    direct = solve_static(system, -2.0, exact=True)
    np.testing.assert_allclose(pulled.tension.values[-1], direct.tension.values, rtol=1e-9)


def test_a_path_that_is_cut_short_reports_it():
    path = solve_past_limit(dome(2, 0.1), 1.0, max_steps=5)
    assert "after 5 steps" in path.attrs["failure"]
    assert path.sizes["step"] == 5


def test_a_mast_with_prestressed_guys_buckles_at_the_stiffness_of_the_guys():
    # mast of height 1 on a pin, four guys at 45 degrees with tension T, carried by the mast
    guy, tension = 1e5, 100.0
    feet = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
    position = np.vstack([feet, [0, 0, 0], [0, 0, 1.0]])
    fixed = np.ones((6, 3), dtype=bool)
    fixed[-1] = False
    load = np.zeros((6, 3))
    load[-1, 2] = -FORCE
    ends = np.array([[0, 5], [1, 5], [2, 5], [3, 5], [4, 5]])
    prestress = np.array([tension] * 4 + [-4.0 * tension / np.sqrt(2.0)])
    mast = Bar(1e12)  # so stiff that the guys keep their tension
    system = LinkSystem(
        position, ends, (Cable(guy), mast), np.array([0, 0, 0, 0, 1]), fixed, load, prestress
    )
    length = np.sqrt(2.0)
    # two guys along the motion: k/2 + T/2L each, two across: T/L each, less the force of the mast
    guys = 2.0 * (guy / length / 2.0 + tension / length / 2.0) + 2.0 * tension / length
    expected = (guys - 4.0 * tension / length) / FORCE
    path = solve_past_limit(system, 1.5 * expected)
    assert path.attrs["critical"] == "bifurcation"
    assert float(path.critical_factor) == pytest.approx(expected, rel=1e-4)
