"""Sweeps: every combination of listed values, run on any workers."""

from importlib import import_module

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from typer.testing import CliRunner

from multiscale.cli import app
from multiscale.errors import CaseError, FileError, MultiscaleError
from multiscale.macro import solve_static
from multiscale.pipeline import load_case, load_sweep, run, run_sweep
from multiscale.pipeline.stages.joint import solve_joint
from multiscale.pipeline.sweep_points import POINTS, _places, tabulate_sweep
from multiscale.plotting import plot_sweep, sweep_ends
from tests.support import TWO_BLOCKS, case_text, refused_rows, small_steel, write_law, write_scene

sweep_module = import_module("multiscale.pipeline.sweep")

SMALL = small_steel(3, "\n[law]\nsamples = 10\n")

SWEEP = """
[sweep]
body_1.youngs_modulus = ["70 GPa", "210 GPa"]
cell.layers = [8, 14]
"""


@pytest.fixture
def write(tmp_path):
    def to(text):
        file = tmp_path / "case.toml"
        file.write_text(text, encoding="utf-8")
        return file

    return to


def test_points_are_all_combinations_and_the_last_key_is_fastest(write):
    sweep = load_sweep(write(SMALL + SWEEP))
    assert sweep.parameters == ("body_1.youngs_modulus", "cell.layers")
    results = [(case.body_1.youngs_modulus, case.cell.layers) for case in sweep.points]
    assert results == [(70e9, 8), (70e9, 14), (210e9, 8), (210e9, 14)]
    assert sweep.settings[1] == ("70 GPa", "14")
    assert len(set(sweep.folders(write("")))) == 4
    quick = sweep.quick()
    assert tuple(quick.content["cell"]["points"]) == quick.points[0].cell.points
    assert quick.content["sweep"] == sweep.content["sweep"]


def test_a_table_that_the_case_leaves_out_may_be_swept(write):
    sweep = load_sweep(write(SMALL + "[sweep]\nlaw.terms = [6, 8]\n"))
    assert [case.law.terms for case in sweep.points] == [6, 8]


@pytest.mark.parametrize(("base", "patches", "sentence"), refused_rows("sweep"))
def test_a_bad_sweep_is_refused_in_one_sentence(tmp_path, base, patches, sentence):
    with pytest.raises(CaseError, match=sentence):
        load_sweep(write_scene(tmp_path, SMALL, *patches))


def test_a_sweep_of_too_many_points_is_refused(write):
    lists = "".join(f"cell.{name} = {list(range(400))}\n" for name in ("layers", "depth"))
    with pytest.raises(CaseError, match="makes 160000 points; list fewer values"):
        load_sweep(write(f"{SMALL}\n[sweep]\n{lists}"))


JOINT = (
    TWO_BLOCKS.replace("friction", 'law = "law.nc"\nfriction')
    + """
[cycles]
shear = "1 MPa"
cycles = 1
steps = 2
[sweep]
interface.friction = [0.2, 0.3, 0.01]
"""
)
GRID = case_text("swept_grid")


@pytest.mark.slow
def test_a_sweep_of_a_joint_that_slips_keeps_its_answers_and_reports_which_slides(write, tmp_path):
    write_law(tmp_path / "law.nc")
    sweep = load_sweep(write(JOINT))
    result = run_sweep(sweep, tmp_path / "out")
    alone = run(sweep.points[1], tmp_path / "alone").macro_result
    band = result["joint_stiffness"] * xr.DataArray([0.9, 1.1], dims="limit")
    (sentence,) = POINTS.answer(result.assign(joint_stiffness_mean_law=band))
    assert "joint stiffness 9.5 MPa/µm" in sentence  # the digits that 10 % leave
    ends = {name: sweep_ends(result, name)["value"] for name in result["answer"].values}
    assert {"tangential_stiffness", "slipping_load", "cycle_energy"} <= set(ends)
    assert float(ends["cycle_energy"][1]) == float(alone["cycle_energy"][-1])
    assert float(ends["slipping_load"][1]) == float(alone["slipping_load"][-1])
    assert float(ends["joint_stiffness"][1]) == float(alone["joint_stiffness"][1])  # at 20 MPa
    np.testing.assert_array_equal(np.isnan(ends["cycle_energy"]), [False, False, True])
    assert np.isfinite(ends["joint_stiffness"]).all()
    assert list(result["failure"].values) == ["", "", ""]
    assert "slide on interface 0" in result["caution"].values[2]
    assert "slide" not in result["caution"].values[0]


