"""Control variates against closed forms: bias, variance, coverage, weight and split."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import t

from multiscale.errors import CaseError
from multiscale.upscaling import error_budget, fit_law, law_band, law_from_dataset, observe
from multiscale.upscaling.sampling import Control, best_ratio, draw_counts
from tests.upscaling.responses import DECAY, PRESSURE, SCALE, response_of

SIGMA, RHO, SLOPE = 0.3, 0.98, 2.0


def pairs(random, n, n_cheap, rho=RHO):
    """Dear values of mean 1 and scatter SIGMA, and cheap values of another mean and scatter."""
    f = random.standard_normal(n_cheap)
    y = 1.0 + SIGMA * (rho * f[:n] + np.sqrt(1.0 - rho**2) * random.standard_normal(n))
    return y[:, None], (5.0 + SIGMA / SLOPE * f)[:, None]


def variance_ratio(rho, n, n_cheap):
    """Variance with control over the variance of the mean of only the dear values."""
    return 1.0 - rho**2 * (1.0 - n / n_cheap)


def test_the_mean_has_no_bias_and_the_variance_of_theory():
    """Known weight: 1 - rho^2 (1 - R/M); a fitted one inflates the residual (R - 2)/(R - 3)."""
    n, n_cheap, random = 12, 120, np.random.default_rng(0)
    results = [Control.of(*pairs(random, n, n_cheap)).mean[0] for _ in range(2000)]
    of_pairs = (1.0 - RHO**2) * (n - 2) / (n - 3)
    expected = SIGMA**2 * (of_pairs / n + RHO**2 / n_cheap)
    # the addition of the fitted weight is small here, and the reduction to a tenth is not
    assert variance_ratio(RHO, n, n_cheap) == pytest.approx(expected * n / SIGMA**2, rel=0.06)
    assert np.var(results) == pytest.approx(expected, rel=0.12)  # 3.2 % scatter of a variance
    assert np.mean(results) == pytest.approx(1.0, abs=4.0 * np.sqrt(expected / 2000))


def test_weight_and_correlation_follow_from_the_pairs():
    y, f = pairs(np.random.default_rng(1), 400, 800)
    estimate = Control.of(y, f)
    slope, offset = np.polyfit(f[:400, 0], y[:, 0], 1)
    assert estimate.weight[0] == pytest.approx(slope, rel=1e-10)
    assert estimate.correlation[0] == pytest.approx(
        np.corrcoef(f[:400, 0], y[:, 0])[0, 1], rel=1e-10
    )
    assert estimate.mean[0] == pytest.approx(slope * f.mean() + offset, rel=1e-10)
    # next to a line fitted by least squares, the error of its value at the mean of all
    residual = y[:, 0] - slope * f[:400, 0] - offset
    apart = (f.mean() - f[:400].mean()) ** 2 / np.sum((f[:400] - f[:400].mean()) ** 2)
    square = np.sum(residual**2) / 398 * (1.0 / 400 + apart)
    assert np.var(estimate.residuals, ddof=1) / 400 == pytest.approx(square, rel=1e-10)


@pytest.mark.parametrize("n", [4, 6, 12])
def test_the_interval_covers(n):
    """Student's interval of both parts: 95 % of 1000 repeats."""
    random, inside = np.random.default_rng(n), []
    for _ in range(1000):
        y, f = pairs(random, n, 40 * n)
        estimate = Control.of(y, f)
        parts = ((y, n - 1),) if estimate is None else estimate.ensembles
        mean = y.mean() if estimate is None else estimate.mean[0]
        errors = [rows.std(ddof=1) / np.sqrt(len(rows)) for rows, _ in parts]
        half = np.linalg.norm(t.ppf(0.975, [freedom for _, freedom in parts]) * errors)
        inside.append(abs(mean - 1.0) <= half)
    assert 0.935 < np.mean(inside) < 0.98


def test_the_best_split_has_the_least_variance_for_its_time():
    """Of all ratios M/R that cost the same; R (c + M/R) is the time."""
    rho, cost = 0.95, 30.0

    def variance(ratio):
        n = 1.0 / (cost + ratio)
        return variance_ratio(rho, n, ratio * n) / n

    optimum = minimize_scalar(variance, bounds=(1.0, 200.0), method="bounded")
    assert best_ratio(rho, cost) == pytest.approx(optimum.x, rel=1e-3)


def test_cells_that_do_not_follow_are_of_no_use():
    random = np.random.default_rng(3)
    used = [Control.of(*pairs(random, 8, 200, rho=0.0)) is not None for _ in range(400)]
    assert np.mean(used) < 0.08  # 5 %, and none that follow the other way
    y, f = pairs(random, 8, 200, rho=0.999)
    assert Control.of(y, np.ones((200, 1))) is None  # nothing scatters
    assert Control.of(y[:3], f) is None
    assert Control.of(y, f) is not None


