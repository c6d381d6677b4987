"""Scenes of grains: reports, files and refusals."""

import numpy as np
import pytest
from typer.testing import CliRunner

from multiscale.cli import app
from multiscale.errors import CaseError
from multiscale.io import open_dataset
from multiscale.pipeline import load_case, run_macro
from multiscale.pipeline.stages.grains import GRAINS
from multiscale.pipeline.tables.meshed_bodies import doubt_density
from multiscale.schema import GRANULATE
from tests.support import SCENES, write_scene

DEPOSIT = (SCENES / "deposit.toml").read_text(encoding="utf-8")


def test_the_series_holds_grains_and_forces(tmp_path):
    import meshio

    result = run_macro(load_case(SCENES / "deposit.toml").quick(), tmp_path / "result.nc")
    last = meshio.read(tmp_path / "fields" / f"result-{result.sizes['frame'] - 1:04d}.vtu")
    assert len(last.cells_dict["vertex"]) == 60
    here = result["contact_frame"].values == result.sizes["frame"] - 1
    force = last.cell_data_dict["force"]["line"]
    np.testing.assert_allclose(
        force, np.linalg.norm(result["contact_force"].values[here], axis=1), rtol=1e-12
    )


def test_the_number_of_frames_is_taken_from_the_file(tmp_path):
    path = write_scene(tmp_path, DEPOSIT, ('duration = "1 s"', 'duration = "20 ms"\nframes = 3'))
    scene = load_case(path).quick()
    result = run_macro(scene, tmp_path / "result.nc")
    assert result.sizes["frame"] == 3


def test_a_density_that_no_solid_has_is_a_caution(tmp_path):
    short = ('duration = "1 s"', 'duration = "4 ms"\nframes = 2')
    heavy = ('"2600 kg/m^3"', '"2600 g/cm^3"')
    scene = load_case(write_scene(tmp_path, DEPOSIT, short, heavy)).quick()
    result = run_macro(scene, tmp_path / "result.nc")
    assert "has a density of 2.6e+06 kg/m^3, and solids have 10 to 23000" in result.cautions
    assert not doubt_density("steel", 7850.0)
    assert not doubt_density("a body at rest", None)
    assert "steel has a density of 7.85 kg/m^3" in doubt_density("steel", 7.85)[0]


def test_steps_follow_the_accuracy_of_the_file(tmp_path):
    path = write_scene(tmp_path, DEPOSIT, ('step = "2 ms"', 'step = "5 ms"\naccuracy = 0.1'))
    result = run_macro(load_case(path).quick(), tmp_path / "result.nc")
    lengths = result["time_step"].values
    assert lengths.max() <= 5e-3 * (1.0 + 1e-12)
    assert lengths.min() < 0.9 * lengths.max()
    assert lengths.sum() == pytest.approx(40 * 5e-3)


@pytest.mark.slow
def test_a_biaxial_test_leaves_its_curve_in_dataset_table_and_figure(tmp_path):
    scene = load_case(SCENES / "biaxial.toml")
    assert scene.structure.strain_rate == 0.03
    out = tmp_path / "result.nc"
    done = CliRunner().invoke(
        app, ["macro", str(SCENES / "biaxial.toml"), "--quick", "-o", str(out)]
    )
    assert done.exit_code == 0, done.output
    assert "q/p" in done.output
    result = open_dataset(out, GRANULATE)
    assert result["stress"].attrs["units"] == "Pa"
    time = result["time"].values
    np.testing.assert_allclose(-result["strain"][:, 2], 0.03 * time, rtol=1e-3)
    names = [file.stem for file in GRAINS.draw(result, tmp_path / "figures")]
    assert "biaxial_curve" in names

    free = result.assign(stress=0.0 * result["stress"])
    assert "so the stress ratio q/p is unknown" in " ".join(GRAINS.summary(free).answer)
    loosened = result.assign(stress=result["stress"].where(result["step"] < 2, 0.0))
    text = " ".join(GRAINS.summary(loosened).answer)
    assert "in the last step with stress" in text
    assert "nan" not in text


def test_steps_in_which_pressed_grains_would_pass_each_other_are_refused(tmp_path):
    text = (SCENES / "biaxial.toml").read_text(encoding="utf-8")
    few = ("number = 200", "number = 20")
    scene = load_case(write_scene(tmp_path, text, few, ('"1 kPa"', '"10 MPa"')))
    with pytest.raises(CaseError, match=r"step 0.007 s is too long .* take about"):
        run_macro(scene, tmp_path / "result.nc")


def test_grains_refuse_an_interface_law(tmp_path):
    scene = load_case(SCENES / "deposit.toml").quick()
    with pytest.raises(CaseError, match="has no joint for the law"):
        run_macro(scene, tmp_path / "result.nc", law=tmp_path / "law.nc")


def test_the_floor_bears_the_weight_of_grains_that_touch_no_wall(tmp_path):
    """Twenty spheres in one layer, far from the walls, at rest."""
    path = write_scene(tmp_path, DEPOSIT, ("number = 1000", "number = 20"))
    result = run_macro(load_case(path).quick(), tmp_path / "result.nc")
    np.testing.assert_allclose(result["floor_share"][-5:], 1.0, atol=1e-3)
    np.testing.assert_array_equal(result["side_share"][-5:], 0.0)
    text = GRAINS.summary(result)
    assert text.answer[0].endswith("of the grains (0 to 0 %), the floor 100 %.")
    assert text.question.startswith(
        "Which walls carry the weight of the grains, and how many sweeps"
    )


def test_the_run_out_counts_from_the_gate_to_the_farthest_edge(tmp_path):
    result = run_macro(load_case(SCENES / "column_collapse.toml").quick(), tmp_path / "result.nc")
    edge = (result["position"][..., 0] + result["radius"]).max("grain") - 0.2
    np.testing.assert_allclose(result["run_out"], edge)
    answer = GRAINS.summary(result).answer
    assert answer[0] == "After 0.04 s no grain has passed the gate."
    assert "they spread farther; use a longer duration" in answer[1]
    ran = result.assign(run_out=result["run_out"] + 0.1)
    sentence = f"the farthest grain is {1e3 * float(ran['run_out'][-1]):.4g} mm beyond the gate"
    assert sentence in GRAINS.summary(ran).answer[0]


def test_the_pressure_on_the_plate_is_the_pressure_of_the_scene(tmp_path):
    result = run_macro(load_case(SCENES / "shear_cell.toml").quick(), tmp_path / "result.nc")
    assert float(result["plate_pressure"].mean()) == pytest.approx(10e3, rel=0.05)
    force = result["wall_force"].isel(wall=1)
    np.testing.assert_allclose(result["plate_shear"], -force[:, 0] / 0.01)
    np.testing.assert_allclose(result["plate_slip"], 0.1 * result["time"])
    answer = GRAINS.summary(result).answer
    assert "the stress of steady sliding is unknown below 3" in answer[1]
    apart = result.assign({name: 0.0 * result[name] for name in ("plate_shear", "plate_pressure")})
    assert "so the friction coefficient is unknown" in GRAINS.summary(apart).answer[0]
