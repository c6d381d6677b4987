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
from multiscale.upscaling.branches import branch_origins
from multiscale.upscaling.budget import (
    ERROR_TERMS,
    Term,
    assemble_budget,
    interval_errors,
    with_budget,
)
from multiscale.upscaling.law_budget import LAW_QUANTITIES
from multiscale.upscaling.measured.joints import (
    BedCurve,
    Curve,
    MeasuredClosure,
    MeasuredLoop,
    MeasuredStiffness,
    MeasuredTangential,
    split_loops,
)
from multiscale.upscaling.posterior import Draws, draw, find_mode, smooth_weights
from multiscale.upscaling.posterior_law import law_of_interfaces
from multiscale.upscaling.prior import HEIGHTS, _covariance_of_cells
from multiscale.upscaling.reading import fitted_laws
from multiscale.upscaling.sampling import half_range
from tests.support import press_flat, rough_square
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


def test_loops_equal_a_bed_of_sliders():
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
    density = np.exp(-0.5 * (t**2 + 4.0 * np.log1p(r**2 / 4.0).sum(axis=1)))
    mean = np.sum(t * density) / density.sum()
    deviation = np.sqrt(np.sum((t - mean) ** 2 * density) / density.sum())
    assert abs(mode.theta[0] - mean) > 0.1 * deviation  # skewed
    assert abs(draws.theta.mean() - mean) < 0.05 * deviation
    assert abs(draws.theta.std() / deviation - 1.0) < 0.05
    assert draws.tail < 0.5
    assert 1000 < draws.effective <= 2000


def test_exact_data_have_the_stated_weight_in_mode_and_draws():
    """Twenty equal data of a parameter: the posterior has a deviation of 1 / sqrt(21)."""

    def residual(theta):
        return np.full(20, theta[0]), np.ones((20, 1))

    mode = find_mode(residual, 1)
    assert mode.solves == 1
    draws = draw(residual, mode, 4000, 2000, np.random.default_rng(1))
    assert mode.weight.max() <= 1.0
    assert draws.theta.std() > 0.98 / np.sqrt(21.0)


def test_a_mode_at_a_kink_settles_with_a_caution():
    """The slopes of a residual of -2, half of it by Student, balance the prior within 5 %."""

    def residual(theta):
        slope = np.where(theta < 1.0, 1.05, 0.95)
        return slope * (theta - 1.0) - 2.0, slope[:, None]

    mode = find_mode(residual, 1)
    assert mode.theta[0] == pytest.approx(1.0, abs=1e-3)
    assert mode.settled
    assert "converged to 0.04 of their posterior standard deviations" in mode.cautions[0]
    assert not find_mode(lambda theta: (theta - 3.0, np.eye(1)), 1).cautions


def test_steps_end_at_the_noise_of_the_answers():
    """Forty answers in stairs of a twentieth of their deviations."""

    def residual(theta):
        stairs = 0.05 * np.floor(20.0 * theta[0] + np.linspace(0.0, 1.0, 40) ** 3)
        return stairs - 1.0, np.ones((40, 1))

    mode = find_mode(residual, 1, noisy=True)
    assert mode.settled
    assert mode.solves < 8 < find_mode(residual, 1).solves


def test_failed_steps_far_from_the_mode_do_not_end_it():
    """The mode lies along a narrow curved valley, of Rosenbrock, which undamped steps leave."""

    def residual(theta):
        x, y = theta
        return np.array([10.0 * (y - x**2), x - 2.0]), np.array([[-20.0 * x, 10.0], [1.0, 0.0]])

    mode, noisy = find_mode(residual, 2), find_mode(residual, 2, noisy=True)
    assert noisy.settled
    np.testing.assert_allclose(noisy.theta, mode.theta, rtol=1e-3)
    assert mode.theta[0] > 0.5


def test_a_wrong_gradient_does_not_settle():
    def residual(theta):
        return theta - 3.0, -np.eye(1)

    assert not find_mode(residual, 1).settled


def test_weights_of_a_few_draws_are_not_reliable():
    assert smooth_weights(np.append(np.zeros(3), np.full(97, -np.inf)))[1] == np.inf


@pytest.mark.parametrize(
    ("effective", "tail", "cautions"), [(80.0, 0.8, False), (30.0, 0.8, True), (80.0, 1.1, True)]
)
def test_uneven_weights_are_a_caution_if_they_give_too_few_draws(
    law, monkeypatch, effective, tail, cautions
):
    def uneven(residual, mode, candidates, count, random):
        return Draws(random.normal(size=(count, mode.theta.size)), effective, tail)

    monkeypatch.setattr("multiscale.upscaling.calibration.draw", uneven)
    data = measure(stiffness(), interface(), np.random.default_rng(1))
    sentences = calibrate(law, [data]).sentences
    assert any("weights of the draws are uneven" in text for text in sentences) == cautions