@pytest.mark.slow
def test_a_sweep_of_a_truss_has_the_numbers_of_its_table(write, tmp_path):
    sweep = load_sweep(write(GRID))
    result = run_sweep(sweep, tmp_path / "out")
    tension = [
        float(solve_static(item.structure.build(), 0.5 * steps).tension.max())
        for steps, item in zip((1, 1, 2, 2), sweep.points, strict=True)
    ]
    ends = sweep_ends(result, "largest_tension")
    np.testing.assert_allclose(ends["value"], tension, rtol=1e-6)
    assert np.isnan(ends["mean_law"]).all()
    assert np.isnan(result["largest_tension"].values[:2, 1]).all()  # one step only
    head, rows = tabulate_sweep(result)
    assert head[-1] == "largest tension (kN)"
    assert rows[0][-1] == f"{1e-3 * tension[0]:.4g}"
    for answer in result["answer"].values:
        drawn = plot_sweep(result, answer, ax=Figure().add_subplot())
        assert len(drawn.lines) >= 2  # a line for each prestress


def test_a_case_that_is_a_sweep_is_not_loaded_as_one_case(write):
    with pytest.raises(CaseError, match="load it with load_sweep"):
        load_case(write(SMALL + SWEEP))


@pytest.mark.slow
def test_each_point_is_the_run_of_its_case_and_a_failure_is_a_sentence(write, tmp_path):
    text = SMALL.replace("[36, 36]", "[40, 40]") + "[sweep]\ncell.points = [[36, 36], [16, 16]]\n"
    sweep = load_sweep(write(text))
    counts = []
    result = run_sweep(sweep, tmp_path / "out", progress=counts.append)
    assert counts == [0, 1, 2]
    alone = run(sweep.points[0], tmp_path / "alone").macro_result
    np.testing.assert_array_equal(result["joint_stiffness"][0], alone["joint_stiffness"])
    np.testing.assert_array_equal(result["preload"][0], alone["preload"])
    assert "16 x 16 points cannot carry short_cutoff" in result["failure"].values[1]
    assert np.isnan(result["joint_stiffness"][1]).all()
    assert result["failure"].values[0] == ""
    assert list(result["cell.points"].values) == ["[36, 36]", "[16, 16]"]


@pytest.mark.slow
def test_a_sweep_that_grows_keeps_its_points(write, tmp_path):
    run_sweep(load_sweep(write(SMALL + "[sweep]\ncell.layers = [8]\n")), tmp_path / "out")
    (stored,) = (tmp_path / "out").glob("points/*/macro_result.nc")
    before = stored.stat().st_mtime_ns
    sweep = load_sweep(write(SMALL + "[sweep]\ncell.layers = [6, 8]\n"))
    grown = run_sweep(sweep, tmp_path / "out")
    assert stored.stat().st_mtime_ns == before
    assert list(grown["cell.layers"].values) == [6.0, 8.0]
    assert not any(grown["failure"].values)
    assert list(load_sweep(tmp_path / "out" / "case.toml").points) == list(sweep.points)
    with pytest.raises(CaseError, match="holds a sweep; choose another folder"):
        run(sweep.points[0], tmp_path / "out")
    with pytest.raises(CaseError, match="has a single run; choose another folder for a sweep"):
        run_sweep(sweep, stored.parent)


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


@pytest.fixture
def solved(monkeypatch):
    """Store no run folders, and list the points that are run."""
    titles, whole = [], sweep_module.run
    monkeypatch.setattr(sweep_module, "MOST_KEPT", 0)
    monkeypatch.setattr(
        sweep_module, "run", lambda case, *a, **k: titles.append(case.title) or whole(case, *a, **k)
    )
    return titles


def test_a_large_sweep_leaves_a_file_a_point_and_a_killed_one_repeats_no_point(
    write, tmp_path, solved
):
    sweep = load_sweep(write(GRID))
    stored = run_sweep(sweep, tmp_path / "kept", keep=True)
    assert len(list((tmp_path / "kept").glob("points/*/macro_result.nc"))) == 4

    def kill(finished):
        if finished == 2:
            raise KeyboardInterrupt

    solved.clear()
    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep, tmp_path / "out", progress=kill)
    resumed = run_sweep(sweep, tmp_path / "out")
    xr.testing.assert_identical(resumed, stored)
    assert solved == [case.title for case in sweep.points]  # each once
    points = sorted(f"points/{folder.name}.v2.nc" for folder in sweep.folders(tmp_path))
    assert files(tmp_path / "out") == ["case.toml", *points, "sweep.nc"]
    run_sweep(sweep, tmp_path / "out", keep=True)
    assert len(solved) == 8  # of which no folders were left


