"""Cases of sheared cells: the law gets friction, and joints take it from there."""

from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import open_dataset, open_law, open_run, save_law
from multiscale.laws.bulk import Elastic
from multiscale.micro import FiniteCell
from multiscale.pipeline import load_case, make_cells, requirements, run, run_macro
from multiscale.pipeline.case_cells import two_surfaces
from multiscale.pipeline.stage import Job
from multiscale.pipeline.stages.ensembles import SHEARED_CELLS
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.schema import SHEAR_RESPONSE, SLIDING_RESPONSE
from multiscale.upscaling import assume_shear, sliders_from_dataset
from multiscale.upscaling.shear_budget import shear_errors
from tests.support import TWO_BLOCKS, case_of, joints_of, slow, small_steel, write_law, write_scene

SHEAR = """
[micro.shear]
friction_coefficient = 0.2
pressures = ["20 MPa"]
points = [20, 20]
layers = 4
steps = 6
"""
STEEL_WAVE = 'short_cutoff = "180 um"'
STEEL = small_steel(3).replace("[36, 36]", "[24, 24]").replace('short_cutoff = "50 um"', STEEL_WAVE)
CELLS = STEEL[: STEEL.index("[structure]")]
PLAIN = TWO_BLOCKS.replace("friction = 0.2\nstiffness_ratio = 0.8\n", "").replace('"5 MPa", ', "")
ROUGH = PLAIN[PLAIN.index("[structure]") :] + '[cycles]\nshear = "1 MPa"\ncycles = 1\nsteps = 2\n'
LAW = "[law]\nsamples = 10\n"
CHAIN = CELLS + LAW + SHEAR + ROUGH
THEORY = 2.0 * 0.7 / 1.7


@pytest.fixture(scope="module", params=slow("sheared"))
def finished(request, text_run):
    return text_run(request.param, CHAIN)


def test_the_chain_goes_from_surfaces_to_the_friction_of_a_joint(finished):
    case, out, results = finished
    stages = ["micro_response", "shear_response", "interface_law", "macro_result"]
    assert list(results) == stages
    law = results.interface_law
    assert law.attrs["branches"].endswith("shear: measured")
    assert float(law["shear_friction"]) == pytest.approx(0.2, rel=0.02)
    np.testing.assert_allclose(law["shear_stiffness_ratio"], THEORY, rtol=0.2)  # a coarse grid
    part = law["error_half_width"].sel(quantity="tangential_traction", error_term="friction bed")
    assert np.all(part.values > 0.0)
    assert np.all(np.abs(law["shear_loss_ratio"] - 1.0) < 0.5)
    assert np.isfinite(results.macro_result["cycle_energy_mean_law"].values).all()
    bodies, (taken,) = joints_of(case, results)
    (bed,) = bodies.sliders(case, [taken])
    assert bed.friction == float(law["shear_friction"])
    assert bed.stiffness_ratio == float(law["shear_stiffness_ratio"].mean())
    drawn = sliders_from_dataset(taken, 3, **bodies.beds(case))
    assert drawn.friction == float(law["shear_friction_sample"][3])
    assert "assumed" not in results.macro_result.attrs["cautions"]
    assert results.macro_result["cycle_energy"].values[0] > 0.0
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "of full slip the loss of the cells" in page
    assert set(open_run(out)) == set(stages)
    assert "before slip the tangential stiffness of the interface is 0." in page
    assert "The friction of points of contact, 0.2, is an input of the cells" in page
    assert "shear is measured" in page


def test_sheared_cells_have_both_bodies_and_the_surfaces_of_the_pressed_cells(finished):
    case, _, results = finished
    for item, (lower, upper) in zip(make_cells(case), two_surfaces(case), strict=True):
        np.testing.assert_allclose(lower.heights + upper.heights, item.surface.heights, atol=1e-18)
    shear = results["shear_response"]
    SHEAR_RESPONSE.check(shear)
    assert shear["converged"].values.all()
    pressure = shear["nominal_pressure"].values
    released = int(np.argmin(pressure))  # before the shear, pressed also near its pressure
    assert {*case.micro.pressures, 8e6, 11e6, 14e6, 17e6, 20e6} == {*pressure[:released]}
    assert np.all(np.diff(pressure[:released]) > 0.0)
    np.testing.assert_array_equal(np.unique(pressure[released:]), [0.0, 20e6])


