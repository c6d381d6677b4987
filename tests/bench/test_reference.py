"""Extrapolation to the limit of a ladder of grids."""

import numpy as np
import pytest

from multiscale.bench.limits import common_reference, extrapolate


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_the_limit_of_a_power_of_the_spacing_is_exact(order):
    spacing = 0.5 ** np.arange(4.0)
    assert extrapolate(3.0 - 0.7 * spacing**order) == pytest.approx(3.0, rel=1e-12)
    assert extrapolate(3.0 - 0.7 * spacing**order, order=order) == pytest.approx(3.0, rel=1e-12)


def test_the_observed_order_is_kept_between_one_and_two():
    assert extrapolate(np.array([0.0, 0.5, 0.99])) == pytest.approx(0.99 + 0.49)
    assert extrapolate(np.array([0.0, 0.9, 0.93])) == pytest.approx(0.93 + 0.03 / 3.0)
    assert extrapolate(np.array([1.0, 0.9, 0.93])) == pytest.approx(0.93 + 0.03 / 3.0)
    assert extrapolate(np.array([1.0, 0.5, 0.5])) == 0.5


def test_a_grid_without_result_leaves_no_limit():
    assert np.isnan(extrapolate(np.array([1.0, 2.0, np.nan])))
    reference = common_reference(np.array([np.nan, 2.0]), np.array([np.nan, 2.1]))
    assert reference[0] == 2.0
    assert np.isnan(reference[1])
    assert np.isnan(common_reference(np.array([np.nan]), np.array([np.nan]))).all()
