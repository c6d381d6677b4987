"""Cases of leaking interfaces: leak rate of a ring, figures, and refusals."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.pipeline import load_case, load_sweep, run, run_sweep
from multiscale.pipeline.sweep_points import POINTS
from multiscale.report import open_finished
from tests.support import case_of, case_text

TEXT = case_text("seal")


@pytest.mark.slow
def test_a_ring_leaks_through_the_aperture_of_its_interface(tmp_path):
    out = tmp_path / "out"
    result = run(case_of(tmp_path, TEXT), out)
    seal, law = result["seal"], result["interface_law"].sel(direction="both")
    channel = law["hydraulic_aperture"] ** 3 / 12e-3 * 1e4 / 2e-3 * np.pi * 0.05
    np.testing.assert_allclose(seal["leak_rate"], channel)
    assert float(seal["leak_rate"][0]) > 0.0
    low, high = seal["leak_rate_mean_law"].to_numpy()
    assert np.all((low <= seal["leak_rate"]) & (seal["leak_rate"] <= high))
    assert np.all(seal["hydraulic_aperture"] < seal["mean_gap"])
    assert (
        "2 of the longest wavelengths along its edge" in result["interface_law"].attrs["cautions"]
    )
    assert "mean pressure of the liquid on the faces" in seal.attrs["cautions"]
    finished = open_finished(out)
    drawn = {name for section in finished.sections() for name in section.figures}
    assert {"leakage", "flow_along_x", "flow_along_y"} <= drawn
    cells = {path: path.stat().st_mtime_ns for path in (out / "micro").iterdir()}
    thicker = run(case_of(tmp_path, TEXT, ('"1 mPa*s"', '"4 mPa*s"')), out)["seal"]
    np.testing.assert_allclose(4.0 * thicker["leak_rate"], seal["leak_rate"])
    assert {path: path.stat().st_mtime_ns for path in (out / "micro").iterdir()} == cells


@pytest.mark.slow
def test_a_lay_asks_for_the_axis_across_the_ring(tmp_path):
    lay = ('short_cutoff = "50 um"', 'short_cutoff = "50 um"\nanisotropy = { ratio = 4 }')
    result = run(case_of(tmp_path, TEXT, lay), tmp_path / "out")
    x, y = (result["interface_law"]["hydraulic_aperture"].sel(direction=k)[1] for k in "xy")
    assert x > 1.2 * y
    assert "hydraulic apertures along x and y differ" in result["seal"].attrs["cautions"]
    across = ("[seal]", '[seal]\ndirection = "y"')
    text = run(case_of(tmp_path, TEXT, lay, across), tmp_path / "out")["seal"]
    np.testing.assert_array_equal(text["hydraulic_aperture"][1], y)
    assert "another aperture" not in text.attrs["cautions"]


def test_a_sweep_writes_the_leak_of_a_tight_ring_without_a_relative_error(tmp_path):
    (tmp_path / "case.toml").write_text(f'{TEXT}[sweep]\nseal.width = ["2 mm"]\n')
    joined = run_sweep(load_sweep(tmp_path / "case.toml"), tmp_path / "out")
    *_, steps = POINTS.sections({POINTS.name: joined}, tmp_path / "out")
    leaks = [row[steps.head.index("leak rate (ml/h)")] for row in steps.rows]
    assert leaks[-1] == "0 (0 ... 0)"
    assert leaks[0].endswith(" %")


def test_a_ring_without_cells_is_refused(tmp_path):
    text = TEXT[: TEXT.index("[cell]")] + TEXT[TEXT.index("[seal]") :]
    (tmp_path / "case.toml").write_text(text)
    with pytest.raises(CaseError, match="there are no cells"):
        load_case(tmp_path / "case.toml")
