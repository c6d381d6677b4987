"""The cell held at a mean gap: the inverse of the cell held at a pressure."""

import numpy as np
import pytest
from scipy.optimize import brentq

from multiscale.convergence import Status
from multiscale.errors import CaseError
from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.micro.gap_control import assemble_gap_cell
from tests.closed_forms import westergaard
from tests.support import rough_square, wave


def rough_cell(n=64, **options):
    surface = rough_square(n, 0.5, 0.25, 0.1, seed=4)
    return Cell(surface, 1.5, 8, 1e9, 0.3, **{"geometry": "flat", **options})


def test_a_gap_leads_back_to_its_pressure():
    cell, pressure = rough_cell(), 1e9 * np.array([1e-4, 2e-3, 1e-2])
    response = solve_cell(cell, Path(pressure=tuple(pressure)))
    held = assemble_gap_cell(cell)
    states = [held.solve(gap) for gap in response["mean_gap"].values[0]]
    np.testing.assert_allclose([state.pressure for state in states], pressure, rtol=1e-5)
    fractions = [state.contact_fraction for state in states]
    np.testing.assert_allclose(fractions, response["contact_fraction"].values[0], rtol=2e-2)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.95])
def test_stiffness_is_the_derivative_of_the_pressure(share):
    held = assemble_gap_cell(rough_cell())
    gap, step = share * held.touch, 1e-7 * held.touch
    state = held.solve(gap)
    assert state.status is Status.CONVERGED
    low, high = (held.solve(gap + sign * step, state).pressure for sign in (1, -1))
    assert (high - low) / (2.0 * step) == pytest.approx(state.stiffness, rel=1e-4)


def test_the_start_changes_the_time_and_not_the_answer():
    held = assemble_gap_cell(rough_cell())
    gap = 0.4 * held.touch
    alone = held.solve(gap)
    for share in (0.1, 0.39, 0.9):
        warm = held.solve(gap, held.solve(share * held.touch))
        assert warm.pressure == pytest.approx(alone.pressure, rel=1e-9)
        assert warm.stiffness == pytest.approx(alone.stiffness, rel=1e-7)
    assert held.solve(gap, held.solve(0.401 * held.touch)).iterations < alone.iterations


@pytest.mark.parametrize("ratio", [0.1, 0.5, 0.8])
def test_a_wave_held_at_a_gap_is_westergaards(ratio):
    amplitude = 1e-2
    cell = Cell(wave((512, 1), amplitude), 3.0, 8, 0.91, 0.3, geometry="flat")
    full = westergaard.full_contact_pressure(amplitude, 1.0, contact_modulus=1.0)
    gap = float(westergaard.mean_gap(np.array(ratio)))
    state = assemble_gap_cell(cell).solve(gap * amplitude)
    assert state.pressure == pytest.approx(ratio * full, rel=5e-3)
    # dp/dg of g = 1 - s + s ln s: 1 / ln s
    assert state.stiffness == pytest.approx(-full / (amplitude * np.log(ratio)), rel=3e-2)


def test_pressure_falls_to_zero_at_first_touch_and_stays():
    held = assemble_gap_cell(rough_cell())
    gaps = held.touch * np.array([0.5, 0.9, 0.99, 0.9999, 1.0, 1.3])
    pressure = [held.solve(gap).pressure for gap in gaps]
    assert np.all(np.diff(pressure[:5]) < 0.0)
    assert pressure[4] == pressure[5] == 0.0
    p = 2e-3 * pressure[0]
    gap = brentq(lambda gap: held.solve(gap).pressure - p, gaps[0], gaps[4])
    assert held.solve(gap).pressure == pytest.approx(p, rel=1e-6)


def test_what_cannot_be_held_at_a_gap_is_refused():
    with pytest.raises(CaseError, match="geometry='flat' only, got 'conforming'"):
        assemble_gap_cell(rough_cell(geometry="conforming"))
    with pytest.raises(CaseError, match="leave the hardness out"):
        assemble_gap_cell(rough_cell(hardness=1e8))
    flat = Cell(Surface(np.zeros((8, 8)), (1.0, 1.0)), 1.0, 8, 1e9, 0.3, geometry="flat")
    with pytest.raises(CaseError, match="without a gap there is no law"):
        assemble_gap_cell(flat)
    with pytest.raises(CaseError, match=r"positive mean gap \(m\), got -0.1"):
        assemble_gap_cell(rough_cell()).solve(-0.1)
