"""Cases whose bodies conduct: answers with their bands, and what is refused."""

import numpy as np

from multiscale.laws.bulk.moduli import contact_modulus
from multiscale.pipeline import run
from tests.support import case_of

TEXT = """
title = "Aluminium on steel"
elastic = true
[body_1]
youngs_modulus = "70 GPa"
poissons_ratio = 0.33
thermal_conductivity = "200 W/m/K"
[body_1.surface]
rms_height = "0.8 um"
hurst_exponent = 0.8
long_cutoff = "200 um"
short_cutoff = "100 um"
[body_2]
youngs_modulus = "210 GPa"
poissons_ratio = 0.3
thermal_conductivity = "50 W/m/K"
[cell]
size = ["400 um", "400 um"]
points = [16, 16]
geometry = "flat"
[micro]
realisations = 3
pressures = ["1 MPa", "3 MPa", "10 MPa", "30 MPa"]
[structure]
kind = "blocks"
height = "5 mm"
width = "10 mm"
[statics]
preloads = ["2 MPa", "10 MPa"]
"""


def test_a_joint_of_bodies_that_conduct_tells_its_conductance(tmp_path):
    result = run(case_of(tmp_path, TEXT), tmp_path / "out")["macro_result"]
    h = result["thermal_conductance"]
    modulus = contact_modulus((70e9, 0.33), (210e9, 0.3))
    expected = 2.0 * result["interface_stiffness"].values / (modulus * (1 / 200 + 1 / 50))
    np.testing.assert_allclose(h, expected)
    assert h.attrs["units"] == "W m-2 K-1"
    share = {
        name: np.ptp(result[f"{name}_mean_law"].values, axis=0) / result[name].values
        for name in ("thermal_conductance", "interface_stiffness")
    }
    np.testing.assert_allclose(share["thermal_conductance"], share["interface_stiffness"])
    cells = {one: one.stat().st_mtime_ns for one in (tmp_path / "out" / "micro").iterdir()}
    better = case_of(tmp_path, TEXT, ('"200 W/m/K"', '"400 W/m/K"'))
    again = run(better, tmp_path / "out")["macro_result"]
    np.testing.assert_allclose(
        again["thermal_conductance"] / h, (1 / 200 + 1 / 50) / (1 / 400 + 1 / 50)
    )
    assert {one: one.stat().st_mtime_ns for one in (tmp_path / "out" / "micro").iterdir()} == cells
