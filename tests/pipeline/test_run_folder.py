"""A run folder belongs to one case, and its report shows no result of another one."""

from shutil import copytree

import pytest

from multiscale.errors import CaseError, SchemaError
from multiscale.io import make_folder, open_dataset, read_text, write_dataset
from multiscale.pipeline import load_case, load_tyre, run
from multiscale.pipeline.run_folder import claim_folder
from multiscale.report import draw_figures, write_report
from multiscale.schema import SCHEMAS


@pytest.fixture
def folder(run_folder, tmp_path):
    copytree(run_folder, tmp_path / "out")
    return tmp_path / "out"


def test_the_same_case_finds_its_result(folder):
    before = (folder / "macro_result.nc").read_bytes()
    claim_folder(folder, load_case(folder / "case.toml"))
    assert (folder / "macro_result.nc").read_bytes() == before


def test_another_joint_of_the_same_cells_has_no_result_until_it_is_solved(folder):
    case = load_case(folder / "case.toml")
    other = case.model_copy(
        update={"joint": case.joint.model_copy(update={"preloads": (12.5e6, 50e6)})}
    )
    claim_folder(folder, other)  # the run is killed here
    for show in (draw_figures, write_report):
        with pytest.raises(SchemaError, match="the run is not finished"):
            show(folder)
    cells = (folder / "micro" / "realisation-0000.nc").stat().st_mtime_ns
    run(other, folder)
    assert (folder / "micro" / "realisation-0000.nc").stat().st_mtime_ns == cells
    page = write_report(folder).read_text(encoding="utf-8")
    assert "pressed together by 12.5 to 50 MPa" in page


def test_cells_of_another_case_or_of_another_kind_are_left_alone(folder):
    text = read_text(folder / "case.toml")
    for other in (load_case("ground_steel"), load_tyre("tyre_on_road")):
        with pytest.raises(CaseError, match=r"holds another run, 'Ground steel .*choose another"):
            claim_folder(folder, other)
    assert read_text(folder / "case.toml") == text


def test_a_folder_of_a_sweep_takes_no_single_run(tmp_path):
    make_folder(tmp_path / "out")
    (tmp_path / "out" / "sweep.nc").touch()
    with pytest.raises(CaseError, match="holds a sweep; choose another folder"):
        run(load_case("ground_steel"), tmp_path / "out")


@pytest.mark.parametrize(
    ("name", "lost", "show"),
    [
        ("macro_result", "contact_fraction", write_report),
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
    with pytest.raises(SchemaError, match=f"has no {lost}, as one of .*; run the case again"):
        show(folder)


@pytest.mark.slow
def test_every_figure_that_is_drawn_stands_on_the_page_and_no_other(folder):
    (folder / "figures" / "of_an_earlier_case.png").write_bytes(b"")
    page = write_report(folder).read_text(encoding="utf-8")
    for file in draw_figures(folder):
        assert f'alt="{file.stem.replace("_", " ")}"' in page
    assert "of an earlier case" not in page
