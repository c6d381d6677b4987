"""A run folder belongs to one case, and its report shows no result of another case."""

from dataclasses import replace
from shutil import copytree

import pytest
from typer.testing import CliRunner

from multiscale.cli import app
from multiscale.errors import CaseError, ConvergenceError, SchemaError
from multiscale.io import make_folder, open_dataset, read_text, write_dataset
from multiscale.pipeline import load_case, run
from multiscale.pipeline.run_folder import claim_folder, read_up_to_date
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.verification import verify_run
from multiscale.report import draw_figures, write_report
from multiscale.schema import SCHEMAS
from tests.support import SCENES, write_law


@pytest.fixture
def folder(run_folder, tmp_path):
    copytree(run_folder, tmp_path / "out")
    return tmp_path / "out"


def test_the_same_case_finds_its_result(folder):
    before = (folder / "macro_result.nc").read_bytes()
    claim_folder(folder, load_case(folder / "case.toml"))
    assert (folder / "macro_result.nc").read_bytes() == before


@pytest.mark.slow
def test_another_joint_of_the_same_cells_has_no_result_until_it_is_solved(folder):
    case = load_case(folder / "case.toml")
    other = case.model_copy(
        update={"statics": case.statics.model_copy(update={"preloads": (12.5e6, 50e6)})}
    )
    stored = ("micro_response", "interface_law")
    before = [(folder / f"{name}.nc").stat().st_mtime_ns for name in stored]
    claim_folder(folder, other)  # the run is killed here
    for show in (draw_figures, write_report):
        with pytest.raises(SchemaError, match=r"not finished, as \S+nc is missing; run its case"):
            show(folder)
    cells = (folder / "micro" / "realisation-0000.nc").stat().st_mtime_ns
    run(other, folder)
    assert (folder / "micro" / "realisation-0000.nc").stat().st_mtime_ns == cells
    assert [(folder / f"{name}.nc").stat().st_mtime_ns for name in stored] == before
    page = write_report(folder).read_text(encoding="utf-8")
    assert "At a preload of 50 MPa" in page


def test_cells_of_another_case_or_of_another_kind_are_left_unchanged(folder):
    text = read_text(folder / "case.toml")
    for other in (load_case("ground_steel"), load_case("tyre_on_road")):
        with pytest.raises(CaseError, match=r"holds another run, 'Ground steel .*choose another"):
            claim_folder(folder, other)
    assert read_text(folder / "case.toml") == text


def test_a_folder_of_another_case_is_refused_with_what_differs(tmp_path):
    (tmp_path / "nodes.csv").write_text(
        "x,y,z,fix_x,fix_y,fix_z,load_z\n0,0,0,1,1,1,0\n0,0,-1,1,1,0,-9\n"
    )
    (tmp_path / "links.csv").write_text("first,second,law\n0,1,rope\n")
    text = """title = "lamp"
[structure]
kind = "table"
nodes = "nodes.csv"
links = "links.csv"
laws.rope = { kind = "cable", rigidity = "200 kN" }
[statics]
load_factors = [1.0]
"""
    first, other = tmp_path / "first.toml", tmp_path / "other.toml"
    first.write_text(text)
    other.write_text(text.replace("200 kN", "300 kN"))
    out = tmp_path / "out"
    run(load_case(first), out)
    with pytest.raises(CaseError, match=r"of kind 'table', which differs in structure.laws; choo"):
        run(load_case(other), out)
    other.write_text(text.replace("links.csv", "rods.csv"))
    (tmp_path / "links.csv").rename(tmp_path / "rods.csv")
    message = (
        r"out holds another run, with a case that can no longer be read \(.*links.csv: no such"
    )
    with pytest.raises(CaseError, match=message):
        run(load_case(other), out)


def test_a_folder_of_a_sweep_refuses_a_single_run(tmp_path):
    make_folder(tmp_path / "out")
    (tmp_path / "out" / "case.toml").write_text("sweep = {}")
    (tmp_path / "out" / "sweep.nc").touch()
    with pytest.raises(CaseError, match="holds a sweep; choose another folder"):
        run(load_case("ground_steel"), tmp_path / "out")


def test_a_stage_is_computed_again_after_its_inputs_and_no_earlier_stage(folder):
    case = load_case(folder / "case.toml")

    def out_of_date(**changes):
        other = case.model_copy(update=changes)
        return [
            stage.name
            for stage in stages_of(case.tables)
            if stage.identity(case) != stage.identity(other)
        ]

    law = case.law.model_copy(update={"samples": 7})
    wide = case.structure.model_copy(update={"width": 0.5})
    high = case.structure.model_copy(update={"height": 0.5})
    assert out_of_date(structure=high) == ["macro_result"]
    assert out_of_date(law=law) == ["interface_law", "macro_result"]
    scales = ["interface_law", "macro_result"]  # the law compares its cells with the width
    assert out_of_date(structure=wide) == scales
    assert out_of_date(elastic=True) == ["micro_response", "interface_law", "macro_result"]


