"""Rubber on a road: from its case to friction, footprint and braking force."""

import shutil

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import open_law, save_law
from multiscale.laws import wlf_shift
from multiscale.pipeline import load_case, run
from multiscale.pipeline.case import shipped_cases
from multiscale.pipeline.stages.braking import solve_treads
from multiscale.pipeline.stages.rubber_friction import make_roads, slide_road
from multiscale.report import draw_figures, write_report
from multiscale.upscaling import fit_law, friction_observations
from multiscale.upscaling.reading import frictions_at
from tests.support import case_of, slow

TEXT = shipped_cases()["tyre_on_road"].read_text(encoding="utf-8")
SMALL = (
    TEXT.replace("[128, 128]", "[32, 32]")
    .replace("realisations = 10", "realisations = 3")
    .replace('short_cutoff = "1 mm"', 'short_cutoff = "4 mm"')
    .replace('"200 kPa", ', "")
    .replace('"3 cm/s", ', "")
    .replace('"0.3 m/s", ', "")
    .replace('"3 m/s", ', "")
    .replace('pressure = "300 kPa"', 'pressure = "300 kPa"\nelements = [4, 3, 1]')
    + "\n[law]\nsamples = 3\n"
)


@pytest.fixture(scope="module")
def finished(text_run):
    return text_run("tread", SMALL)


def test_the_friction_of_the_cells_moves_along_the_speed_by_the_shift_factor(tmp_path):
    """With a ten times shorter relaxation, ten times the speed gives the same friction."""
    case = case_of(tmp_path, SMALL)
    # where a_T is 10 and 1/10
    factor = [20.0 - 101.6 / (1.0 + 8.86), 20.0, 20.0 + 101.6 / (8.86 - 1.0)]
    text = SMALL.replace(
        '"10 degC", "30 degC", "50 degC"', ", ".join(f'"{T:.15g} degC"' for T in factor)
    )
    start, end = text.index("speeds = "), text.index("temperatures = ")
    text = text[:start] + 'speeds = ["1 cm/s", "0.1 m/s", "1 m/s", "10 m/s"]\n' + text[end:]
    case = case_of(tmp_path, text)
    computed = slide_road(case, make_roads(case)[0]).values
    assert np.all(computed["converged"])
    mu = computed["traction"][0, :, 1].reshape(3, 3, 4)
    np.testing.assert_allclose(mu[0, :, :3], mu[1, :, 1:], rtol=1e-5)
    np.testing.assert_allclose(mu[1, :, :3], mu[2, :, 1:], rtol=1e-5)


def test_the_law_is_one_bell_that_the_temperature_shifts(finished):
    case, out, results = finished
    law = open_law(out / "interface_law.nc")
    cold, warm = (frictions_at(law, T, [None])[0] for T in case.sliding.temperatures[::2])
    shift = [wlf_shift(T, 293.15, 8.86, 101.6) for T in case.sliding.temperatures[::2]]
    assert warm.peak_speed / cold.peak_speed == pytest.approx(shift[0] / shift[1])
    p, v = np.array(2e5), np.geomspace(1e-3, 10.0, 5)
    np.testing.assert_allclose(
        warm.coefficient(p, v / shift[1]), cold.coefficient(p, v / shift[0]), rtol=1e-12
    )
    assert law.sizes["sample"] == 3
    assert law.attrs["rms_error_over_peak"] < 0.03  # of 32 x 32 points
    assert results.micro_response["converged"].values.all()


@pytest.mark.parametrize(
    "lost",
    [*slow("speed_exponent", "speed_exponent_sample", "held"), "wlf_c1", "rms_error_over_peak"],
)
def test_a_law_of_an_earlier_version_is_answered_in_a_sentence(finished, tmp_path, lost):
    _, out, _ = finished
    old = tmp_path / "old"
    shutil.copytree(out, old)
    law = open_law(old / "interface_law.nc").drop_vars(lost, errors="ignore")
    law.attrs.pop(lost, None)
    save_law(law, old / "interface_law.nc")
    sentence = (
        rf"old/interface_law.nc: a law of the family 'bell' needs {lost}, .*; run the fit again"
    )
    reader = write_report if lost == "rms_error_over_peak" else draw_figures
    with pytest.raises(CaseError, match=sentence):
        reader(old)


def test_a_law_of_another_family_is_refused_as_friction_of_rubber(finished):
    _, _, results = finished
    seen = friction_observations(results.micro_response.isel(step=range(4)))
    with pytest.raises(CaseError, match="a law of the family 'coulomb', expected a bell"):
        frictions_at(fit_law(seen, family="coulomb", n_samples=0), 300.0, [None])