@pytest.mark.slow
def test_other_loads_shear_no_cell_and_another_shear_presses_none(finished, tmp_path):
    _, first, _ = finished
    case, out = case_of(tmp_path, CELLS + LAW + SHEAR), tmp_path / "out"
    copytree(first, out)
    files = [*out.glob("micro*/**/realisation-*.nc"), out / "shear_response.nc"]
    before = {file: file.stat().st_mtime_ns for file in files}
    assert len(files) == 9  # with one realisation to both orders in the slope
    run(case, out)  # without the structure
    assert before == {file: file.stat().st_mtime_ns for file in files}
    (out / "shear_response.nc").unlink()  # as of a run that was killed
    run(case, out)
    assert all(before[file] == file.stat().st_mtime_ns for file in files[:-1])
    shear = case.micro.shear.model_copy(update={"steps": 5, "realisations": 1})
    micro = case.micro.model_copy(update={"shear": shear})
    run(case.model_copy(update={"micro": micro}), out)
    assert open_dataset(out / "shear_response.nc", SHEAR_RESPONSE).sizes["realisation"] == 1
    assert all(before[file] == file.stat().st_mtime_ns for file in files[:-1])
    assert open_law(out / "interface_law.nc").attrs["n_sheared"] == 1


@pytest.mark.slow
def test_the_command_fits_the_same_law_from_files_and_exports_it(finished, command, tmp_path):
    _, out, results = finished
    status, output, _ = command(
        "fit", out / "micro_response.nc", "--shear", out / "shear_response.nc", "-o", "law.nc"
    )
    assert status == 0
    assert "shear: measured" in output
    fitted = open_law("law.nc")
    for name in ("coefficient", "shear_stiffness_ratio", "shear_friction"):
        np.testing.assert_array_equal(fitted[name], results.interface_law[name])
        samples = f"{name}_sample"  # of which the case has asked for few
        np.testing.assert_array_equal(fitted[samples][:10], results.interface_law[samples])
    status, _, error = command("fit", out / "micro_response.nc", "--shear", out / "case.toml")
    assert status == 1
    assert "case.toml: not a readable netCDF file" in error

    friction = float(fitted["shear_friction"])
    for code, words in (("abaqus", "*FRICTION, ELASTIC SLIP="), ("calculix", "*FRICTION\n")):
        options = ("--friction", code, "--stick-pressure", "20 MPa", "--name", "LAP")
        status, _, error = command("export", "law.nc", f"{code}.inp", *options)
        assert status == 0, error
        text = Path(f"{code}.inp").read_text(encoding="ascii")
        assert "*SURFACE INTERACTION, NAME=LAP" in text
        assert words in text
        assert f"{friction:.9e}" in text
        assert "at 20 MPa" in text
    write_law(tmp_path / "plain.nc")
    assert command("export", "plain.nc", "law.csv", "--length-unit", "um")[0] == 0
    assert Path("law.csv").read_text().startswith("pressure (MPa),gap (um)")


def test_a_given_value_replaces_a_measured_value_and_is_reported(finished):
    case, _, results = finished
    given = case.model_copy(
        update={"interface": case.interface.model_copy(update={"friction": 0.3})}
    )
    bodies, (law,) = joints_of(given, results)
    drawn = sliders_from_dataset(law, 2, **bodies.beds(given))
    assert drawn.friction == 0.3
    assert drawn.stiffness_ratio != float(law["shear_stiffness_ratio"].mean())  # the sample's
    assert law.attrs["branches"].endswith("shear: measured, but friction 0.3 given")
    assert "friction coefficient of 0.3 replaces the 0." in (law.attrs["cautions"])
    strict = given.model_copy(update={"strict": True})
    assert joints_of(strict, results)[1][0].identical(law)