def test_a_structure_is_run_shown_and_solved_again_under_another_load(tmp_path):
    scene = SCENES / "tensegrity_grid.toml"
    out = tmp_path / "grid"
    done = CliRunner().invoke(app, ["run", str(scene), "-o", str(out), "--quick"])
    assert done.exit_code == 0, done.output
    assert done.output.splitlines()[0] == "Tensegrity grid at rest (quick)"
    assert "slack links" in (out / "report.html").read_text(encoding="utf-8")
    assert (out / "fields" / "macro_result.pvd").is_file()
    case = load_case(out / "case.toml")
    before = (out / "macro_result.nc").stat().st_mtime_ns
    assert run(case, out).macro_result.sizes["step"] == 5
    assert (out / "macro_result.nc").stat().st_mtime_ns == before
    statics = case.statics.model_copy(update={"load_factors": (1.0,)})
    assert run(case.model_copy(update={"statics": statics}), out).macro_result.sizes["step"] == 1
    smaller = case.structure.model_copy(update={"n": 3})
    with pytest.raises(CaseError, match=r"holds another run, .* of a structure of kind 'tensegr"):
        run(case.model_copy(update={"structure": smaller}), out)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "lost", "show"),
    [
        ("macro_result", "how_fit", write_report),
        ("macro_result", "interface_stiffness", draw_figures),
        ("micro_response", "bodies", write_report),
        ("micro_response", "nominal_pressure", draw_figures),
    ],
)
def test_a_dataset_of_an_earlier_version_is_answered_in_a_sentence(folder, name, lost, show):
    file, schema = folder / f"{name}.nc", SCHEMAS[name]
    old = open_dataset(file, schema).drop_vars(lost, errors="ignore")
    old.attrs.pop(lost, None)
    write_dataset(old, file, schema)
    with pytest.raises(SchemaError, match=f"has no {lost}, as in runs of an earlier version"):
        show(folder)


def test_a_realisation_computed_again_agrees_or_names_the_change(folder, tmp_path):
    assert verify_run(folder).startswith("the first realisation computed again agrees within")
    file, schema = folder / "micro_response.nc", SCHEMAS["micro_response"]
    changed = open_dataset(file, schema).load()
    changed["mean_gap"][0, 2] *= 1.00001
    write_dataset(changed, file, schema)
    with pytest.raises(ConvergenceError, match=r"differs by .* of the largest mean gap"):
        verify_run(folder)
    changed = changed.assign(contact_fraction=0.0 * changed["contact_fraction"])
    write_dataset(changed, file, schema)
    with pytest.raises(ConvergenceError, match=r"differs by 1.0e\+00 of the largest contact"):
        verify_run(folder)
    (tmp_path / "case.toml").write_text(read_text(SCENES / "cable_net.toml"))
    with pytest.raises(CaseError, match="its case has no cells"):
        verify_run(tmp_path)


def test_a_structure_without_cells_is_not_another_run_of_its_folder(folder, tmp_path):
    case = load_case(folder / "case.toml")
    write_law(tmp_path / "law.nc")
    part = case.from_structure(tmp_path / "law.nc")
    with pytest.raises(CaseError, match="the cells of this case too, which --from structure"):
        claim_folder(folder, part)
    claim_folder(tmp_path, part)
    (tmp_path / "macro_result.nc").touch()
    with pytest.raises(CaseError, match="holds the run of this case --from structure"):
        claim_folder(tmp_path, case)


def test_a_run_with_a_folder_that_another_run_takes_ends_in_a_sentence(folder, monkeypatch):
    case = load_case(folder / "case.toml")
    text = "# another case"
    monkeypatch.setattr(
        "multiscale.pipeline.runner.prepare", lambda _: (folder / "case.toml").write_text(text)
    )
    with pytest.raises(CaseError, match="another run has written its case into this folder"):
        run(case, folder)


@pytest.mark.slow
def test_results_of_another_run_in_the_folder_are_not_taken(folder):
    case = load_case(folder / "case.toml")
    other = case.model_copy(
        update={"statics": case.statics.model_copy(update={"preloads": (12.5e6, 50e6)})}
    )
    theirs = (folder / "macro_result.nc").read_bytes()
    claim_folder(folder, other)
    (folder / "macro_result.nc").write_bytes(theirs)  # of the run that ends after the claim
    answers = [stage for stage in stages_of(case.tables) if stage.name == "macro_result"]
    assert read_up_to_date(answers[0], other, folder) is None
    assert run(other, folder).macro_result.sizes["step"] == 2


def test_a_link_in_a_run_folder_is_replaced_and_its_target_stays(folder, tmp_path):
    outside = tmp_path / "outside.html"
    outside.write_text("mine")
    (folder / "report.html").unlink(missing_ok=True)
    (folder / "report.html").symlink_to(outside)
    page = write_report(folder)
    assert outside.read_text() == "mine"
    assert not page.is_symlink()


def test_a_dataset_of_a_newer_version_is_answered_in_a_sentence(folder):
    file, schema = folder / "macro_result.nc", SCHEMAS["macro_result"]
    newer = replace(schema, version=schema.version + 1)
    write_dataset(open_dataset(file, schema).load(), file, newer)
    with pytest.raises(SchemaError, match="version"):
        write_report(folder)
    before = file.read_bytes()
    case = load_case(folder / "case.toml")
    sentence = rf"macro_result.nc: macro_result of schema version {newer.version}, .* version "
    with pytest.raises(SchemaError, match=rf"{sentence}{schema.version}; use a newer .* with -o"):
        run(case, folder)
    assert file.read_bytes() == before
    claim_folder(folder, case, force=True)
    assert not file.exists()
