"""From a case to its cells."""

import numpy as np
import pytest

from multiscale.cli import run_command
from multiscale.errors import CaseError
from multiscale.io import open_dataset, open_response
from multiscale.laws.bulk import Elastic
from multiscale.micro import Cell, FlatCell, SecondBody, run_ensemble
from multiscale.micro import Path as LoadPath
from multiscale.pipeline import case_cells, load_case, make_cells, run
from multiscale.pipeline.case_cells import composite_material
from multiscale.pipeline.measured_sides import measured_map
from multiscale.pipeline.stages.cells import with_slope_errors
from multiscale.schema import MACRO_RESULT
from multiscale.surfaces import Surface, rms_height, rms_slope
from multiscale.units import to_si
from tests.support import case_text, rough_square, steel_text


@pytest.fixture
def case():
    return load_case("ground_steel").quick()


def measured(case, path, **settings):
    """A case with a measured surface of body 1 and without a surface of body 2."""
    body_1 = case.model_dump()["body_1"] | {"surface": {"file": str(path)} | settings}
    modulus = body_1.pop("youngs_modulus")
    return type(case).model_validate(
        _with_units(case) | {"body_1": body_1 | {"youngs_modulus": f"{modulus} Pa"}}
    )


def _with_units(case):
    import tomllib

    content = tomllib.loads(steel_text())
    content["cell"]["points"] = list(case.cell.points)
    content["micro"]["realisations"] = case.micro.realisations
    del content["body_2"]["surface"]
    return content


def write_map(path, heights, spacing=4):
    """Write a matrix that SurfaceTopography reads, some um between points."""
    nx, ny = (spacing * n for n in heights.shape)
    head = f"# Channel: Main\n# Width: {nx} um\n# Height: {ny} um\n# Value units: um\n"
    path.write_text(head + "\n".join(" ".join(f"{v:.9e}" for v in row) for row in heights.T))
    return path


def test_both_rough_bodies_are_in_the_composite_surface(case):
    both = make_cells(case)[0].surface
    changed = case.model_copy(update={"body_2": case.body_2.model_copy(update={"surface": None})})
    single = make_cells(changed)[0].surface
    assert rms_height(single) == pytest.approx(0.4e-6)
    # independent sides: ignoring the second would omit a factor sqrt 2
    assert rms_height(both) == pytest.approx(np.sqrt(2.0) * 0.4e-6, rel=0.1)


def test_realisations_and_sides_are_independent(case):
    surfaces = [cell.surface.heights for cell in make_cells(case)]
    for k, first in enumerate(surfaces):
        for second in surfaces[k + 1 :]:
            assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.6


def test_the_composite_material_has_the_contact_modulus_of_the_pair():
    modulus, nu = composite_material(load_case("road_texture"))
    expected = 1.0 / ((1 - 0.49**2) / 5e6 + (1 - 0.35**2) / 20e9)
    assert modulus / (1.0 - nu**2) == pytest.approx(expected)
    assert nu == pytest.approx(0.49, abs=1e-3)  # the rubber is thousands of times as compliant


def test_a_cutoff_finer_than_the_grid_names_body_and_remedy(case):
    coarse = case.model_copy(update={"cell": case.cell.model_copy(update={"points": (16, 16)})})
    with pytest.raises(CaseError, match=r"\[body_1.surface\].*short"):
        make_cells(coarse)


def test_a_measured_map_gives_one_separate_window_for_each_realisation(case, tmp_path):
    rng = np.random.default_rng(seed=1)
    path = write_map(tmp_path / "map.txt", rng.standard_normal((225, 213)))
    cells = make_cells(measured(case, path))
    assert len(cells) == case.micro.realisations
    for cell in cells:
        assert cell.surface.size == case.cell.size
        assert cell.surface.heights.shape == case.cell.points


def test_a_map_with_too_few_windows_reports_how_many_it_holds(case, tmp_path):
    rng = np.random.default_rng(seed=1)
    path = write_map(tmp_path / "map.txt", rng.standard_normal((125, 213)))
    with pytest.raises(CaseError, match=r"map.txt measures .* has 2 separate windows .* but 4 are"):
        make_cells(measured(case, path))


def test_a_folder_in_which_nothing_was_computed_is_free_for_the_mended_case(case, tmp_path):
    path = write_map(tmp_path / "map.txt", np.random.default_rng(seed=1).random((125, 213)))
    with pytest.raises(CaseError, match="separate windows"):
        run(measured(case, path), tmp_path / "out")
    cell = case.cell.model_copy(update={"geometry": "flat"})
    run(case.model_copy(update={"cell": cell}), tmp_path / "out")
    with pytest.raises(CaseError, match="holds another run"):
        run(case, tmp_path / "out")