def ensembles(seed, n=8, n_cheap=200):
    """Gaps of a separate decay length each, which the cheap cells share, but for an offset."""
    random = np.random.default_rng(seed)
    scatter = 1.0 + 0.1 * random.standard_normal((n_cheap, 1))
    direct = scatter[:n] + 0.002 * random.standard_normal((n, 1))
    gap = DECAY * np.log(SCALE / PRESSURE)
    area = PRESSURE / 5e8
    dear = response_of(gap * direct, area=area / direct)
    cheap = response_of(0.9 * gap * scatter, area=0.8 * area / scatter)
    return dear, cheap


def test_law_samples_and_budget_count_both_ensembles():
    dear, cheap = ensembles(0)
    law, alone = fit_law(dear, control=cheap), fit_law(dear)
    assert "200 control cells" in law.attrs["control"]
    assert law.attrs["n_control"] == 200
    assert law.attrs["n_realisations"] == 8
    gap = law_from_dataset(law).gap_at(PRESSURE[2])
    with_control, without = (
        error_budget(dear, single_law, control=more)
        for single_law, more in ((law, cheap), (alone, None))
    )
    half, plain = (
        item["error_half_width"].sel(error_term="sampling").values
        for item in (with_control, without)
    )
    assert "200 control cells" in with_control.attrs["how_sampling"]
    # 1.96 .1 / sqrt(200), and the residual of 8 pairs, against 2.36 .1 / sqrt(8)
    residual = t.ppf(0.975, 6) * 0.002 / np.sqrt(8)
    expected = np.hypot(t.ppf(0.975, 199) * 0.1 / np.sqrt(200), residual)
    assert half[0] == pytest.approx(expected, rel=0.15)
    assert np.all(half < 0.3 * plain)
    low, high = law_band(law, lambda item: item.gap_at(PRESSURE[2]))
    assert (high - low) / 2.0 / gap == pytest.approx(half[0, 2], rel=0.15)


def test_the_scatter_of_single_cells_is_not_reduced():
    """It is the scatter of the dear cells, and better known."""
    dear, cheap = ensembles(1)
    budget = error_budget(dear, fit_law(dear, control=cheap, n_samples=0), control=cheap)
    scatter = budget["cell_scatter"].sel(quantity="mean_gap").values
    assert scatter == pytest.approx(0.1, rel=0.12)
    scatter = budget["cell_scatter"].sel(quantity="stiffness").values
    assert scatter == pytest.approx(0.1, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("n", [5, 12])
def test_the_samples_cover(n):
    """Percentiles of 200 samples of 200 repeats; pairs are drawn together, others apart."""
    random, inside = np.random.default_rng(n), []
    for seed in range(200):
        y, f = pairs(random, n, 60 * n)
        seen = replace(
            observe("contact_fraction", np.ones(1), 0.2 * y), control=Control.of(0.2 * y, f)
        )
        drawn, weight = seen.means(draw_counts(n, 200, seed, n_further=seen.n_further))
        if seen.control is None:
            drawn = 0.2 * y.mean() + seen.widening * (drawn - 0.2 * y.mean())
        assert np.all(weight == 1.0)
        low, high = np.percentile(drawn, [2.5, 97.5])
        inside.append(low <= 0.2 <= high)
    assert 0.91 <= np.mean(inside) <= 0.99


def test_cells_pair_by_their_number():
    dear, cheap = ensembles(2)
    order = np.random.default_rng(0).permutation(200)
    shuffled = cheap.isel(realisation=order)
    first, other = (fit_law(dear, control=each, n_samples=0) for each in (cheap, shuffled))
    np.testing.assert_allclose(first["fit_mean_gap"], other["fit_mean_gap"], rtol=1e-12)
    with pytest.raises(CaseError, match="no cells of the realisations"):
        fit_law(dear, control=cheap.isel(realisation=range(4, 200)))
    with pytest.raises(CaseError, match="were not pressed under"):
        fit_law(dear, control=cheap.isel(step=range(3)))


def test_failed_steps_of_either_ensemble_are_left_out():
    dear, cheap = ensembles(4)
    whole = fit_law(dear, control=cheap, n_samples=0)["fit_mean_gap"].values
    dear["converged"][2, 3] = 0
    dear["mean_gap"][2, 3] = np.nan
    cheap["converged"][5, 1] = 0
    cheap["mean_gap"][5, 1] = np.nan
    cheap["mean_gap"][50, 2] = np.nan
    cheap["converged"][50, 2] = 0
    computed = fit_law(dear, control=cheap)["fit_mean_gap"].values
    np.testing.assert_allclose(computed, whole, rtol=5e-3)


def test_a_budget_reports_where_cells_do_not_follow():
    dear, cheap = ensembles(3)
    shuffled = cheap["mean_gap"].values.copy()
    shuffled[:8] = shuffled[:8][::-1] + shuffled[8:16]  # of no realisation
    other = cheap.assign(mean_gap=cheap["mean_gap"].copy(data=shuffled[np.r_[8:200, :8]]))
    law = fit_law(dear, control=other, n_samples=0)
    assert law.attrs["control"].startswith("mean gap: none, since they follow each other by chance")
    text = error_budget(dear, law, control=other).attrs["how_sampling"]
    assert "8 realisations only, since they and the control cells" in text
    np.testing.assert_allclose(law["fit_mean_gap"], fit_law(dear, n_samples=0)["fit_mean_gap"])
