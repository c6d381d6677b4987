"""The planner reaches its target, at the least expected cost, and loses nothing."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import open_run
from multiscale.micro.layer import graded_planes
from multiscale.pipeline import load_case, run
from multiscale.pipeline.forecast import (
    COARSE,
    GROWTH,
    REALISATIONS,
    CostModel,
    Estimate,
    Setting,
    cheapest,
)
from multiscale.pipeline.planner import resize
from multiscale.upscaling.budget import ALWAYS, ERROR_TERMS, total_error
from tests.support import case_text

CASE = case_text("planned")


@pytest.fixture
def write(tmp_path):
    def _write(text):
        file = tmp_path / "case.toml"
        file.write_text(text, encoding="utf-8")
        return load_case(file)

    return _write


def test_a_target_of_cells_alone_plans_their_law(write, tmp_path):
    alone = CASE[: CASE.index("[structure]")] + CASE[CASE.index("[accuracy]") :]
    results = run(write(alone), tmp_path / "out")
    assert list(results) == ["micro_response", "interface_law"]
    law = results.interface_law
    assert "below the target of 12 %" in law.attrs["plan"]  # by the first cells
    assert law["error_total"].sel(quantity="mean_gap").max() <= 0.12


def estimate(**terms):
    half, bias = np.full((len(ERROR_TERMS), 2), np.nan), np.zeros((len(ERROR_TERMS), 2))
    half[[ERROR_TERMS.index(one) for one in ALWAYS]] = 0.0
    for name, value in terms.items():
        half[ERROR_TERMS.index(name.replace("_", " "))] = value
    return Estimate(Setting(0, 0, 8), half, bias)


@pytest.mark.slow
def test_dear_cells_have_flat_ones_as_control_and_lead_to_finer_grids(write, tmp_path):
    """Unless they are turned off."""
    dear = CASE.replace('geometry = "flat"\n', "").replace("[64, 64]", "[32, 32]")
    dear = dear.replace('"0.25 mm"', '"0.5 mm"').replace("layers = 8", "layers = 4")
    dear = dear[: dear.index("[structure]")] + dear[dear.index("[accuracy]") :]
    plain = dear.replace("realisations = 4", "realisations = 4\ncontrol = false")
    law = run(write(dear), tmp_path / "out")["interface_law"]
    assert "control cells" in law.attrs["how_sampling"]
    for term in ("cell_size", "micro_discretisation"):
        assert law.attrs[f"how_{term}"].startswith("taken out: ")
    assert law.attrs["n_realisations"] >= 4
    assert float(law["error_total"].sel(quantity="mean_gap").max()) < 0.12
    alone = run(write(plain), tmp_path / "alone")["interface_law"]
    assert "control" not in alone.attrs
    # a cell tells more of the mean where flat ones tell how it differs from it
    own, without = (
        one["error_half_width"].sel(quantity="mean_gap", error_term="sampling").max()
        * one.attrs["n_realisations"] ** 0.5
        for one in (law, alone)
    )
    assert own < without


def test_terms_are_forecast_as_they_scale():
    known = estimate(sampling=0.1, cell_size=0.04, micro_discretisation=0.02, fit=0.01)
    known.bias[ERROR_TERMS.index("cell size")] = 0.03
    found = known.at(Setting(1, 2, 32))
    expected = {"sampling": 0.025, "cell size": 0.02, "micro discretisation": 0.005, "fit": 0.01}
    for name, value in expected.items():
        np.testing.assert_allclose(found.half_width[ERROR_TERMS.index(name)], value)
    assert found.bias.sum(axis=0)[0] == pytest.approx(0.015)
    spread = np.sqrt(sum(value**2 for value in expected.values()))
    assert found.total == pytest.approx(float(total_error(np.array(0.015), np.array(spread))))


def test_dear_and_cheap_cells_share_the_sampling_error():
    """Three quarters of the variance are of 40 cheap cells, and a quarter is of 8 dear ones."""
    known = replace(estimate(sampling=0.1), setting=Setting(0, 0, 8, 40), cheap=0.75)
    for setting, variance in (
        (Setting(0, 0, 8, 160), 0.25 + 0.75 / 4.0),
        (Setting(0, 0, 32, 40), 0.25 / 4.0 + 0.75),
        (Setting(1, 0, 8, 40), 0.25 + 0.75 / 4.0),
    ):
        found = known.at(setting).half_width[ERROR_TERMS.index("sampling")]
        np.testing.assert_allclose(found, 0.1 * np.sqrt(variance))


def test_the_cheapest_setting_is_that_of_a_search():
    known, costs = estimate(sampling=0.2, cell_size=0.1, fit=0.01), CostModel(0.5, 2.0, False)
    settings = [Setting(*one) for one in product(range(-1, 4), range(2), REALISATIONS)]

    def time_of(one):
        return one.realisations * costs.of_cell(one.size, COARSE) + 3.0 * one.grid

    setting = cheapest(known, settings, time_of, 0.05)
    assert known.at(setting).total <= 0.05
    times = [time_of(one) for one in settings if known.at(one).total <= 0.05]
    assert time_of(setting) == pytest.approx(min(times))
    said = r"an error of 0.5 % is out of reach: .* by the cell size; ask"
    with pytest.raises(CaseError, match=said):
        cheapest(known, settings, time_of, 0.005)


def test_the_cost_of_a_cell_grows_with_its_unknowns():
    flat, filled = CostModel(0.5, 1.0, False), CostModel(0.0, 1.0, True)
    assert flat.of_cell(1, 0) == flat.of_cell(0, 1) == pytest.approx(0.5 + 4.0**GROWTH)
    assert filled.of_cell(0, 1) == pytest.approx(8.0**GROWTH)  # and twice the layers
    assert filled.of_cell(1, 0) == pytest.approx(4.0**GROWTH)


def test_the_cost_is_fitted_to_times_and_scaled_by_what_is_seen():
    true = CostModel(0.01, 0.2, False)
    kinds = [(-2, 0), (-1, 0), (-1, -1)]
    found = CostModel.fit({kind: true.of_cell(*kind) for kind in kinds}, layered=False)
    assert found.of_cell(2, 0) == pytest.approx(true.of_cell(2, 0), rel=1e-6)
    slower = found.seen(1, 0, 2.0 * true.of_cell(1, 0))
    assert slower.of_cell(2, 0) == pytest.approx(2.0 * true.of_cell(2, 0), rel=1e-6)
    one = CostModel.fit({(0, 0): 3.0}, layered=True)
    assert one.of_cell(0, 0) == pytest.approx(3.0)


def test_a_resized_case_keeps_its_spacing_and_surface(write):
    case = write(CASE)
    larger = resize(case, Setting(2, 0, 5))
    assert larger.cell.size == (8e-3, 8e-3)
    assert larger.cell.points == (128, 128)
    assert larger.micro.realisations == 5
    assert larger.body_1 == case.body_1
    assert len({resize(case, Setting(size, 0, 1)).micro.seed for size in range(-1, 5)}) == 6
    fine = resize(case, Setting(0, 0, 1), grid=0)
    assert (fine.cell, fine.micro.seed) == (case.cell, case.micro.seed)


def test_layers_of_larger_and_finer_cells_are_graded_alike(write):
    """Thickness grows from layer to layer by one factor, which a finer grid takes in two steps."""

    def growth(size, grid):
        cell = resize(case, Setting(size, 0, 1), grid=grid).cell
        planes = graded_planes(cell.size[0], cell.layers, cell.spacing)
        return (planes[1] / np.diff(planes)[-1]) ** (1.0 / (cell.layers - 1))

    case = write(CASE.replace("layers = 8", "layers = 24"))
    own = growth(0, 0)
    np.testing.assert_allclose([growth(size, 0) for size in (-1, 1, 2)], own, rtol=0.03)
    np.testing.assert_allclose([growth(size, 1) ** 2 for size in (0, 1)], own, rtol=0.03)


@pytest.mark.slow
def test_a_run_with_a_target_reaches_it_and_goes_on_where_it_was(write, tmp_path):
    case = write(CASE.replace('"12 %"', '"7 %"'))
    results = run(case, tmp_path / "out")
    assert float(results.interface_law["error_total"].sel(quantity="mean_gap").max()) <= 0.07
    assert results.macro_result.attrs["unknown"] == ""
    assert results.interface_law.sizes["sample"] == 0  # bands would hold a part of the error only
    assert "joint_stiffness_sample" not in results.macro_result
    lines = results.macro_result.attrs["plan"].splitlines()
    assert "forecast" in lines[0]
    assert "spent" in lines[0]
    assert lines[-1].startswith("the estimated error of mean_gap is")
    assert "below the target of 7 %" in lines[-1]
    assert results.macro_result.attrs["time_spent"] > 0.0
    tree = open_run(tmp_path / "out")
    assert "error_total" in tree["macro_result"]

    cells = sorted((tmp_path / "out" / "plan").glob("*/micro/*.nc"))
    before = {file: file.stat().st_mtime_ns for file in cells}
    cells[0].unlink()  # as if the run had been stopped before
    for file in (tmp_path / "out").glob("*.nc"):
        file.unlink()
    again = run(case, tmp_path / "out")
    np.testing.assert_array_equal(
        again.interface_law["fit_mean_gap"], results.interface_law["fit_mean_gap"]
    )
    assert all(file.stat().st_mtime_ns == before[file] for file in cells[1:])
    assert set(before) == set((tmp_path / "out" / "plan").glob("*/micro/*.nc"))


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[64, 64]", "[16, 16]", "quarter of the points, which would be 4; give points = 32"),
        (
            '"0.25 mm"',
            '"0.1 mm"',
            r"cannot resolve wavelengths of 0.0001 m; give more than 80 points",
        ),
    ],
)
def test_a_grid_that_leaves_nothing_to_compare_is_refused(write, tmp_path, old, new, sentence):
    with pytest.raises(CaseError, match=sentence):
        run(write(CASE.replace(old, new)), tmp_path / "out")
