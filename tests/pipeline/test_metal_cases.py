"""Cases with a hardness: bodies that yield, and cells that are unloaded."""

import numpy as np
import pytest

from multiscale.io import open_law
from multiscale.laws.bulk import J2
from multiscale.micro import Cell, Path, Surface, solve_cell
from multiscale.pipeline import make_cells, run
from multiscale.pipeline.case import shipped_cases
from multiscale.pipeline.stages.cells import _increments, increment_errors
from multiscale.schema import MICRO_RESPONSE
from multiscale.upscaling import hysteretic_from_dataset
from tests.support import case_of

TEXT = shipped_cases()["ground_steel_plastic"].read_text(encoding="utf-8")
ELASTIC = TEXT.replace('hardness = "1.6 GPa"\n', "").replace('hardening_modulus = "1 GPa"\n', "")


def test_the_softer_body_yields_at_its_hardness_and_the_case_reports_it(tmp_path):
    text = TEXT.replace('"1.6 GPa"', '"2.8 GPa"', 1).replace('"1 GPa"', '"3 GPa"', 1)
    text = text.replace('"1.6 GPa"', '"1.4 GPa"', 1)
    case = case_of(tmp_path, text)
    (cell, *_) = make_cells(case.quick())
    assert isinstance(cell.law, J2)
    assert cell.law.yield_stress == pytest.approx(0.42e9, rel=1e-12)
    assert cell.law.hardening_modulus == 1e9  # of the second, softer body
    # the flow stress at the plastic strain under an indenter is the hardness over 2.8
    stress, _ = cell.law.flow_stress(np.array(0.08))
    assert 2.8 * stress == pytest.approx(1.4e9)
    assert not [*case.cautions()]  # the response has the yield stress


def test_a_flat_case_with_a_hardness_still_caps_its_pressure(tmp_path):
    text = TEXT.replace('hardening_modulus = "1 GPa"\n', "").replace("unload = true\n", "")
    (cell, *_) = make_cells(case_of(tmp_path, text.replace("[cell]", '[cell]\ngeometry = "flat"')))
    assert cell.hardness == 1.6e9


def test_unloading_goes_down_the_same_pressures_or_the_pressures_of_a_list(tmp_path):
    up = (5e6, 10e6, 20e6, 40e6, 80e6, 160e6)
    assert case_of(tmp_path, TEXT).micro.path == (*up, *up[-2::-1])
    listed = TEXT.replace("unload = true", 'unload = ["90 MPa", "30 MPa"]')
    assert case_of(tmp_path, listed).micro.path == (*up, 90e6, 30e6)
    none = TEXT.replace("unload = true", "unload = false")
    assert case_of(tmp_path, none).micro.path == up


@pytest.mark.slow
def test_a_plastic_case_ends_in_a_law_with_both_branches_and_its_figure(tmp_path):
    text = TEXT.replace("[64, 64]", "[24, 24]").replace("layers = 8", "layers = 4")
    text = text.replace("realisations = 6", "realisations = 3")
    case = case_of(tmp_path, text)
    results = run(case, tmp_path / "out")
    response, joint = results.micro_response, results.macro_result
    assert response["converged"].values.all()
    assert response.sizes["step"] == len(case.micro.path)
    assert response["flowing_fraction"].values.max() > 0.01
    assert 0.0 < np.abs(response["mean_gap_increment_error"]).max() < 0.05
    assert "the pressure increments of the yielding body cause" in response.attrs["cautions"]

    law = hysteretic_from_dataset(open_law(tmp_path / "out" / "interface_law.nc"))
    assert law.stiffness_ratio > 1.0
    peak, down = case.micro.pressures[-1], np.array(case.micro.unloading)
    gap = law.loading.gap_at(np.array(peak)) + law.recovery(down, np.array(peak))
    np.testing.assert_allclose(gap, response["mean_gap"].mean("realisation")[6:], rtol=0.03)
    assert np.all(gap < law.loading.gap_at(down))  # plastic deformation remains

    assert np.all(joint["unloading_stiffness"] > joint["joint_stiffness"])
    low, high = np.nanpercentile(joint["unloading_stiffness_sample"], (2.5, 97.5), axis=0)
    assert np.all((low <= joint["unloading_stiffness"]) & (joint["unloading_stiffness"] <= high))


@pytest.mark.slow
def test_halved_increments_give_the_error_that_the_increments_leave():
    """Against increments of an eighth, which leave a tenth of it."""
    x = np.cos(2.0 * np.pi * np.arange(8) / 8)
    cell = Cell(
        Surface(0.02 * np.add.outer(x, x), (1.0, 1.0)),
        *(1.0, 6, 1.0, 0.3),
        bulk=J2(1.0, 0.3, 0.01, 0.05),
    )
    first, half, eighth = (
        solve_cell(cell, Path(pressure=(0.01,), refinement=k), tolerance=1e-6) for k in (1, 2, 8)
    )
    assert half["increments"].item() > first["increments"].item()
    computed = increment_errors(first, half)["mean_gap_increment_error"][0]
    exact = first["mean_gap"].item() / eighth["mean_gap"].item() - 1.0
    assert 0.005 < abs(exact) < 0.03
    assert computed == pytest.approx(exact, rel=0.35)
    response = MICRO_RESPONSE.assign(first, increment_errors(first, half))
    (caution,) = _increments(response)
    assert f"cause errors of up to {100.0 * abs(computed):.2g} % in the mean gap" in caution
