"""The law of cells calibrated by measured joints: gradients, coverage, outliers, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.laws import Exponential, Sliders
from multiscale.upscaling import (
    assume_shear,
    by_differences,
    calibrate,
    fit_branches,
    law_from_dataset,
    predict_measured,
    read_measured,
)
from multiscale.upscaling.budget import interval_errors
from multiscale.upscaling.calibration import HEIGHTS
from multiscale.upscaling.measured_data import (
    BedCurve,
    Curve,
    MeasuredClosure,
    MeasuredLoop,
    MeasuredStiffness,
    MeasuredTangential,
)
from multiscale.upscaling.posterior import draw, find_mode
from tests.upscaling.responses import exponential_gaps, response_of

P = np.geomspace(6e6, 6e7, 8)  # Pa
U = 1e-6 * np.array([0.1, 0.3, 0.5, 0.3, 0.1, -0.1, -0.3, -0.5, -0.3, -0.1, 0.1, 0.3, 0.5])  # m
X = np.linspace(np.log(5e3), np.log(2e8), 300)
NUISANCES = {"frame": 1e-15, "offset": 3e5}
HALF = 1.96


def stiffness(p=P, nuisances=NUISANCES, kind=MeasuredStiffness):
    return kind("stiffness", p, np.ones(p.size), np.ones(p.size), nuisances, 1e-14)


def loop(p=2e7, u=U, nuisances=NUISANCES, bodies=1e-14):
    ones = np.ones(u.size)
    return MeasuredLoop("loop", p * ones, ones, ones, nuisances, bodies, displacement=u)


def closure():
    nuisances = {**NUISANCES, "zero": 1e-8}
    return MeasuredClosure("closure", P, np.ones(P.size), np.ones(P.size), nuisances, 1e-14)


TABLES = {
    "stiffness": stiffness(),
    "tangential": stiffness(kind=MeasuredTangential),
    "closure": closure(),
    "loop": loop(),
}


def interface(factor=1.0, ratio=0.8, friction=0.3, exponent=1.0):
    """An interface with K proportional to a power of the pressure, with rates of both."""
    x = X - np.log(2e7)
    rates = np.array([np.ones(X.size), x])
    log_stiffness = np.log(factor * 2e7 / 0.45e-6) + exponent * x
    return BedCurve(Curve(X, log_stiffness, rates), ratio, friction)


@pytest.fixture(scope="module")
def law():
    fitted = fit_branches(response_of(exponential_gaps(8, spread=0.1)), n_samples=80)
    return assume_shear(fitted, friction=0.3, stiffness_ratio=0.8)


def measure(table, truth, random, error=0.03, **nuisances):
    """Return a table with the values of a true interface, and noise."""
    value = table.answer(truth, nuisances)[0]
    shear = isinstance(table, MeasuredLoop)
    deviation = error * np.abs(value).max() * np.ones(value.size) if shear else error * value
    return replace(
        table, value=value + deviation * random.normal(size=value.size), deviation=deviation
    )


@pytest.mark.parametrize("name", TABLES)
def test_gradients_are_the_differences(name):
    table, at = TABLES[name], {"frame": 7e-16, "offset": 4e5, "zero": 2e-8}
    at = {nuisance: at[nuisance] for nuisance in table.nuisances}
    value, gradient = table.answer(interface(), at)
    by_steps = by_differences(lambda table, *given: table.answer(*given)[0], step=1e-4)
    same, differences = by_steps(table, interface(), at)
    np.testing.assert_array_equal(same, value)
    scale = np.abs(gradient).max(axis=0)
    assert np.all(np.abs(gradient - differences) <= 1e-6 * scale)


def test_the_closure_of_a_power_law_is_exact():
    table = replace(closure(), bodies=0.0)
    value = table.answer(interface(exponent=0.5), {})[0]
    scale = 2e7 / 0.45e-6 / np.sqrt(2e7)  # K over the root of the pressure
    np.testing.assert_allclose(value, 2.0 * (np.sqrt(P) - np.sqrt(P[0])) / scale, rtol=1e-6)


def test_loops_are_those_of_a_bed_of_sliders():
    """Along a path with an inner loop that closes, and back over its first turn."""
    u = 1e-6 * np.concatenate(
        [np.linspace(0.05, 0.6, 12), np.linspace(0.5, 0.1, 9), np.linspace(0.2, 0.9, 8)]
    )
    u = np.concatenate([u, np.linspace(0.8, -1.0, 37), np.linspace(-0.9, 1.2, 43)])
    shear = loop(u=u, bodies=0.0).answer(interface(), {})[0]
    bed = Sliders(Exponential(2e7, 0.45e-6), 0.3, 0.8, pressures=(1e5, 1e8), slabs=400)
    jump = np.zeros((3, 1))
    state, expected = bed.at_rest(jump), []
    for jump[1] in u:
        response = bed.respond(jump, state)
        state = response.state
        expected.append(response.traction[1, 0])
    assert np.abs(shear - expected).max() < 2e-3 * 0.3 * 2e7


def test_draws_have_the_moments_of_a_skewed_posterior():
    """Against quadrature: four values of exp(theta), with Student's errors."""
    values = np.array([1.4, 1.7, 2.0, 2.1])

    def residual(theta):
        predicted = np.exp(0.8 * theta[0])
        return (predicted - values) / 0.6, np.full((4, 1), 0.8 * predicted / 0.6)

    mode = find_mode(residual, 1)
    draws = draw(residual, mode, 4000, 2000, np.random.default_rng(1))
    t = np.linspace(-6, 6, 4001)
    r = (np.exp(0.8 * t)[:, None] - values) / 0.6
    density = np.exp(-0.5 * (t**2 + 5.0 * np.log1p(r**2 / 4.0).sum(axis=1)))
    mean = np.sum(t * density) / density.sum()
    deviation = np.sqrt(np.sum((t - mean) ** 2 * density) / density.sum())
    assert abs(mode.theta[0] - mean) > 0.1 * deviation  # skewed
    assert abs(draws.theta.mean() - mean) < 0.05 * deviation
    assert abs(draws.theta.std() / deviation - 1.0) < 0.05
    assert draws.tail < 0.5
    assert draws.effective > 1000