@pytest.mark.slow
def test_a_missing_value_is_assumed_by_theory_or_refused(tmp_path):
    law = write_law(tmp_path / "law.nc")
    text = PLAIN.replace("[interface]", '[interface]\nlaw = "law.nc"\nfriction = 0.3')
    text = text.replace("poissons_ratio = 0", "poissons_ratio = 0.3")
    result = run_macro(case_of(tmp_path, text), tmp_path / "out.nc")
    sentence = (
        "its law: the tangential stiffness ratio of 0.824 is assumed; shear the cells to measure"
    )
    assert sentence in result.attrs["cautions"]
    strict = case_of(tmp_path, "strict = true\n" + text)
    with pytest.raises(
        CaseError, match=r"no stiffness_ratio, and neither .* strict = true assumes nothing"
    ):
        run_macro(strict, tmp_path / "out.nc")
    none = case_of(tmp_path, text.replace("friction = 0.3\n", ""))
    with pytest.raises(
        CaseError, match=r"no friction, and neither has the law .*\[micro.shear\], slide"
    ):
        run_macro(none, tmp_path / "out.nc")
    save_law(assume_shear(open_law(law), friction=0.2, stiffness_ratio=0.8), law)
    bodies, laws = joints_of(none)
    (bed,) = bodies.sliders(none, laws)
    assert (bed.friction, bed.stiffness_ratio) == (0.2, 0.8)
    with pytest.raises(CaseError, match=r"has no stiffness_ratio"):
        run_macro(strict, tmp_path / "out.nc")


def seconds_of(needs, stage):
    return next(cost.seconds for cost in needs.costs if cost.stage == stage)


def test_needs_and_quick_list_the_sheared_cells(tmp_path):
    case = case_of(tmp_path, CHAIN)
    needs = requirements(case)
    text = needs.built["sheared cells"]
    assert "3 of two bodies with friction, 20 x 20 points and 9600 unknowns" in text
    assert "each in 37 steps" in text
    assert seconds_of(needs, "shear_response") < 60.0
    more = case.micro.shear.model_copy(update={"pressures": (8e6, 20e6, 60e6), "points": None})
    quick = case.model_copy(update={"micro": case.micro.model_copy(update={"shear": more})}).quick()
    assert quick.micro.shear.pressures == (20e6,)
    large = case_of(
        tmp_path, CHAIN.replace("[24, 24]", "[512, 512]").replace("points = [20, 20]\n", "")
    )
    assert seconds_of(requirements(large), "shear_response") > 600.0


def test_bodies_keep_separate_moduli(finished, monkeypatch, tmp_path):
    case, _, _ = finished
    soft = case.body_2.model_copy(update={"youngs_modulus": 70e9, "surface": None})
    made: list[FiniteCell] = []

    def note(cells, path, **options):
        made.extend(cells)
        raise CaseError("seen")

    monkeypatch.setattr("multiscale.pipeline.stages.ensembles.run_ensemble", note)
    with pytest.raises(CaseError, match="seen"):
        SHEARED_CELLS.run(case.model_copy(update={"body_2": soft}), {}, Job(tmp_path))
    assert made[0].law == Elastic(210e9, 0.3)
    assert made[0].second.law == Elastic(70e9, 0.3)
    assert not made[0].obstacle.heights.any()


def slid_cells(steady):
    """Cells that slid under 20 and 40 MPa, of which only the steady friction is given."""
    sizes = {"load": 2, "step": 3}
    values = {
        name: np.ones([*sizes.values(), 3][: len(value.dims)])
        for name, value in SLIDING_RESPONSE.variables.items()
    }
    return SLIDING_RESPONSE.build(
        values | {"steady_friction": steady, "nominal_pressure": [2e7, 4e7]}
    )


def test_friction_of_a_slide_enters_the_law_where_it_is_steady(finished):
    case, _, results = finished
    slid = slid_cells([0.21, np.nan])
    law = FITTED_LAW.run(case, {**results, "sliding_response": slid}, None)
    assert float(law["sliding_friction"][0]) == 0.21
    assert law.attrs["branches"].endswith("shear: measured; sliding: measured")
    unsteady = slid.assign(steady_friction=np.nan * slid["steady_friction"])
    law = FITTED_LAW.run(case, {**results, "sliding_response": unsteady}, None)
    assert "sliding" not in law.attrs["branches"]


