"""The adaptive way: cells pressed where the load of a structure leaves the data of a law."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import open_law
from multiscale.macro.data_range import (
    further_pressures,
    pressures_between,
    pressures_of_points,
)
from multiscale.pipeline import load_case, run, run_macro
from multiscale.pipeline.plans.case_knobs import cell_knobs
from multiscale.upscaling import law_from_dataset
from multiscale.upscaling.response_observations import join_pressures
from tests.support import case_text, response_of, small_steel, steel_text, write_law, write_scene

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


@pytest.mark.parametrize(("limit", "most"), [(16e6, 30e6), (9e6, 8e6)])
def test_points_lie_between_rungs_of_a_ladder_that_near_points_share(limit, most):
    pressure = np.array([[1e3, 5e6, 5.1e6, 30e6], [np.nan, -1.0, 7e6, 30e6]])
    rungs = np.array(pressures_of_points((*DATA[:2], limit), pressure, np.ones(4)))
    borne = pressure[(pressure > 1e6) & (pressure <= most)]
    low = np.array([rungs[rungs <= p].max() for p in borne])
    high = np.array([rungs[rungs > p].min() for p in borne])
    np.testing.assert_allclose(high / low, 1.2)
    assert rungs.size <= 6  # none for the point that bears nothing, the same for near points
    assert rungs.min() > 1e6


@pytest.mark.parametrize(
    ("unsure", "pressure", "asked"),
    [
        ([0, 0, 0], [[2e6, 9e6]], ()),
        ([0, 0, 1], [[2e6, 9e6]], (np.sqrt(8e6 * 16e6),)),
        ([0, 1, 0], [[2e6, 9e6]], (np.sqrt(1e6 * 8e6), np.sqrt(8e6 * 16e6))),
        ([1, 1, 1], [[2e6, 30e6], [2e6, -9e6]], (np.sqrt(1e6 * 8e6),)),
        ([1, 1, 1], [[0.05e6, 30e6], [0.05e6, np.nan]], ()),
        ([1, 1, 1], [[9e4, 1.6e7]], ()),
    ],
)
def test_unsure_data_have_pressures_between_where_load_lies(unsure, pressure, asked):
    given = np.array(DATA), np.array(unsure, dtype=bool), np.array(pressure), np.ones(2)
    assert pressures_between(*given, most=3) == pytest.approx(asked)


def test_of_many_unsure_intervals_those_with_the_most_load_have_pressures():
    data = 1e6 * 2.0 ** np.arange(8.0)
    middles = np.sqrt(data[1:] * data[:-1])
    load = np.array([3.0, 1.0, 7.0, 2.0, 6.0, 5.0, 4.0])
    given = data, np.ones(8, dtype=bool), middles[None], load / middles
    for most in (3, 7):
        largest = np.sort(middles[np.argsort(-load)[:most]])
        assert pressures_between(*given, most=most) == pytest.approx(largest)


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
    """Adaptive blocks with cells at few pressures, and sequential blocks with all of them."""
    out = tmp_path_factory.mktemp("ways")
    few, between = (10.0, 20.0, 30.0, 40.0, 60.0, 80.0), np.sqrt(160.0 * 320.0)  # an unsure end
    every = (2.5, 5.0, *few, 160.0, between, 320.0)
    results = {
        "adaptive": run(steel(few, "adaptive"), out / "adaptive"),
        "sequential": run(steel(every, "sequential"), out / "sequential"),
    }
    return results, out


def test_adaptive_blocks_equal_blocks_of_cells_at_all_pressures(ways):
    results, _ = ways
    adaptive, whole = (results[way].macro_result for way in ("adaptive", "sequential"))
    # the cells reach their pressures on two paths, and agree to their tolerance
    for name in ("joint_stiffness", "mean_gap", "joint_stiffness_one_part"):
        np.testing.assert_allclose(adaptive[name], whole[name], rtol=5e-6)
    steps = [results[way].micro_response["converged"].sum() for way in results]
    counted = f"{int(steps[1] - steps[0])} steps of cells and control cells, which all points share"
    assert counted in adaptive.attrs["cautions"]
    # the law of the case itself is left as it was
    assert results["adaptive"].interface_law.attrs["pressure_max"] == 80e6


def test_the_adaptive_law_has_the_gaps_of_the_cells_beyond_the_first_data(ways):
    results, out = ways
    files = (out / "adaptive").glob("adaptive/*/interface_law.nc")
    law = law_from_dataset(max(map(open_law, files), key=lambda law: law.sizes["step"]))
    response = results["sequential"].micro_response
    pressure, gap = response["nominal_pressure"].values, response["mean_gap"].mean("realisation")
    np.testing.assert_allclose(law.gap_at(pressure), gap, rtol=5e-3)
    first = law_from_dataset(results["adaptive"].interface_law)
    assert abs(first.gap_at(320e6) / float(gap[-1]) - 1.0) > 0.02


@pytest.mark.slow
def test_concurrent_blocks_have_cells_around_every_preload(ways, tmp_path):
    result = run(steel((20.0, 40.0, 80.0), "concurrent"), tmp_path).macro_result
    (file,) = tmp_path.glob("adaptive/*/interface_law.nc")
    pressed = open_law(file)["fit_pressure"].values
    for preload in result["preload"].values:
        low, high = pressed[pressed <= preload].max(), pressed[pressed > preload].min()
        assert high / low < 1.24
    whole = ways[0]["sequential"].macro_result
    np.testing.assert_allclose(result["joint_stiffness"], whole["joint_stiffness"], rtol=1e-2)


@pytest.mark.slow
def test_a_structure_that_asks_for_ever_more_pressures_has_a_caution(ways, tmp_path, monkeypatch):
    monkeypatch.setattr("multiscale.pipeline.adaptive.ROUNDS", 1)
    cautions = run(steel((20.0, 40.0, 80.0), "adaptive"), tmp_path).macro_result.attrs["cautions"]
    assert "all 1 solves of the structure need further pressures, the last 5 MPa" in cautions
    assert "solves of the structure" not in ways[0]["adaptive"].macro_result.attrs["cautions"]


STEEL = small_steel(4).replace("coarser = 5", "coarser = 0")
DIRECT = '[interface]\nway = "direct"\n[structure]'


@pytest.mark.slow
def test_direct_blocks_are_as_wide_as_their_cells(tmp_path):
    text = STEEL.replace('"10 mm"', '"2.4 mm"')
    case = load_case(write_scene(tmp_path, text, ("[structure]", DIRECT)))
    assert (case.cell.size, case.cell.points) == ((2.4e-3, 2.4e-3), (108, 108))
    case = case.pressed_at((5e6, 20e6, 80e6, 160e6))
    narrow = case.cell.model_copy(update={"size": (8e-4, 8e-4), "points": (36, 36)})
    wide, of_cells = (
        run(way, tmp_path / str(k)).macro_result
        for k, way in enumerate((case, case.model_copy(update={"cell": narrow})))
    )
    low, high = of_cells["joint_stiffness_one_part"].values
    assert np.all((low < wide["joint_stiffness"]) & (wide["joint_stiffness"] < high))
    np.testing.assert_allclose(wide["joint_stiffness"], of_cells["joint_stiffness"], rtol=0.1)


@pytest.mark.parametrize(("width", "points"), [("2.4 mm", 108), ("2.45 mm", 112)])
def test_direct_cells_are_as_fine_as_asked_and_keep_their_width(width, points, tmp_path):
    text = STEEL.replace('"10 mm"', f'"{width}"')
    case = load_case(write_scene(tmp_path, text, ("[structure]", DIRECT)))
    assert case.cell.points == (points, points)  # even, for coarser cells
    (tmp_path / "again.toml").write_text(case.to_toml())
    assert load_case(tmp_path / "again.toml").cell == case.cell
    assert "size of the cells" not in [knob.name for knob in cell_knobs(case)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            case_text("lap_of_law").replace('"law.nc"', '"law.nc"\nway = "direct"'),
            'kind = "blocks"',
        ),
        (steel_text().replace("[structure]", DIRECT), "needs flat cells of synth"),
    ],
)
def test_the_direct_way_is_refused_where_nothing_resolves_the_roughness(text, words, tmp_path):
    with pytest.raises(CaseError, match=words):
        load_case(write_scene(tmp_path, text))


@pytest.mark.slow
def test_cells_between_far_pressures_narrow_the_interval_by_the_form_of_the_law(tmp_path):
    halves = []
    for way in ("sequential", "adaptive"):
        result = run(steel((5.0, 40.0, 160.0), way), tmp_path / way).macro_result
        of_form = result["error_half_width"].sel(quantity="joint_stiffness", error_term="fit")
        halves.append(of_form.to_numpy())
    assert np.all(halves[1] < 0.2 * halves[0])


@pytest.mark.slow
def test_inside_the_data_the_adaptive_way_presses_nothing(tmp_path):
    results = [
        run(steel((5.0, 10.0, 20.0, 40.0, 80.0, 160.0), way), tmp_path / way).macro_result
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
