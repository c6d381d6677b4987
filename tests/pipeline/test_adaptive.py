"""The adaptive way: cells pressed where the load of a structure leaves the data of a law."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import open_law
from multiscale.macro.data_range import further_pressures
from multiscale.pipeline import load_case, run, run_macro
from multiscale.upscaling import law_from_dataset
from multiscale.upscaling.response_observations import join_pressures
from tests.support import case_text, response_of, write_law, write_scene

DATA = (1e6, 8e6, 16e6)


@pytest.mark.parametrize(
    ("shares", "limit", "asked"),
    [
        ((0.005, 0.01, 0.0), 16e6, ()),
        ((0.0, 0.02, 0.0), 16e6, (16e6, 32e6)),
        ((0.02, 0.3, 0.1), 16e6, (0.25e6, 0.5e6, 16e6, 32e6)),
        ((0.0, 0.3, 0.1), 9e6, ()),  # the cells contradict the law above
        ((np.nan, 0.3, 0.1), 16e6, (16e6, 32e6)),
    ],
)
def test_further_pressures_lie_beyond_the_ends_that_the_load_leaves(shares, limit, asked):
    assert further_pressures((*DATA[:2], limit), np.array(shares)) == pytest.approx(asked)


def test_joined_branches_keep_the_cautions_and_ends_of_both():
    p = np.array([1e6, 2e6, 4e6])
    first, second = (
        response_of(np.full((2, 3), 1e-6), p * factor).assign_attrs(cautions=text, ended=text)
        for factor, text in ((1.0, "first\nboth"), (8.0, "both\nsecond"))
    )
    joined = join_pressures(first, second)
    np.testing.assert_array_equal(joined["nominal_pressure"], [*p, *(8.0 * p)])
    for name in ("cautions", "ended"):
        assert joined.attrs[name] == "first\nboth\nsecond"


def steel(pressures, way):
    """Ground steel blocks with flat cells under some pressures, MPa."""
    case = load_case("ground_steel").quick()
    cell = case.cell.model_copy(update={"geometry": "flat"})
    case = case.model_copy(update={"cell": cell}).pressed_at(1e6 * p for p in pressures)
    interface = case.structure.models["interface"](way=way)
    return case.model_copy(update={"interface": interface})


@pytest.fixture(scope="module")
def ways(tmp_path_factory):
    """Adaptive blocks whose cells begin at few pressures, and sequential ones at all of them."""
    out = tmp_path_factory.mktemp("ways")
    few, every = (20.0, 40.0, 80.0), (5.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0)
    results = {
        "adaptive": run(steel(few, "adaptive"), out / "adaptive"),
        "sequential": run(steel(every, "sequential"), out / "sequential"),
    }
    return results, out


def test_adaptive_blocks_are_those_of_cells_at_all_pressures(ways):
    results, _ = ways
    adaptive, whole = (results[way].macro_result for way in ("adaptive", "sequential"))
    for name in ("joint_stiffness", "mean_gap", "joint_stiffness_one_part"):
        np.testing.assert_allclose(adaptive[name], whole[name], rtol=1e-6)
    steps = [results[way].micro_response["converged"].sum() for way in results]
    counted = f"{int(steps[1] - steps[0])} steps of cells, which all points share"
    assert counted in adaptive.attrs["cautions"]
    # the law of the case itself is left as it was
    assert results["adaptive"].interface_law.attrs["pressure_max"] == 80e6


def test_the_adaptive_law_has_the_gaps_of_the_cells_beyond_the_first_data(ways):
    results, out = ways
    (file,) = (out / "adaptive").glob("adaptive/*/interface_law.nc")
    law = law_from_dataset(open_law(file))
    response = results["sequential"].micro_response
    pressure, gap = response["nominal_pressure"].values, response["mean_gap"].mean("realisation")
    np.testing.assert_allclose(law.gap_at(pressure), gap, rtol=5e-3)
    first = law_from_dataset(results["adaptive"].interface_law)
    assert abs(first.gap_at(320e6) / float(gap[-1]) - 1.0) > 0.02


def test_inside_the_data_the_adaptive_way_presses_nothing(tmp_path):
    results = [
        run(steel((5.0, 40.0, 160.0), way), tmp_path / way).macro_result
        for way in ("adaptive", "sequential")
    ]
    np.testing.assert_array_equal(*(result["joint_stiffness"].values for result in results))
    assert results[0].attrs["cautions"] == results[1].attrs["cautions"]
    assert not (tmp_path / "adaptive" / "adaptive").exists()


def test_the_adaptive_way_needs_cells(tmp_path):
    write_law(tmp_path / "law.nc")
    text = case_text("lap_of_law").replace('"law.nc"', '"law.nc"\nway = "adaptive"')
    with pytest.raises(CaseError, match=r"law\.nc is a law without cells; name a case with cells"):
        run_macro(load_case(write_scene(tmp_path, text)), tmp_path / "found.nc")
