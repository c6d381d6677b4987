"""Every guide runs, and its results are right."""

import runpy
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "workflows" / "guides"
SLOW = ("05_large_strain",)


def run(names):
    assert np.all(np.diff(names["stiffness"].values) > 0.0)  # grows with the preload


def answer_and_error(names):
    joint = names["joint"]
    series = 1.0 / joint["interface_stiffness"] + 1.0 / joint["solid_stiffness"]
    np.testing.assert_allclose(joint["joint_stiffness"] * series, 1.0, rtol=1e-9)
    assert (joint["error_total"] >= joint["error_half_width"].max("error_term")).all()


def results_in_xarray(names):
    pressure = names["light"]["nominal_pressure"].values
    assert pressure.min() >= 2e6
    assert pressure.max() <= 20e6
    assert {"law.csv", "gap.csv", "rough_joint.inp"} <= {path.name for path in Path().iterdir()}


def laws(names):
    assert names["budget"].attrs["unknown"] == "cell size, small slopes, scale separation"
    assert "*SURFACE BEHAVIOR" in Path("rough_joint.inp").read_text()


def large_strain(names):
    assert names["pressed"]["converged"].values.all()
    assert names["slid"]["converged"].values.all()
    assert float(names["pressed"]["flowing_fraction"].max()) > 0.0


def contact(names):
    pressure = names["step"].contact["floor"].pressure
    assert np.all(pressure >= 0.0)
    np.testing.assert_allclose(names["solution"].value, [2.0, -1.0])  # stops 2 kg, slips at mu


def trusses(names):
    slack = (names["rest"]["slack"] > 0.0).sum("link").values
    assert slack[0] == 0 < slack[1] < slack[2]
    total = sum(names["motion"][f"{kind}_energy"].values for kind in ("kinetic", "elastic"))
    assert np.all(np.diff(total) <= 1e-9 * total[0])  # the step damps, and adds no energy


def joints(names):
    joint = names["joint"]
    assert joint["converged"].values.all()
    assert np.all(np.diff(joint["joint_stiffness"].values[:3]) > 0.0)  # grows with the preload
    assert np.all(joint["cycle_energy"].values > 0.0)
    np.testing.assert_allclose(
        joint["open_fraction"] + joint["stick_fraction"] + joint["slip_fraction"], 1.0
    )


def grains(names):
    assert names["motion"]["converged"].values.all()
    push = np.sum(names["force"] * names["branch"], axis=1)
    assert np.all(push >= 0.0)  # no contact pulls


def damage(names):
    sections = names["sections"]
    assert float(sections["mean_damage"]) < 0.15 < float(sections["maximum_damage"])
    assert np.linalg.eigvalsh(names["stiffness"]).min() > 0.0
    assert np.isfinite(float(names["life"]["cycles_to_rupture"]))


def three_ways(names):
    np.testing.assert_allclose(names["gaps"], np.mean(names["gaps"]), rtol=0.05)


def sliding_tyres(names):
    cold, warm = names["friction"].values()
    assert np.all(np.diff(cold) < 0.0)
    assert np.all(np.diff(warm) > 0.0)


def discrete_to_continuum(names):
    response = names["response"]
    assert response["converged"].values.all()
    normal, shear = response["traction"].values.reshape(-1, response["traction"].shape[-1])[0][:2]
    assert normal < 0.0  # pressure
    assert abs(shear) < -normal


CHECKS = {
    f"{number:02d}_{check.__name__}": check
    for number, check in enumerate(
        (
            run,
            answer_and_error,
            results_in_xarray,
            laws,
            large_strain,
            contact,
            trusses,
            joints,
            grains,
            damage,
            three_ways,
            sliding_tyres,
            discrete_to_continuum,
        ),
        start=1,
    )
}
"""Conditions on the names that a guide leaves."""


@pytest.mark.parametrize(
    "guide",
    [
        pytest.param(path, marks=[pytest.mark.slow] if path.stem in SLOW else [], id=path.stem)
        for path in sorted(FOLDER.glob("*.py"))
    ],
)
def test_a_guide_runs(guide, run_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    copytree(run_folder, "results")
    CHECKS[guide.stem](runpy.run_path(str(guide)))
