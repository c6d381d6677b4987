"""Intervals have the width of theory, trends the slope of theory, and too few data are refused."""

import numpy as np
import pytest
from scipy.stats import t

from multiscale.errors import CaseError
from multiscale.upscaling import (
    ensemble_average,
    required_realisations,
    size_trend,
)
from tests.upscaling.responses import exponential_gaps, response_of


def scattered(n, spread, seed=0):
    random = np.random.default_rng(seed)
    return response_of(exponential_gaps(1) * (1.0 + spread * random.standard_normal((n, 1))))


def test_the_interval_of_a_mean_is_students():
    average = ensemble_average(scattered(5, 0.1), confidence=0.9)
    np.testing.assert_allclose(
        average.half_width, 2.131846786 * average.deviation / np.sqrt(5), rtol=1e-8
    )
    assert np.all(average.n == 5)
    np.testing.assert_allclose(np.diff(average.coefficient_of_variation), 0.0, atol=1e-12)


def test_intervals_of_a_mean_cover_it_as_often_as_they_say():
    truth, covered = exponential_gaps(1)[0, 0], []
    for seed in range(400):
        average = ensemble_average(scattered(4, 0.1, seed), confidence=0.8)
        covered.append(abs(average.mean[0] - truth) <= average.half_width[0])
    assert np.mean(covered) == pytest.approx(0.8, abs=0.06)


def test_failed_steps_do_not_count():
    gap = exponential_gaps(5)
    converged = np.ones(gap.shape, dtype=int)
    converged[0, 2] = 0
    gap[0, 2] = np.nan
    average = ensemble_average(response_of(gap, converged=converged))
    assert list(average.n) == [5, 5, 4, 5, 5, 5, 5, 5]
    assert average.mean[2] == pytest.approx(gap[1:, 2].mean())


@pytest.mark.parametrize("cov", [0.01, 0.05, 0.3])
@pytest.mark.parametrize("target", [0.01, 0.05])
def test_the_number_of_realisations_is_the_smallest_that_suffices(cov, target):
    n = required_realisations(cov, target)

    def half(m):
        return t.ppf(0.975, m - 1) * cov / np.sqrt(m)

    assert half(n) <= target
    assert n == 2 or half(n - 1) > target


def test_too_few_realisations_are_refused_with_the_number_that_suffices():
    response = scattered(5, 0.05)
    cov = float(ensemble_average(response).coefficient_of_variation[0])
    need = required_realisations(cov, 0.02)
    with pytest.raises(
        CaseError, match=rf"5 realisations give mean_gap within .* % with 95 % .* about {need} real"
    ):
        ensemble_average(response, target=0.02)
    ensemble_average(response, target=0.5)
    with pytest.raises(CaseError, match=r"one realisation tells nothing .* needs at least 3"):
        ensemble_average(scattered(1, 0.05), target=0.02)
    with pytest.raises(CaseError, match="no average of 'gap'; choose from mean_gap"):
        ensemble_average(response, "gap")


def test_the_slope_of_the_scatter_is_found_with_its_uncertainty():
    inside = []
    for seed in range(60):
        responses = {size: scattered(40, 0.2 / size, seed=100 * seed + size) for size in (1, 2, 4)}
        trend = size_trend(responses)
        inside.append(trend.slope_interval[0] <= -1.0 <= trend.slope_interval[1])
    np.testing.assert_allclose(trend.at, [1, 2, 4])
    assert np.mean(inside) >= 0.85


def test_trends_over_the_size_ask_for_enough():
    with pytest.raises(CaseError, match="at least two sizes, got 1"):
        size_trend({1.0: scattered(40, 0.1)})
    with pytest.raises(CaseError, match="scatter from 5 realisations is too uncertain"):
        size_trend({1.0: scattered(5, 0.1), 2.0: scattered(40, 0.1)})
    with pytest.raises(CaseError, match=r"no step at 1 Pa; the nearest is at 5e\+06 Pa"):
        size_trend({1.0: scattered(9, 0.1), 2.0: scattered(9, 0.1)}, pressure=1.0)
