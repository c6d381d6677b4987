"""The planner reaches its target, at the least expected cost, and loses nothing."""

from itertools import product

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import open_run
from multiscale.pipeline import load_case, run
from multiscale.pipeline.forecast import (
    REALISATIONS,
    STUDIES,
    CostModel,
    Estimate,
    Setting,
    cheapest,
)
from multiscale.pipeline.planner import resize
from multiscale.upscaling.budget import ERROR_TERMS, total_error

CASE = """
title = "Flat cells"
[body_1]
youngs_modulus = "1 GPa"
poissons_ratio = 0.3
[body_1.surface]
rms_slope = 0.1
hurst_exponent = 0.8
long_cutoff = "1 mm"
short_cutoff = "0.25 mm"
[body_2]
youngs_modulus = "1000 GPa"
poissons_ratio = 0.3
[cell]
size = ["2 mm", "2 mm"]
points = [64, 64]
layers = 8
geometry = "flat"
[micro]
realisations = 4
pressures = ["1 MPa", "2 MPa", "4 MPa"]
[law]
samples = 40
[joint]
height = "40 mm"
width = "400 mm"
preloads = ["1.5 MPa", "3 MPa"]
[accuracy]
target = "12 %"
quantity = "mean_gap"
"""


@pytest.fixture
def write(tmp_path):
    def _write(text):
        file = tmp_path / "case.toml"
        file.write_text(text, encoding="utf-8")
        return load_case(file)

    return _write


def estimate(**terms):
    half, bias = np.full((len(ERROR_TERMS), 2), np.nan), np.zeros((len(ERROR_TERMS), 2))
    for name, value in terms.items():
        half[ERROR_TERMS.index(name.replace("_", " "))] = value
    return Estimate(Setting(0, 0, 8), half, bias)


def test_terms_are_forecast_as_they_scale():
    known = estimate(sampling=0.1, cell_size=0.04, micro_discretisation=0.02, fit=0.01)
    known.bias[ERROR_TERMS.index("cell size")] = 0.03
    found = known.at(Setting(1, 2, 32, 4))
    expected = {"sampling": 0.025, "cell size": 0.01, "micro discretisation": 0.005, "fit": 0.01}
    for name, value in expected.items():
        np.testing.assert_allclose(found.half_width[ERROR_TERMS.index(name)], value)
    assert found.bias.sum(axis=0)[0] == pytest.approx(0.015)
    spread = np.sqrt(sum(value**2 for value in expected.values()))
    assert found.total == pytest.approx(float(total_error(np.array(0.015), np.array(spread))))


def test_the_cheapest_setting_is_that_of_a_search():
    known, costs = estimate(sampling=0.2, cell_size=0.1, fit=0.01), CostModel(2.0, 1.2, False)
    ranges, study = (range(-1, 4), range(-1, 2)), {(-1, -1): 8}
    setting, time = cheapest(known, costs, {(1, 0): 5}, study, 0.05, ranges)
    assert known.at(setting).total <= 0.05
    times = []
    for size, grid, n, k in product(*ranges, REALISATIONS, STUDIES):
        if known.at(Setting(size, grid, n, k)).total <= 0.05:
            new = max(0, n - (5 if (size, grid) == (1, 0) else 0))
            times.append(new * costs.of_cell(size, grid) + 8 * (k - 1) * costs.of_cell(-1, -1))
    assert time == pytest.approx(min(times))
    with pytest.raises(CaseError, match=r"an error of 0.5 % is out of reach: .* by the fit; ask"):
        cheapest(known, costs, {}, study, 0.005, ranges)


def test_the_cost_of_a_cell_grows_with_its_unknowns():
    flat, filled = CostModel(1.0, 1.5, False), CostModel(1.0, 1.0, True)
    assert flat.of_cell(1, 0) == flat.of_cell(0, 1) == pytest.approx(8.0)
    assert filled.of_cell(0, 1) == pytest.approx(8.0)  # and twice the layers
    assert filled.of_cell(1, 0) == pytest.approx(4.0)


def test_a_resized_case_keeps_its_spacing_and_surface(write):
    case = write(CASE)
    larger = resize(case, Setting(2, -1, 5))
    assert larger.cell.size == (8e-3, 8e-3)
    assert larger.cell.points == (128, 128)
    assert larger.micro.realisations == 5
    assert larger.body_1 == case.body_1
    seeds = {resize(case, Setting(size, 0, 1), pilot=True).micro.seed for size in (-1, 0, 1)}
    assert len({*seeds, larger.micro.seed}) == 4


@pytest.mark.slow
def test_a_run_with_a_target_reaches_it_and_goes_on_where_it_was(write, tmp_path):
    case = write(CASE)
    results = run(case, tmp_path / "out")
    assert float(results.interface_law["error_total"].sel(quantity="mean_gap").max()) <= 0.12
    assert results.macro_result.attrs["unknown"] == ""
    lines = results.macro_result.attrs["plan"].splitlines()
    assert "forecast" in lines[0]
    assert "spent" in lines[0]
    assert lines[-1].startswith("the estimated error of mean_gap is")
    assert "below the target of 12 %" in lines[-1]
    assert results.macro_result.attrs["time_spent"] > 0.0
    tree = open_run(tmp_path / "out", finished=True)
    assert "error_total" in tree["macro_result"]

    cells = sorted((tmp_path / "out" / "plan").glob("*/micro/*.nc"))
    before = {file: file.stat().st_mtime_ns for file in cells}
    cells[0].unlink()  # as if the run had been stopped before
    again = run(case, tmp_path / "out")
    np.testing.assert_array_equal(
        again.interface_law["fit_mean_gap"], results.interface_law["fit_mean_gap"]
    )
    assert all(file.stat().st_mtime_ns == before[file] for file in cells[1:])
    assert set(before) == set((tmp_path / "out" / "plan").glob("*/micro/*.nc"))


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('"12 %"', '"0 %"', r"\[accuracy\] target should be greater than 0"),
        ('"12 %"', '"2 mm"', r"\[accuracy\] target .*cannot be converted"),
        ('"mean_gap"', '"gap"', r"\[accuracy\] quantity should be"),
        ("[accuracy]", "[acuracy]", "has no key 'acuracy'; did you mean 'accuracy'"),
    ],
)
def test_a_target_that_is_none_is_refused(write, old, new, sentence):
    with pytest.raises(CaseError, match=sentence):
        write(CASE.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[64, 64]", "[16, 16]", "quarter of the points, which would be 4; give points = 32"),
        ('"0.25 mm"', '"0.1 mm"', r"cannot carry waves of 0.0001 m; give more than 80 points"),
    ],
)
def test_a_grid_that_leaves_nothing_to_compare_is_refused(write, tmp_path, old, new, sentence):
    with pytest.raises(CaseError, match=sentence):
        run(write(CASE.replace(old, new)), tmp_path / "out")