def test_friction_of_a_slide_replaces_a_missing_friction(finished, tmp_path):
    """At the last preload, which is 40 MPa, with a loss of then unknown error."""
    _, _, results = finished
    slide = '[slide]\ndistance = "800 um"\n'
    text = (
        CHAIN.replace(SHEAR, slide)
        .replace('"20 MPa"]', '"40 MPa"]')
        .replace('"flat"', '"conforming"')
    )
    case = case_of(tmp_path, text)
    entry = {
        "micro_response": results["micro_response"],
        "sliding_response": slid_cells([0.2, 0.3]),
    }
    entry["interface_law"] = FITTED_LAW.run(case, entry, None)
    bodies, (law,) = joints_of(case, entry)
    (bed,) = bodies.sliders(case, [law])
    assert bed.friction == pytest.approx(0.3)
    sentence = (
        "shear: measured by sliding at 40 MPa, friction 0.3, but stiffness ratio 1 assumed; slid"
    )
    assert sentence in law.attrs["branches"]
    assert "friction coefficient of 0.3 comes from the slide of one cell" in law.attrs["cautions"]
    assert np.isnan(shear_errors(law, np.array([2e7]))["friction"]["sampling"][0])
    with pytest.raises(CaseError, match=r"slide them over their length or more by \[slide\]"):
        case_of(tmp_path, text.replace('distance = "800 um"', 'distance = "100 um"'))


@pytest.mark.slow
def test_the_bolted_lap_joint_runs_from_its_surfaces_to_its_hysteresis(shipped_run):
    pytest.importorskip("gmsh", exc_type=Exception)
    out, output, _ = shipped_run("bolted_lap")
    law = open_law(out / "interface_law.nc")
    np.testing.assert_allclose(law["shear_stiffness_ratio"], THEORY, rtol=0.12)
    assert float(law["shear_friction"]) == pytest.approx(0.2, rel=0.02)
    result = open_dataset(out / "macro_result.nc")
    assert result["cycle_energy"].values[0] > 0.0
    force = 1e-3 * result["bolt_force"].values[:, 0]
    assert (
        f"Bolt 0 is tightened to {force[2]:.4g} kN, then carries {force[3:].min():.4g}"
        in result.facts
    )
    assert "assumed" not in output


@pytest.mark.slow
def test_the_first_cell_on_half_of_its_points_gives_the_error_of_the_grid(finished, tmp_path):
    """Of stiffness, tangential traction and loss, which are not known without it."""
    case, first, before = finished
    out = tmp_path / "out"
    copytree(first, out)
    again = case_of(tmp_path, CHAIN.replace("realisations = 3", "realisations = 3\ncoarser = 1"))
    assert "1 of 12 x 12 points" in requirements(again).built["coarser cells"]
    assert "1 of two bodies" in requirements(again).built["coarser sheared cells"]
    results = run(again, out)
    assert results["micro_response"].equals(before["micro_response"])
    coarse = results["coarser_shear_response"]
    assert coarse.sizes["realisation"] == 1
    np.testing.assert_allclose(coarse["rms_height"][0], before["shear_response"]["rms_height"][0])
    law = results.interface_law
    grid = law["error_half_width"].sel(error_term="micro discretisation")
    assert np.all(grid.values > 0.0)
    assert "spacing 2 times" in law.attrs["how_micro_discretisation"]
    assert "micro discretisation" not in law.attrs["unknown"]
    part = results.macro_result["error_half_width"].sel(error_term="micro discretisation")
    alone = part.sel(quantity="cycle_energy").values[-1]
    assert alone >= float(law["shear_loss_grid_error"]) > 0.0
    assert np.all(part.sel(quantity="tangential_stiffness").dropna("step") > 0.0)
    assert case.quick().micro.coarser == 0


def test_a_stated_friction_stands_without_sheared_cells_unless_strict(tmp_path):
    bare = (SHEAR + ROUGH, ROUGH.replace("[interface]", "[interface]\nfriction = 0.2"))
    assert load_case(write_scene(tmp_path, CHAIN, bare)).micro.shear is None
    with pytest.raises(CaseError, match="strict = true assumes nothing"):
        load_case(write_scene(tmp_path, CHAIN, bare, ("title", "strict = true\ntitle")))