@pytest.mark.slow
def test_intervals_cover_the_true_joint(law):
    """True joints are drawn from the prior: stiffness, friction, and a loop for validation."""
    random, fixed = np.random.default_rng(3), loop(4e7, 2.0 * U, {})
    tables, inside = (stiffness(), loop()), []
    cells = fitted_laws(law, range(law.sizes["sample"]))
    for seed in range(40):
        z, mean = random.normal(size=9), cells[random.integers(len(cells))]
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
        for table in (stiffness(np.array([2e7, 9e7]), {}), fixed):
            _, (low, high) = predict_measured(calibrated, table)
            value = table.answer(truth, {})[0]
            inside.append(np.mean((low <= value) & (value <= high)))
        for name, value in (("stiffness_ratio", ratio), ("friction", friction)):
            drawn = calibrated[f"shear_{name}_sample"].to_numpy().reshape(law.sizes["sample"], -1)
            low, high = np.percentile(drawn.mean(axis=1), [2.5, 97.5])
            inside.append(low <= value <= high)
    assert 0.91 <= np.mean(inside) <= 0.98  # of 40 in four answers: .95 +- .017


def test_a_frame_is_identified_and_an_outlier_has_little_weight(law):
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
    assert f"the measured values move the {HEIGHTS} " in text


def test_a_single_value_gives_no_information_on_the_form(law):
    data = measure(stiffness(P[3:4]), interface(), np.random.default_rng(1))
    text = "\n".join(calibrate(law, [data]).sentences)
    assert "1 measured value gives no information on the form of the law" in text
    assert "no information on the stiffness ratio and the friction coefficient" in text


def test_values_without_shear_leave_the_shear_branch(law):
    data = measure(stiffness(), interface(), np.random.default_rng(1))
    after = calibrate(law, [data]).law
    assert branch_origins(after)["shear"] == branch_origins(law)["shear"]
    assert after["shear_friction"].identical(law["shear_friction"])
    assert "shear_friction_sample" not in after


def test_the_ratios_along_x_and_y_keep_their_quotient(law):
    lay = law.assign(shear_stiffness_ratio=law["shear_stiffness_ratio"] * [0.9, 1.1])
    after = calibrate(lay, [measure(loop(), interface(), np.random.default_rng(1))]).law
    x, y = after["shear_stiffness_ratio_sample"].values.T
    np.testing.assert_allclose(y / x, 1.1 / 0.9)


def test_modes_have_the_variance_of_the_discrepancy():
    """Level and exponent of 10 % and 5 %, over the data, in a law without samples."""
    plain = fit_branches(response_of(exponential_gaps(8, spread=0.1)), n_samples=0)
    data = measure(stiffness(), interface(), np.random.default_rng(1))
    rows = calibrate(plain, [data]).parameters
    form = [row.prior_half_width for row in rows if row.name.startswith("form")]
    x = np.linspace(np.log(plain.attrs["pressure_min"]), np.log(plain.attrs["pressure_max"]), 48)
    assert np.sum(np.square(form)) == pytest.approx(0.1**2 + 0.05**2 * x.var(), rel=0.02)


def test_the_gap_keeps_the_terms_of_cells(law):
    p = law["fit_pressure"].to_numpy()
    terms = {term: Term("of cells", np.full((3, p.size), 0.02)) for term in ERROR_TERMS}
    cells = with_budget(law, assemble_budget(terms, LAW_QUANTITIES, p))
    data = measure(stiffness(), interface(), np.random.default_rng(1))
    after = calibrate(cells, [data]).law["error_half_width"]
    assert np.all(after.sel(error_term="small slopes", quantity="mean_gap") == 0.02)
    assert np.all(after.sel(error_term="small slopes", quantity="stiffness") == 0.0)


def test_curves_of_stiffness_rise():
    """Between both envelopes, with the rates of the places that they are taken from."""
    falls = Curve(X[:5], np.array([0.0, 2.0, 1.0, 1.5, 3.0]), np.array([[0.0, 1.0, 2.0, 3.0, 4.0]]))
    np.testing.assert_allclose(falls.rising().log_stiffness, [0.0, 1.5, 1.5, 1.75, 3.0])
    np.testing.assert_allclose(falls.rising().rates, [[0.0, 1.5, 1.5, 2.0, 4.0]])
    np.testing.assert_allclose(falls.rising().rising().log_stiffness, falls.rising().log_stiffness)