def test_a_measured_cutoff_finer_than_the_grid_is_refused(case, tmp_path):
    rng = np.random.default_rng(seed=1)
    path = write_map(tmp_path / "map.txt", rng.standard_normal((225, 213)))
    with pytest.raises(CaseError, match=r"\[body_1.surface\] short_cutoff .* is finer than the"):
        make_cells(measured(case, path, short_cutoff="1 um"))


def both_measured(case, path):
    """A case with the same measured map on both bodies."""
    quantity = measured(case, path)
    return quantity.model_copy(update={"body_2": quantity.body_1})


def test_two_sides_from_one_map_read_it_once_and_share_no_window(case, tmp_path, monkeypatch):
    rng = np.random.default_rng(seed=1)
    path, read = write_map(tmp_path / "map.txt", rng.standard_normal((425, 213))), []

    def counted(settings):
        read.append(settings)
        return measured_map(settings)

    monkeypatch.setattr(case_cells, "measured_map", counted)
    surfaces = [cell.surface.heights for cell in make_cells(both_measured(case, path))]
    assert len(read) == 1
    singles = [cell.surface.heights for cell in make_cells(measured(case, path))]
    for k, first in enumerate(surfaces):
        # a window on itself would double the height, a pair used twice would repeat it
        assert np.std(first) < 1.7 * max(np.std(single) for single in singles)
        for second in surfaces[k + 1 :]:
            assert not np.allclose(np.sort(first.ravel()), np.sort(second.ravel()), atol=0.0)
    path = write_map(tmp_path / "small.txt", rng.standard_normal((225, 213)))
    with pytest.raises(CaseError, match="but 8 are needed"):
        make_cells(both_measured(case, path))


@pytest.mark.parametrize("bodies", [1, 2])
def test_the_first_windows_do_not_depend_on_how_many_are_asked_for(case, tmp_path, bodies):
    rng = np.random.default_rng(seed=1)
    path = write_map(tmp_path / "map.txt", rng.standard_normal((225 * bodies, 213)))
    settings = measured(case, path) if bodies == 1 else both_measured(case, path)
    fewer = settings.model_copy(
        update={"micro": settings.micro.model_copy(update={"realisations": 2})}
    )
    assert fewer.identity() == settings.identity()
    for first, second in zip(make_cells(fewer), make_cells(settings), strict=False):
        np.testing.assert_array_equal(first.surface.heights, second.surface.heights)


def test_windows_keep_the_scale_of_the_map(case, tmp_path):
    x = np.arange(225) * 4e-6
    wave = 1e-6 * np.cos(2.0 * np.pi * x / 200e-6)
    path = write_map(tmp_path / "map.txt", 1e6 * np.tile(wave[:, None], (1, 213)))
    surface = make_cells(measured(case, path))[0].surface
    assert rms_slope(surface) == pytest.approx(1e-6 * 2.0 * np.pi / 200e-6 / np.sqrt(2.0), rel=0.03)


@pytest.mark.parametrize(
    ("size", "settings", "message"),
    [
        pytest.param("40 um", {}, "has only 5 measured points across", id="pixels"),
        pytest.param("800 um", {"short_cutoff": "700 um"}, "removes all roughness", id="cutoff"),
    ],
)
def test_windows_that_make_no_sense_are_refused(case, tmp_path, size, settings, message):
    rng = np.random.default_rng(seed=1)
    path = write_map(tmp_path / "map.txt", rng.standard_normal((225, 213)))
    given = measured(case, path, **settings)
    length = to_si(size, "m")
    given = given.model_copy(
        update={"cell": given.cell.model_copy(update={"size": (length, length)})}
    )
    with pytest.raises(CaseError, match=message):
        make_cells(given)


def test_identity_follows_the_content_of_an_instrument_file_not_its_place(case, tmp_path):
    rng = np.random.default_rng(seed=1)
    heights = rng.standard_normal((225, 213))
    first = measured(case, write_map(tmp_path / "a.txt", heights)).identity()
    assert measured(case, write_map(tmp_path / "b.txt", heights)).identity() == first
    assert measured(case, write_map(tmp_path / "a.txt", 2.0 * heights)).identity() != first


