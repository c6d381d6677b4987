"""Cases with measured joints: the law of the cells is calibrated, and structures take it."""

import numpy as np
import pytest

from multiscale.cli import app
from multiscale.errors import CaseError
from multiscale.io import open_law, open_response
from multiscale.pipeline import load_case, run
from multiscale.pipeline.calibrated_law import SOLVES, calibrate_case, prepare_calibration
from multiscale.pipeline.case import shipped_cases
from multiscale.pipeline.case_needs import prepare, requirements
from multiscale.pipeline.stage import Job
from multiscale.pipeline.stages.vibrating_bodies import VIBRATING_BODIES
from multiscale.upscaling import assume_shear, fit_branches, tangential_values
from tests.pipeline.test_conducting_cases import TEXT
from tests.support import case_of, case_text

BODY = 'youngs_modulus = "210 GPa"\npoissons_ratio = 0.3\n'
MEASURED = """
[law]
samples = 50
friction = 0.3
stiffness_ratio = 0.8
[[measured]]
file = "stiffness.csv"
kind = "stiffness"
error = "5 %"
frame = "0 um/MPa"
area = "1 mm^2"
"""
LOOPS = """
[[measured]]
file = "loop.csv"
kind = "loop"
error = "5 %"
"""
VIBRATION = """
[[measured]]
file = "vibration.csv"
kind = "vibration"
mass = "40000 kg/m^2"
error = "5 %"
"""
STIFFNESS = "preload (MPa), stiffness (MPa/um)\n2, 1.2\n5, 2.9\n10, 5.7\n"
LOOP = "preload (MPa), displacement (um), shear (MPa)\n" + "".join(
    f"5, {u}, {t}\n" for u, t in ((0.1, 0.2), (0.3, 0.6), (0.1, 0.15), (-0.1, -0.25), (-0.3, -0.6))
)


def measured_case(folder, *changes):
    (folder / "stiffness.csv").write_text(STIFFNESS)
    (folder / "loop.csv").write_text(LOOP)
    head = "preload (MPa), amplitude (um), frequency (Hz), damping (%)"
    (folder / "vibration.csv").write_text(f"{head}\n5, 0.1, 1190, 2.6\n5, 0.6, 1010, 13\n")
    return case_of(folder, TEXT + MEASURED + LOOPS, *changes)


@pytest.mark.slow
def test_a_run_calibrates_its_law_and_fit_does_alike(tmp_path, capsys):
    results = run(measured_case(tmp_path), tmp_path / "out")
    law, joint = results["interface_law"], results["macro_result"]
    assert law.attrs["uncertainty"] == "posterior of measured joints"
    bodies = 1.0 / joint["solid_stiffness"].values
    np.testing.assert_allclose(
        joint["joint_stiffness"], 1.0 / (1.0 / joint["interface_stiffness"].values + bodies)
    )
    np.testing.assert_allclose(joint["interface_stiffness"], [1.2e12, 5.7e12], rtol=0.15)
    low, high = joint["interface_stiffness_mean_law"].values
    assert np.all((high - low) / joint["interface_stiffness"].values < 0.25)
    assert np.isfinite(joint["tangential_stiffness_one_part"]).all()
    response, out = tmp_path / "out" / "micro_response.nc", tmp_path / "law.nc"
    case = str(next(tmp_path.glob("*.toml")))
    app(["fit", str(response), "--measured", case, "-o", str(out)], standalone_mode=False)
    printed = capsys.readouterr().out
    assert "Parameters of the law before and after calibration" in printed
    assert "stiffness.csv  row 2     5 MPa  2.9 MPa/µm" in printed
    again = open_law(out)
    np.testing.assert_allclose(again["fit_mean_gap"], law["fit_mean_gap"])
    assert again.sizes["sample"] == law.sizes["sample"] == 50
    # without loops assumed values stay assumed, and values of sheared cells are not stated twice
    assert "assumed" not in law.attrs["cautions"]
    cells, plain = fit_branches(open_response(response)), measured_case(tmp_path, (LOOPS, ""))
    job = Job(tmp_path)
    assert "assumed" in calibrate_case(plain, cells, job).law.attrs["cautions"]
    sheared = assume_shear(cells, friction=0.2, stiffness_ratio=0.8)
    with pytest.raises(CaseError, match="and the sheared cells have measured"):
        calibrate_case(plain, sheared, job)