def test_samples_have_the_stiffness_and_the_gap_of_their_curves(law):
    """Up to the ends of the data, and with gaps that the heights and the stiffness change."""
    given = [interface(f, exponent=m) for f, m in ((1.0, 1.0), (0.8, 0.9), (1.3, 1.1), (1.0, 0.6))]
    few, heights = law.isel(sample=range(3)), np.array([1.0, 1.3, 0.7, 1.0])
    after = law_of_interfaces(few, given, heights, [], sheared=False)
    p = law["fit_pressure"].to_numpy()
    laws = fitted_laws(after, [None, *range(3)])
    stiffness = np.array([normal.stiffness(normal.gap_at(p)) for normal in laws])
    expected = np.exp([bed.curve.at(p)[0] for bed in given])
    np.testing.assert_allclose(stiffness, expected, rtol=0.02)
    half = interval_errors(after)["mean_law"][0]
    gap = np.array([normal.gap_at(p) for normal in laws])
    np.testing.assert_allclose(half, half_range(gap[1:]) / gap[0], rtol=0.05)


def test_the_calibrated_law_is_a_law_with_samples_and_a_budget(law):
    data = [
        measure(table, interface(), np.random.default_rng(2)) for table in (stiffness(), loop())
    ]
    calibrated = calibrate(law, data).law
    assert calibrated.sizes["sample"] == calibrated.sizes["shear_sample"] == law.sizes["sample"]
    value, (low, high) = predict_measured(calibrated, stiffness(np.array([2e7]), {}))
    half = interval_errors(calibrated)["mean_law"][2]
    at = np.interp(np.log(2e7), np.log(calibrated["fit_pressure"]), half)
    fewer = calibrated.isel(shear_sample=slice(8))  # of sheared cells than of pressed cells
    assert np.isfinite(predict_measured(fewer, loop())[1]).all()
    k = calibrated["shear_friction_sample"].to_numpy()
    assert 0.5 * (high - low)[0] / value[0] < 1.2 * at
    assert k.std() < 0.1 * 0.3
    again = calibrate(law, data, lambda table, *given: table.answer(*given)).law
    np.testing.assert_allclose(again["coefficient"], calibrated["coefficient"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: [], "there are no measured values"),
        (lambda t: [replace(t, pressure=10.0 * t.pressure)], "was not computed at the measured"),
        (
            lambda t: [t, replace(t, value=2.0 * t.value)],
            "of 16 measured values are more than 3 standard deviations",
        ),
    ],
)
def test_contradictory_and_distant_data_are_refused(law, change, message):
    table = measure(stiffness(), interface(), np.random.default_rng(4))
    with pytest.raises(CaseError, match=message):
        calibrate(law, change(table))


def test_few_cells_add_their_scatter_where_all_samples_are_alike(law):
    scatter = law.assign_attrs(n_control=64).assign(
        cell_scatter=(("quantity", "load"), np.full((1, 3), 0.1), {"units": "1"}),
        quantity=["stiffness"],
    )
    alike, other = (_covariance_of_cells(scatter, s * np.eye(2), 4.0) for s in (0.0, 2e-3))
    np.testing.assert_allclose(alike, alike[0, 0])
    single = _covariance_of_cells(scatter, np.zeros((2, 2)), 1.0)
    np.testing.assert_allclose(single, 4.0 * alike)
    assert other[0, 0] - 2e-3 == pytest.approx(alike[0, 0])
    table = measure(stiffness(), interface(), np.random.default_rng(4))
    with pytest.raises(CaseError, match="cells must be positive"):
        calibrate(law, [table], cells=0.0)


def test_loops_are_rows_of_the_same_preload():
    preload = np.array([20.0, 20.01, 19.99, 40.0, 40.0, 20.0])
    assert split_loops(preload) == [slice(0, 3), slice(3, 5), slice(5, 6)]


ROWS = "10, 20\n20, 30\n40, 50\n"


def test_a_table_needs_an_error_or_has_it_in_a_column(tmp_path):
    file = tmp_path / "table.csv"
    file.write_text("preload (MPa), stiffness (MPa/um)\n" + ROWS)
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


def test_closures_do_not_depend_on_the_zero_of_their_sensor(tmp_path):
    file, tables = tmp_path / "closure.csv", []
    for zero in (0.0, 100.0):
        rows = "".join(f"{p}, {zero + u}\n" for p, u in ((10, 0.0), (20, 0.4), (30, 0.6)))
        file.write_text("pressure (MPa), closure (um)\n" + rows)
        tables.append(read_measured(file, "closure", error=0.05))
    low, high = tables
    np.testing.assert_allclose(high.deviation, low.deviation)
    np.testing.assert_allclose(HALF * low.deviation[1:], 0.05 * low.value[1:], rtol=1e-4)


def test_the_frame_is_a_share_of_the_stiff_branches(tmp_path):
    """Under a secant five times as soft as the slope after the turn."""
    file = tmp_path / "loop.csv"
    rows = ((1, 1.0), (5, 1.1), (4, 0.1), (-3, -1.0), (-5, -1.1), (-4, -0.1), (3, 1.0), (5, 1.1))
    text = "".join(f"9, {u}, {t}\n" for u, t in rows)
    file.write_text("preload (MPa), displacement (um), shear (MPa)\n" + text)
    frame = HALF * read_measured(file, "loop", error=0.05).nuisances["frame"]
    assert frame == pytest.approx(0.2 * 1e-12, rel=1e-3)