def test_a_sparing_run_keeps_what_took_long_and_goes_on_from_it(write, tmp_path, monkeypatch):
    case = load_sweep(write(GRID)).points[1]

    def tension(folder, worth):
        monkeypatch.setattr(import_module("multiscale.pipeline.runner"), "WORTH", worth)
        return run(case, tmp_path / folder, sparing=True).macro_result["tension"]

    alone = tension("spared", np.inf)
    assert not (tmp_path / "spared").exists()
    xr.testing.assert_identical(tension("long", 0.0), alone)
    assert files(tmp_path / "long") == ["macro_result.nc"]
    written = (tmp_path / "long" / "macro_result.nc").stat().st_mtime_ns
    xr.testing.assert_identical(tension("long", 0.0), alone)
    assert (tmp_path / "long" / "macro_result.nc").stat().st_mtime_ns == written


def test_a_full_disk_ends_a_sweep_in_a_sentence_and_stored_results_stay(write, tmp_path, solved):
    resource = pytest.importorskip("resource")
    sweep, before = load_sweep(write(GRID)), resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(finished):
        if finished == 2:
            resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))

    try:
        with pytest.raises(FileError, match=r"cannot write .*: file too large; "):
            run_sweep(sweep, tmp_path / "out", progress=fill)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    solved.clear()
    assert not any(run_sweep(sweep, tmp_path / "out")["failure"].values)
    assert solved == [case.title for case in sweep.points][2:]


def test_a_folder_that_cannot_be_written_ends_a_sweep_without_a_failure_of_a_point(write, tmp_path):
    sweep = load_sweep(write(GRID))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "points").touch()
    with pytest.raises(FileError, match=r"cannot write .*points: file exists; choose"):
        run_sweep(sweep, tmp_path / "out")


@pytest.mark.slow
def test_a_point_that_failed_fails_again_and_a_damaged_point_is_run_again(
    write, tmp_path, monkeypatch
):
    def solve(case, law):
        result = solve_joint(case, law)
        if case.cell.layers == 8:
            result["converged"][:] = 0
        return result

    monkeypatch.setattr(import_module("multiscale.pipeline.stages.joint"), "solve_joint", solve)
    sweep = load_sweep(write(SMALL + "[sweep]\ncell.layers = [8, 14]\n"))
    first = run_sweep(sweep, tmp_path / "out")
    assert "the joint did not converge at any of 6 preloads" in first["failure"].values[0]
    assert first["failure"].values[1] == ""
    damaged = sweep.folders(tmp_path / "out")[1] / "macro_result.nc"
    damaged.write_bytes(damaged.read_bytes()[:1000])
    second = run_sweep(sweep, tmp_path / "out")
    xr.testing.assert_identical(first, second)


def test_a_sweep_without_any_result_is_an_error(write, tmp_path):
    sweep = load_sweep(write(SMALL + "[sweep]\ncell.points = [[16, 16]]\n"))
    with pytest.raises(MultiscaleError, match=r"none of the 1 points .* at cell.points = \[16"):
        run_sweep(sweep, tmp_path / "out")


def test_sentences_of_points_that_differ_by_numbers_are_printed_once():
    lines = [
        ("body_1 reaches 631 MPa", 0),
        ("body_2 reaches 2 MPa", 1),
        ("body_1 reaches 2 GPa", 2),
    ]
    assert _places(lines) == {
        "body_1 reaches 631 MPa (numbers of the first of these points)": [0, 2],
        "body_2 reaches 2 MPa": [1],
    }
    both = [(f"interface {joint}: no budget", point) for point in (0, 1) for joint in (0, 1)]
    assert _places(both) == {"interface 0: no budget": [0, 1], "interface 1: no budget": [0, 1]}


@pytest.mark.slow
@pytest.mark.usefixtures("without_pages")
def test_messages_separate_keys_of_one_name_and_cautions_of_points_are_printed(write, tmp_path):
    modulus = '.youngs_modulus = ["70 GPa", "210 GPa"]'
    table = f"[sweep]\nbody_1{modulus}\nbody_2{modulus}\ncell.points = [[36, 36], [16, 16]]\n"
    arguments = ["run", str(write(SMALL + table)), "-o", str(tmp_path / "out"), "--jobs", "1"]
    first = CliRunner().invoke(app, arguments)
    assert first.exit_code == 0, first.output
    setting = "body_1.youngs_modulus = 70 GPa, body_2.youngs_modulus = {} GPa, cell.points = [16"
    for value in (70, 210):
        assert setting.format(value) in first.stderr
    # each reason once, with its points
    assert first.stderr.count("no result: [body_1.surface] 16 x 16 points cannot carry") == 1
    assert "and 1 more: no result" in first.stderr
    sentence = (
        "caution: at every point with a result: the shortest wavelength of body_1 has 2.2 points"
    )
    assert sentence in first.stderr
    assert setting.format(210) in (tmp_path / "out" / "log.txt").read_text(encoding="utf-8")
    # points that are finished already are printed, too
    assert sentence in CliRunner().invoke(app, arguments).stderr
