"""Cases of conducting bodies: answers with their bands, and refusals."""

import numpy as np
import pytest

from multiscale.laws.bulk.bulk_law import contact_modulus
from multiscale.pipeline import run
from tests.support import case_of, case_text

TEXT = case_text("conducting")


@pytest.mark.slow
def test_a_joint_of_bodies_that_conduct_reports_its_conductance(tmp_path):
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
    cells = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "micro").iterdir()}
    better = case_of(tmp_path, TEXT, ('"200 W/m/K"', '"400 W/m/K"'))
    again = run(better, tmp_path / "out")["macro_result"]
    np.testing.assert_allclose(
        again["thermal_conductance"] / h, (1 / 200 + 1 / 50) / (1 / 400 + 1 / 50)
    )
    assert {
        path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "micro").iterdir()
    } == cells