@pytest.mark.slow
@pytest.mark.parametrize("table", [LOOPS, VIBRATION], ids=["loops", "vibrations"])
def test_joints_of_bodies_take_friction_and_ratio_of_the_calibrated_law(table, tmp_path):
    blocks = 'kind = "blocks"\nheight = "5 mm"\nwidth = "10 mm"'
    stacked = 'kind = "stacked_blocks"\nsize = ["10 mm", "10 mm", "5 mm"]\nelements = [2, 2, 2]'
    case = measured_case(tmp_path, (blocks, f"{stacked}\n{BODY}[interface]"), (LOOPS, table))
    results = run(case, tmp_path / "out")
    known = tangential_values(results["interface_law"])
    assert known["friction"] == pytest.approx(0.3, rel=0.5)
    assert "assumed" not in results["macro_result"].attrs["cautions"]
    result = results["macro_result"]
    np.testing.assert_allclose(result["interface_stiffness"], [1.2e12, 5.7e12], rtol=0.15)
    assert np.isfinite(result["tangential_stiffness_one_part"]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('frame = "0 um/MPa"', 'frame = "1 um"'), "frame '1 um' cannot be converted to m/Pa"),
        (('error = "5 %"\nframe', "frame"), "have no error; state error"),
        (("friction = 0.3\n", ""), "need friction and stiffness ratio"),
        (('"loop"', '"bolt"'), "kind"),
        (('"loop"', '"vibration"'), "either mass or case belongs to kind = .vibration. and is"),
        (
            ('kind = "loop"', 'kind = "vibration"\ncase = "beam.toml"\nframe = "0 um/MPa"'),
            "frame does not apply to the structure",
        ),
        (
            (
                '"loop.csv"\nkind = "loop"',
                f'"vibration.csv"\nkind = "vibration"\ncase = "{shipped_cases()["ground_steel"]}"',
            ),
            "a structure with measured vibrations needs bodies with interfaces",
        ),
        (
            (MEASURED + LOOPS, '\n[law]\nroughness = "10 %"\n'),
            "roughness in .law. need measured joints",
        ),
    ],
)
def test_measured_tables_are_refused_with_a_sentence(tmp_path, change, message):
    with pytest.raises(CaseError, match=message):
        prepare(measured_case(tmp_path, change))  # before any cell


MODES = ('"loop.csv"\nkind = "loop"', '"modes.csv"\nkind = "vibration"\ncase = "lap.toml"')
FLOATING = '\n[vibration]\nmodes = [1]\namplitudes = ["0.1 um"]\n'


def test_a_case_with_measured_modes_is_read_again_as_it_was_written(tmp_path):
    case = measured_case(tmp_path, MODES)
    (tmp_path / "again.toml").write_text(case.to_toml())
    assert load_case(tmp_path / "again.toml") == case


def test_modes_of_a_lap_joint_are_measured(tmp_path):
    """Of a structure that its stage makes of bodies; its solves are counted."""
    lap = case_text("lap_of_law").replace("= 0.3", '= 0.3\ndensity = "7850 kg/m^3"', 1) + FLOATING
    (tmp_path / "lap.toml").write_text(lap)
    (tmp_path / "modes.csv").write_text("amplitude (um), frequency (Hz), damping\n0.1, 900, 0.01\n")
    case = measured_case(tmp_path, MODES)
    prepare_calibration(case)
    solved = f"about {SOLVES} solves of lap"
    needs = requirements(case)
    assert needs.built["measured modes"] == solved
    of_one = VIBRATING_BODIES.needs(load_case(tmp_path / "lap.toml")).seconds
    cost = next(cost for cost in needs.costs if cost.stage == "interface_law")
    assert cost.seconds > SOLVES * of_one
