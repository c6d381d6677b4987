"""Unknown terms of a budget are named by keys of a case or scene file."""

from multiscale.io import open_law, open_response
from multiscale.pipeline import load_case, run_macro
from multiscale.pipeline.case_cells import case_budget
from multiscale.upscaling import fit_law
from tests.support import TWO_BLOCKS, write_scene


def test_every_term_that_is_not_known_names_a_key(run_folder):
    case = load_case(run_folder / "case.toml")
    response = open_response(run_folder / "micro_response.nc").isel(realisation=[0])
    text = case_budget(case, response, fit_law(response, n_samples=0)).attrs
    assert text["unknown"] == "sampling, cell size, micro discretisation"
    assert "give realisations = 3 or more in [micro]" in text["how_sampling"]
    assert "a target in [accuracy]" in text["how_cell_size"]
    assert "give coarser = 1 in [micro]" in text["how_micro_discretisation"]
    assert not text["how_scale_separation"].startswith("not known")


def test_a_scene_with_elements_that_cannot_be_doubled_is_reported(run_folder, tmp_path):
    scene = write_scene(tmp_path, TWO_BLOCKS, ("[2, 2, 1]", "[3, 3, 1]"), ("20 MPa", "80 MPa"))
    assert "error_half_width" in open_law(run_folder / "interface_law.nc")
    result = run_macro(
        load_case(scene),
        tmp_path / "result.nc",
        law=run_folder / "interface_law.nc",
    )
    assert "an even number, in [structure]" in result.attrs["how_macro_discretisation"]