def test_the_braking_force_is_the_integral_of_friction_times_pressure(finished):
    _, _, results = finished
    result, law = results.macro_result, results.interface_law
    assert result["converged"].values.all()
    area, load = result["point_area"].values, 300e3 * 0.03 * 0.02
    assert area.sum() == pytest.approx(0.03 * 0.02)
    for k in (0, result.sizes["step"] // 2, result.sizes["step"] - 1):
        step = result.isel(step=k)
        p = -step["traction"].values[:, 0]
        assert area @ p == pytest.approx(load, rel=1e-7)
        (friction,) = frictions_at(law, float(step["temperature"]), [None])
        mu = friction.coefficient(p, np.full(p.shape, float(step["sliding_speed"])))
        assert float(step["braking_force"]) == pytest.approx(area @ (mu * p), rel=1e-9)
        assert np.ptp(p) > 0.3 * p.mean()  # the pressure of the footprint is uneven


def test_a_second_run_keeps_the_roads_and_another_case_is_refused(finished, tmp_path):
    case, out, results = finished
    out = shutil.copytree(out, tmp_path / "again")
    before = {file: file.stat().st_mtime_ns for file in (out / "micro").iterdir()}
    again = run(case, out, progress=lambda *told: pytest.fail(f"computed {told}"))
    assert before == {file: file.stat().st_mtime_ns for file in (out / "micro").iterdir()}
    np.testing.assert_array_equal(
        again.macro_result["braking_force"], results.macro_result["braking_force"]
    )
    with pytest.raises(CaseError, match="holds another run"):
        run(case.quick(), out)


def test_a_tyre_case_written_by_a_run_is_the_same_case(tmp_path):
    for case in (load_case("tyre_on_road"), load_case("tyre_on_road").quick()):
        assert case_of(tmp_path, case.to_toml()) == case
    assert not [*load_case("tyre_on_road").cautions()]


@pytest.mark.slow
def test_the_law_of_the_shipped_tyre_is_close_to_its_roads(shipped_run):
    out, output, _ = shipped_run("tyre_on_road")
    assert "braking force" in " ".join(output.split())
    law = open_law(out / "interface_law.nc")
    assert law.attrs["rms_error_over_peak"] < 0.02
    assert law.attrs["largest_error_over_peak"] < 0.05
    assert "the fitted curve differs" not in output


def test_a_braking_force_has_an_error_budget(finished):
    result = finished[2].macro_result
    known = result["error_half_width"].squeeze("quantity").dropna("error_term")
    assert list(known["error_term"].values) == [
        "sampling",
        "fit",
        "increments",
        "surface",
        "macro discretisation",
    ]
    absent = ["increments", "surface"]
    np.testing.assert_array_equal(known.sel(error_term=absent), 0.0)
    assert np.all(known.drop_sel(error_term=absent) > 0.0)
    total = np.sqrt((known**2).sum("error_term"))
    np.testing.assert_allclose(result["error_total"].squeeze("quantity"), total)
    assert (
        result.attrs["unknown"] == "cell size, micro discretisation, small slopes, scale separation"
    )


@pytest.mark.slow
def test_a_tread_far_beyond_the_pressures_of_its_roads_has_no_force(finished):
    case, _, results = finished
    assert results.macro_result["known"].values.all()
    text = results.macro_result.attrs["facts"]
    assert text == "A cell of 16 mm is 0.8 of the edge of the interface, 20 mm."
    heavy = case.model_copy(update={"tread": case.tread.model_copy(update={"pressure": 3e6})})
    law = heavy.law.model_copy(update={"extrapolate": True})
    given = results.micro_response, results.interface_law
    result = solve_treads(heavy, *given)
    assert not result["known"].values.any()
    assert np.isnan(result["braking_force"]).all()
    assert "the pressures of the law, 100 kPa to 800 kPa" in result.attrs["cautions"]
    stored = solve_treads(heavy.model_copy(update={"law": law}), *given)
    assert np.isfinite(stored["braking_force"][stored["converged"].values == 1]).all()
    assert np.isnan(stored["error_total"]).all()


def _at_a_temperature(case):
    """The tread on the warmest road only."""
    sliding = case.sliding.model_copy(update={"temperatures": case.sliding.temperatures[-1:]})
    return case.model_copy(update={"sliding": sliding})


@pytest.mark.slow
def test_a_tread_that_its_friction_tips_is_reported_at_each_speed_and_temperature(finished):
    case, _, results = finished
    case, law = _at_a_temperature(case), results.interface_law
    names = ("peak_coefficient", "peak_coefficient_sample")
    rough = law.assign({name: 100.0 * law[name] for name in names})
    result = solve_treads(case, results.micro_response, rough)
    failed = np.sum(result["converged"].values == 0)
    assert failed > 0
    lines = [
        line for line in result.attrs["cautions"].splitlines() if "no braking force at" in line
    ]
    assert len(lines) == failed
    assert all("would shear the block by" in line for line in lines)


@pytest.mark.slow
def test_smaller_elements_change_the_force_by_less_than_their_term(finished):
    case, _, results = finished
    case, tread = _at_a_temperature(case), case.tread
    finer = case.model_copy(update={"tread": tread.model_copy(update={"elements": (8, 6, 2)})})
    change = solve_treads(finer, results.micro_response, results.interface_law)["braking_force"]
    at = results.macro_result["temperature"] == case.sliding.temperatures[0]
    known = results.macro_result.isel(step=np.flatnonzero(at))
    change = change / known["braking_force"] - 1.0
    term = known["error_half_width"].sel(error_term="macro discretisation")
    assert np.all(np.abs(change) <= term.squeeze("quantity"))