@pytest.mark.parametrize(
    "repeats", [pytest.param(16, id="few"), pytest.param(100, marks=pytest.mark.slow, id="many")]
)
def test_intervals_cover_the_true_joint(law, repeats):
    """True joints are drawn from the prior: stiffness, friction, and a held-out loop."""
    random, held = np.random.default_rng(3), loop(4e7, 2.0 * U, {})
    tables, inside = (stiffness(), loop()), []
    mean = law_from_dataset(law)
    for seed in range(repeats):
        z = random.normal(size=9)
        x = X - 0.2 / HALF * z[0]
        p = np.exp(np.clip(x, np.log(5e6), np.log(1e8)))
        log_stiffness = np.log(mean.stiffness(mean.gap_at(p))) + x - np.log(p)
        log_stiffness += (0.1 * z[1] + 0.05 * z[2] * (X - np.log(2.2e7))) / HALF
        ratio = 0.8 * np.exp(0.12 / HALF * z[3])
        friction = 0.3 * np.exp(0.5 / HALF * z[4])
        truth = BedCurve(Curve(X, log_stiffness, np.empty((0, X.size))), ratio, friction)
        offsets = [{"frame": 1e-15 * z[5 + 2 * k], "offset": 3e5 * z[6 + 2 * k]} for k in range(2)]
        data = [
            measure(table, truth, random, **given)
            for table, given in zip(tables, offsets, strict=True)
        ]
        calibrated = calibrate(law, data, seed=seed).law
        for table in (stiffness(np.array([2e7, 9e7]), {}), held):
            _, (low, high) = predict_measured(calibrated, table)
            value = table.answer(truth, {})[0]
            inside.append(np.mean((low <= value) & (value <= high)))
    assert 0.91 <= np.mean(inside) <= 0.99


def test_a_frame_is_found_and_an_outlier_has_little_weight(law):
    random, truth = np.random.default_rng(5), interface()
    data = measure(stiffness(), truth, random, frame=2e-15)
    wrong = data.value.copy()
    wrong[4] *= 1.5
    calibration = calibrate(law, [replace(data, value=wrong)])
    frame = next(row for row in calibration.parameters if row.name.startswith("frame"))
    assert abs(frame.value - 2e-15) < frame.half_width
    assert frame.learned > 0.5
    weights = [row.weight for row in calibration.rows]
    assert np.argmin(weights) == 4
    assert weights[4] < 0.1
    assert any("standard deviations from the law" in text for text in calibration.sentences)


def test_a_wrong_prior_is_named(law):
    """Heights are 1.5 times as large as in the cells, four standard deviations."""
    mean, factor = law_from_dataset(law), 1.5
    p = np.exp(np.clip(X - np.log(factor), np.log(5e6), np.log(1e8)))
    log_stiffness = np.log(mean.stiffness(mean.gap_at(p))) + X - np.log(factor) - np.log(p)
    truth = BedCurve(Curve(X, log_stiffness, np.empty((0, X.size))), 0.8, 0.3)
    data = [measure(table, truth, np.random.default_rng(7)) for table in (stiffness(), loop())]
    text = "\n".join(calibrate(law, data, discrepancy=0.02).sentences)
    assert f"disagree with the prior of the {HEIGHTS}" in text