@pytest.mark.slow
def test_a_run_with_a_measured_map_reports_its_share_in_the_cells(case, tmp_path, capsys):
    heights = np.random.default_rng(seed=1).standard_normal((200, 100))
    heights[150:180, 20:70] = np.nan
    write_map(tmp_path / "map.txt", heights, spacing=1)
    surface = 'surface = { file = "map.txt", fill_undefined = true }'
    (tmp_path / "case.toml").write_text(MEASURED.replace("SURFACE", surface), encoding="utf-8")
    run_command(str(tmp_path / "case.toml"), tmp_path / "out", jobs=1, details=True)
    printed = capsys.readouterr()
    response = open_response(tmp_path / "out" / "micro_response.nc")
    known = heights[np.isfinite(heights)]
    part = response["body_rms_height"].sel(body="body_1")
    assert float(part.sel(stage="map")) == pytest.approx(1e-6 * known.std(), rel=0.02)
    cells = np.sqrt(np.mean(response["rms_height"].values ** 2))
    assert float(part.sel(stage="cells")) == pytest.approx(cells, rel=1e-9)
    assert float(response["map_filled_share"][0]) == pytest.approx(1500 / 20000)
    assert np.all(response["filled_share"].values == 0.0)
    assert "caution: body_1: the cells have" in printed.err
    assert "body 1 windows" in printed.out
    cutoff = "The cells of body_1 contain wavelengths down to 25 µm, 8 points of the grid"
    assert cutoff in printed.out
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert cutoff.replace("body_1", "body 1") in page
    assert "<td>body 1 cells</td>" in page
    assert "<td>0, 0, 0</td>" in page
    result = open_dataset(tmp_path / "out" / "macro_result.nc", MACRO_RESULT)
    assert "surface" in result.attrs["unknown"].split(", ")
    assert "too little for an estimate of the rest" in result.attrs["how_surface"]


MEASURED = case_text("measured")


def test_a_case_of_second_order_expands_both_bodies_under_their_surfaces(case):
    cell = case.cell.model_copy(update={"geometry": "flat", "slope_order": 2})
    first = make_cells(case.model_copy(update={"cell": cell}))[0]
    lower, upper = case_cells.two_surfaces(case)[0]
    np.testing.assert_array_equal(first.surface.heights, lower.heights)
    np.testing.assert_array_equal(first.obstacle.heights, -upper.heights)
    assert first.second.law == first.law == Elastic(210e9, 0.3)
    both = first.surface_record(heights=True)["height"][0].T
    np.testing.assert_allclose(both, lower.heights + upper.heights)


def test_flat_cells_report_the_error_of_their_slopes(tmp_path):
    surface = rough_square(32, 1.0, 0.25, 0.1)
    path = LoadPath(pressure=(0.01, 0.03))

    def errors(modulus=1.0, **kind):
        cell = Cell(surface, 1.0, 6, modulus, 0.3, **kind)
        response = run_ensemble([cell], path)
        return with_slope_errors(response, cell, tmp_path / str(kind), "one")

    first, second = (errors(geometry="flat", slope_order=order) for order in (1, 2))
    expected = 0.2 / 1.2 * first["mean_gap_slope_error"]
    np.testing.assert_allclose(second["mean_gap_slope_error"], expected, rtol=1e-6)
    assert np.all(first["mean_gap_slope_error"] > 1e-3)
    second = SecondBody(1.0, 6, Elastic(2.0, 0.3))
    pair = errors(2.0, geometry="flat", opposite=second)  # complies as one body of half the modulus
    half = first["mean_gap_slope_error"] * 0.5 * 1.8 / 1.2
    np.testing.assert_allclose(pair["mean_gap_slope_error"], half, rtol=0.05)
    thin = Cell(surface, 0.4, 6, 1.0, 0.3, geometry="flat")
    unknown = with_slope_errors(run_ensemble([thin], path), thin, tmp_path / "thin", "one")
    assert unknown["mean_gap_slope_error"].isnull().all()
    assert "not known: slope_order = 2 is derived for half-spaces" in unknown.attrs["small_slopes"]


@pytest.mark.parametrize(("stiff", "share"), [(1.0, -0.5), (1e6, 0.0)])
def test_one_body_for_two_errs_by_half_its_slope_correction_where_both_are_alike(
    tmp_path, stiff, share
):
    """Of alike bodies half of the first order is left (3), of a rigid body the whole."""
    surface = rough_square(32, 1.0, 0.25, 0.05)
    path = LoadPath(pressure=(0.003, 0.01))
    smooth = Surface(np.zeros((32, 32)), (1.0, 1.0))
    alone = FlatCell(surface, 1.0, 2, Elastic(1.0 / (1.0 + 1.0 / stiff), 0.3))
    second = SecondBody(1.0, 2, Elastic(stiff, 0.3))
    pair = FlatCell(surface, 1.0, 2, Elastic(1.0, 0.3), obstacle=smooth, second=second)
    response = run_ensemble([Cell(surface, 1.0, 6, 0.5, 0.3)], path)
    assert response.attrs["small_slopes"] == "nothing: the mesh follows the surface"
    result = with_slope_errors(response, pair, tmp_path / "pair", "one", alone)
    bare = with_slope_errors(response, alone, tmp_path / "alone", "one")
    rest = 1.0 + 8.0 * 0.05
    expected = share * bare["mean_gap_slope_error"] * rest / (1.0 + 2.0 * 0.05)
    np.testing.assert_allclose(result["mean_gap_slope_error"], expected, rtol=0.1, atol=1e-5)
    assert result.attrs["small_slopes"].startswith("one body for two")