@pytest.mark.long
def test_the_posterior_agrees_with_an_ensemble_of_chains():
    """Level and exponent of the law, kappa, mu, frames and zeros, by stiffnesses and a loop."""
    emcee = pytest.importorskip("emcee")
    scale = np.append(np.array([0.2, 0.1, 0.12, 0.5]) / HALF, 2 * [*NUISANCES.values()])
    random = np.random.default_rng(8)

    def answers(theta, tables):
        """Values over their deviations, with derivatives, by whitened parameters."""
        level, bend, ratio, friction, *others = scale * theta
        bed = interface(1.0, 0.8 * np.exp(ratio), 0.3 * np.exp(friction))
        curve = bed.curve
        moved = curve.log_stiffness + np.array([level, bend]) @ curve.rates
        bed, values, rows = bed._replace(curve=replace(curve, log_stiffness=moved)), [], []
        for k, table in enumerate(tables):
            place = slice(4 + 2 * k, 6 + 2 * k)
            given = dict(zip(NUISANCES, others[2 * k : 2 * k + 2], strict=True))
            value, gradient = table.answer(bed, given)
            row = np.zeros((value.size, theta.size))
            row[:, :4], row[:, place] = gradient[:, :4], gradient[:, 4:]
            values.append((value - table.value) / table.deviation)
            rows.append(row * scale / table.deviation[:, None])
        return np.concatenate(values), np.concatenate(rows)

    data = [measure(table, interface(1.1, 0.75, 0.25), random) for table in (stiffness(), loop())]
    mode = find_mode(lambda theta: answers(theta, data), scale.size)
    draws = draw(lambda theta: answers(theta, data), mode, 2000, 1000, random)

    def log_density(theta):
        r = answers(theta, data)[0]
        return -0.5 * (theta @ theta + 4.0 * np.log1p(r**2 / 4.0).sum())

    chains = emcee.EnsembleSampler(24, scale.size, log_density)
    chains.run_mcmc(mode.theta + 0.1 * random.normal(size=(24, scale.size)), 900)
    drawn = chains.get_chain(discard=200, flat=True)
    half = HALF * drawn.std(axis=0)
    for estimate in (mode.theta, draws.theta.mean(axis=0)):
        assert np.abs((estimate - drawn.mean(axis=0)) / half).max() < 0.25
    for deviation in (np.sqrt(np.diag(mode.covariance)), draws.theta.std(axis=0)):
        np.testing.assert_allclose(deviation, drawn.std(axis=0), rtol=0.15)


@pytest.mark.parametrize("specimen", ["specimen_vd1.csv", "specimen_vd2.csv"])
def test_fractures_close_under_twice_the_measured_stress_as_predicted(reference_data, specimen):
    """Granodiorite, of unknown roughness: up to 5 MPa are measured, 6 to 10 MPa are predicted.

    D. Vogler and others, J. Geophys. Res. Solid Earth 123 (2018), doi:10.1002/2017JB015057.
    """
    surfaces = [rough_square(64, 0.25, 0.0625, 0.03, seed=seed) for seed in range(8)]
    response = press_flat(surfaces, 0.03 * np.geomspace(5e-3, 0.3, 10))
    for name, unit in (("mean_gap", 0.1), ("traction", 1.2e9), ("nominal_pressure", 1.2e9)):
        response[name] = response[name] * unit  # m, and the contact modulus of such a scale, Pa
    cells = fit_branches(response, n_samples=80)
    _, closure, stress = np.genfromtxt(
        reference_data / "fractures" / specimen, delimiter=",", skip_header=2
    ).T
    rise = slice(0, int(np.argmax(stress)) + 1)
    p, closure = 1e6 * stress[rise], 1e-3 * closure[rise]

    def table(rows):
        deviation = np.hypot(1e-6, 0.02 * closure[rows])
        nuisances = {"frame": 0.5e-12, "offset": 2e4, "zero": 2e-6}
        return MeasuredClosure(specimen, p[rows], closure[rows], deviation, nuisances)

    seen, unknown = p < 5.3e6, p > 5.3e6
    wide = {"roughness": 3.0, "discrepancy": 3.0, "exponent": 0.3}  # nothing of them is known
    calibrated = calibrate(cells, [table(seen)], extrapolate=True, **wide).law
    _, (low, high) = predict_measured(calibrated, table(p > 0.0))
    inside = (low <= closure) & (closure <= high)
    assert inside[unknown].all()
    assert np.all((high - low)[unknown] < 0.4 * closure[unknown])
