"""Grids and lengths: theoretical values, and unknown orders."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.upscaling import estimate_grid_error
from multiscale.upscaling.scales import compare_scales, pressure_length_of_points


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_order_and_error_of_a_smooth_sequence_are_recovered(order):
    limit, factor = 2.0, np.array([0.1, -0.3])
    answers = {r: limit + factor * r**order for r in (1.0, 2.0, 4.0)}
    estimate = estimate_grid_error(answers[1.0], {2.0: answers[2.0], 4.0: answers[4.0]})
    np.testing.assert_allclose(estimate.order, order)
    np.testing.assert_allclose(estimate.error, answers[1.0] - limit)
    np.testing.assert_allclose(estimate.half_width, 1.25 * np.abs(factor))
    assert f"observed order {order:.2g}" in estimate.how


def test_one_coarser_grid_bounds_the_error_of_any_order_from_one_on():
    for order in (1.0, 2.0, 3.0):
        estimate = estimate_grid_error(np.array([1.1]), {2.0: np.array([1.0 + 0.1 * 2.0**order])})
        assert estimate.half_width[0] >= 0.1
        assert np.isnan(estimate.order)
        assert "order taken as 1" in estimate.how


def test_grids_without_an_order_give_a_wide_bound_and_a_reason():
    estimate = estimate_grid_error(
        np.array([1.0, 1.0]), {2.0: np.array([1.1, 1.1]), 4.0: np.array([1.0, 1.11])}
    )
    np.testing.assert_allclose(estimate.half_width, 0.3)
    assert estimate.how.endswith("observed order none")


def test_a_step_with_a_difference_through_zero_has_no_separate_order():
    first, second = np.full(6, 0.02), np.full(6, 0.04)
    first[3], second[4] = 0.0026, -0.001  # separately they would give orders of 4, and none
    estimate = estimate_grid_error(np.ones(6), {2.0: 1.0 - first, 4.0: 1.0 - first - second})
    assert estimate.order == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(estimate.half_width, 1.25 * np.abs(estimate.error), rtol=0.1)
    assert np.max(estimate.half_width) < 0.03


def test_one_coarser_grid_with_a_difference_that_changes_its_sign_has_no_small_error_at_one_step():
    answer, difference = np.full(5, 2.0), np.array([0.2, 0.1, 0.001, -0.1, -0.1])
    estimate = estimate_grid_error(answer, {2.0: answer + difference})
    usual = 1.25 * np.sqrt(np.mean(difference**2))
    np.testing.assert_allclose(estimate.half_width, [0.25, usual, usual, usual, usual])
    same = estimate_grid_error(answer, {2.0: answer + np.abs(difference)})
    np.testing.assert_allclose(same.half_width, 1.25 * np.abs(difference))


def test_one_coarser_grid_bounds_each_of_several_answers_by_its_differences():
    answer = np.array([[2.0, 2.0, 2.0], [1.0, 1.0, 1.0]])
    coarse = np.array([[2.1, 1.9, np.nan], [0.8, 0.8, 0.8]])
    half_width = estimate_grid_error(answer, {2.0: coarse}).half_width
    np.testing.assert_allclose(half_width, [[0.125, 0.125, np.nan], [0.25, 0.25, 0.25]])


def test_scales_that_are_apart_pass_without_caution():
    scales = compare_scales(1e-5, 4e-5, 1e-2)
    assert scales.wavelength_ratio == pytest.approx(1e-3)
    assert scales.cell_ratio == pytest.approx(4e-3)
    assert scales.cautions == ()


def test_scales_that_are_not_apart_are_reported():
    (even,) = compare_scales(1e-3, 4e-3, 2e-3).cautions
    assert "the interface is 2 mm wide, less than the cell of 4 mm: it has edges" in even
    (varying,) = compare_scales(1e-3, 4e-3, 2e-3, extent=8e-3).cautions
    assert "the pressure varies over 2 mm, less than the cell of 4 mm" in varying
    with pytest.raises(CaseError, match="macro_length must be positive and finite, got 0"):
        compare_scales(1.0, 1.0, 0.0)


def test_the_length_of_a_cosine_is_its_inverse_wave_number():
    x, y = np.meshgrid(np.arange(200) / 100.0, np.arange(20) / 50.0, indexing="ij")
    place, area = np.stack([x.ravel(), y.ravel()], axis=1), np.full(x.size, 2e-4)
    wave = np.cos(2.0 * np.pi * place[:, 0])
    for unit in (1e-9, 1.0, 1e9):
        length = pressure_length_of_points(place, unit * wave, area)
        assert length == pytest.approx(0.5 / np.pi, rel=1e-2)
    assert pressure_length_of_points(place, np.ones(x.size), area) == np.inf