def test_a_single_value_teaches_nothing_of_the_form(law):
    data = measure(stiffness(P[3:4]), interface(), np.random.default_rng(1))
    text = "\n".join(calibrate(law, [data]).sentences)
    assert "1 measured value taught nothing of the form of the law" in text
    assert "teach nothing of the stiffness ratio and the friction coefficient" in text


def test_the_calibrated_law_is_a_law_with_samples_and_a_budget(law):
    data = [
        measure(table, interface(), np.random.default_rng(2)) for table in (stiffness(), loop())
    ]
    calibrated = calibrate(law, data).law
    assert calibrated.sizes["sample"] == calibrated.sizes["shear_sample"] == law.sizes["sample"]
    value, (low, high) = predict_measured(calibrated, stiffness(np.array([2e7]), {}))
    half = interval_errors(calibrated)["mean_law"][2]
    at = np.interp(np.log(2e7), np.log(calibrated["fit_pressure"]), half)
    k = calibrated["shear_friction_sample"].to_numpy()
    assert 0.5 * (high - low)[0] / value[0] < 1.2 * at
    assert k.std() < 0.1 * 0.3
    again = calibrate(law, data, lambda table, *given: table.answer(*given)).law
    np.testing.assert_allclose(again["coefficient"], calibrated["coefficient"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: [], "there are no measured values"),
        (lambda t: [replace(t, pressure=10.0 * t.pressure)], "was not computed at the measured"),
        (
            lambda t: [t, replace(t, value=2.0 * t.value)],
            "of 16 measured values lie more than 3 standard deviations",
        ),
    ],
)
def test_contradictory_and_distant_data_are_refused(law, change, said):
    table = measure(stiffness(), interface(), np.random.default_rng(4))
    with pytest.raises(CaseError, match=said):
        calibrate(law, change(table))


def test_loops_need_friction(law):
    law = law.drop_vars([name for name in law.variables if str(name).startswith("shear")])
    with pytest.raises(CaseError, match="need friction and stiffness ratio"):
        calibrate(law, [loop()])


ROWS = "10, 20\n20, 30\n40, 50\n"


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        ("stiffness", "", "empty"),
        ("stiffness", "preload (MPa), stiffness (MPa/um)\n", "0 rows"),
        ("stiffness", "preload (MPa), stiffness (MPa/um), Stiffness (GPa/um)\n1, 2, 3\n", "same"),
        ("stiffness", "preload (MPa), stiffness (um)\n" + ROWS, "stiffness"),
        ("stiffness", "preload (MPa), gap (um)\n" + ROWS, "no column stiffness"),
        ("closure", "pressure (MPa), closure (um)\n40, 3\n10, 1\n", "does not rise"),
        ("closure", "pressure (MPa), closure (um)\n10, 3\n40, 1\n", "does not rise"),
        ("loop", "preload (MPa), displacement (um), shear (MPa)\n0, 1, 1\n0, 2, 2\n", "positive"),
        (
            "loop",
            "preload (MPa), displacement (um), shear (MPa)\n9, 4, 1\n9, 5, 2\n9, 4.5, -2\n",
            "slides away",
        ),
    ],
)
def test_tables_are_refused_with_a_sentence(kind, text, said, tmp_path):
    file = tmp_path / "table.csv"
    file.write_text(text)
    with pytest.raises(CaseError, match=said):
        read_measured(file, kind, error=0.03)


def test_a_table_needs_an_error_or_has_it_in_a_column(tmp_path):
    file = tmp_path / "table.csv"
    file.write_text("preload (MPa), stiffness (MPa/um)\n" + ROWS)
    with pytest.raises(CaseError, match="have no error; state error"):
        read_measured(file, "stiffness")
    plain = read_measured(file, "stiffness", error=0.1, offset=0.0)
    np.testing.assert_allclose(plain.deviation * HALF, 0.1 * plain.value, rtol=1e-4)
    np.testing.assert_allclose(HALF * plain.nuisances["frame"], 0.2 * 2e-14, rtol=1e-4)
    assert set(plain.nuisances) == {"frame"}
    for unit, factor in (("%", 0.01 * plain.value), ("MPa/um", 1e12)):
        file.write_text(
            f"preload (MPa), stiffness (MPa/um), error ({unit})\n10, 20, 5\n40, 50, 5\n"
        )
        seen = read_measured(file, "stiffness")
        np.testing.assert_allclose(
            HALF * seen.deviation, 5.0 * np.resize(factor, 3)[[0, -1]], rtol=1e-4
        )
