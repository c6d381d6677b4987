"""The law that solves a cell at every point: consistent, without hidden history, accounted for."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.convergence import Status
from multiscale.errors import ConvergenceError
from multiscale.macro import Block
from multiscale.micro import Cell, CellLaw, Path, self_affine, solve_cell
from multiscale.upscaling import fit_law, law_from_dataset
from tests.pressed_joint import ElementJoint, press_blocks

RMS = 1e-6


def rough_cell(n=32, seed=3):
    surface = self_affine(
        (n, n),
        (1e-3, 1e-3),
        seed,
        hurst_exponent=0.8,
        long_cutoff=5e-4,
        short_cutoff=2.5e-4,
        rms_height=RMS,
    )
    return Cell(surface, 1e-3, 8, 210e9, 0.3, geometry="flat")


RANGE = (1e6, 1e9)  # Pa


def test_tangent_is_the_derivative_of_the_traction():
    law = CellLaw(rough_cell(), RANGE)
    touch = law.gap_at(np.array(RANGE[0]))
    gap = touch * np.array([0.05, 0.3, 0.6, 0.97, 1.2])
    jump = np.stack([gap, np.zeros_like(gap), np.ones_like(gap)])
    step = 1e-7 * touch
    tangent = law.respond(jump, np.empty((0, gap.size))).tangent
    forward, back = (
        law.respond(jump + sign * np.array([[step], [0.0], [0.0]]), np.empty((0, gap.size)))
        for sign in (1.0, -1.0)
    )
    difference = (forward.traction - back.traction) / (2.0 * step)
    np.testing.assert_allclose(tangent[:, 0], difference, rtol=1e-5)
    assert not np.any(tangent[:, 1:])


@pytest.mark.parametrize(("ratio", "tolerance"), [(1.2, 4e-3), (1.4, 1e-2)])
def test_cells_answer_as_under_pressure(ratio, tolerance):
    cell, pressure = rough_cell(), np.geomspace(*RANGE, 30)
    response = solve_cell(cell, Path(pressure=tuple(pressure)))
    gap = response["mean_gap"].values[0]
    law = CellLaw(cell, RANGE, ratio)
    np.testing.assert_allclose(law.pressure(gap), pressure, rtol=tolerance)
    np.testing.assert_allclose(law.gap_at(pressure), gap, rtol=tolerance)


def test_the_answer_does_not_depend_on_earlier_calls():
    gap = RMS * np.linspace(0.2, 3.0, 9)
    fresh = [CellLaw(rough_cell(), RANGE).pressure(np.array([g]))[0] for g in gap]
    used = CellLaw(rough_cell(), RANGE)
    used.pressure(gap[::-1] + 0.03 * RMS)
    np.testing.assert_array_equal(used.pressure(gap), fresh)


def test_gaps_and_pressures_are_inverse_also_outside_the_pressures_of_the_cell():
    law = CellLaw(rough_cell(), RANGE)
    pressure = np.array([[1e5, 1e6, 1e7], [1e8, 1e9, 2e9]])
    np.testing.assert_allclose(law.pressure(law.gap_at(pressure)), pressure, rtol=1e-9)
    assert law.gap_at(np.array(0.0)) == np.inf


@pytest.mark.parametrize("stiffness", [1e11, 1e14])
def test_resolvent_lies_on_the_law_and_on_the_search_direction(stiffness):
    law = CellLaw(rough_cell(), RANGE)
    jump = RMS * np.array([[0.3, 1.0, 2.0, 4.5], [0.1, 0.2, -0.3, 0.4]])
    source = law.respond(jump, np.empty((0, 4))).traction + stiffness * jump
    response = law.resolvent(source, stiffness, np.empty((0, 4)))
    np.testing.assert_allclose(response, jump, atol=1e-7 * RMS)


def test_cells_pressed_before_are_not_pressed_again():
    law = CellLaw(rough_cell(), RANGE)
    gap = RMS * np.full(50, 1.0)
    law.pressure(gap)
    solved, reused = law.account["solved"], law.account["reused"]
    assert solved + reused >= 50
    law.stiffness(gap)
    assert (law.account["solved"], law.account["reused"]) == (solved, reused + 50)
    np.testing.assert_array_equal(law.pressure(np.array([np.inf, np.nan])), [0.0, np.nan])
    assert law.account["solved"] == solved


def joint():
    block = Block(0.01, 210e9, 0.3)
    mesh = {"elements": (2, 2), "layers": (2, 2)}
    return ElementJoint((0.02, 0.02), block, block, **mesh, eccentricity=(0.003, 0.0))


@pytest.fixture(scope="module")
def fitted():
    """Law fitted to the cell."""
    response = solve_cell(rough_cell(), Path(pressure=tuple(np.geomspace(5e5, 2e8, 14))))
    return law_from_dataset(fit_law(response, n_samples=0))


def test_a_joint_of_cells_is_as_stiff_as_the_joint_of_their_law(fitted):
    preload = np.array([5e6, 2e7])
    sequential = press_blocks(joint(), fitted, preload)
    law = CellLaw(rough_cell(), RANGE)
    concurrent = press_blocks(joint(), law, preload, tolerance=1e-8)
    assert concurrent.converged.all()
    assert 0 < law.account["solved"] < 50
    assert law.account["reused"] > 0
    for name, tolerance in (("mean_gap", 2e-3), ("joint_stiffness", 3e-2)):
        np.testing.assert_allclose(
            getattr(concurrent, name), getattr(sequential, name), rtol=tolerance
        )


def test_a_cell_that_fails_is_reported(monkeypatch):
    law = CellLaw(rough_cell(), RANGE)
    solve = law._memory.problem.solve

    def fails(**options):
        return replace(solve(**options), status=Status.MAX_ITERATIONS)

    monkeypatch.setattr(law._memory, "problem", replace(law._memory.problem, solve=fails))
    with pytest.raises(ConvergenceError, match=r"did not converge at 1e\+06 Pa"):
        law.pressure(np.array([1e-6]))
