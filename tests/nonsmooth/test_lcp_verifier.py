"""The verifier of linear complementarity problems against problems with a known answer."""

import numpy as np
import pytest

from multiscale.bench.lcp_scenes import condensed, granular, loaded_column
from multiscale.nonsmooth.lcp_problem import verify_lcp


def test_a_known_error_is_measured():
    # min(z, w) = min(1.1, 0.2) in the first row of scale 1/sqrt(2); data 2 / sqrt(2)
    found = verify_lcp(np.diag([2.0, 1.0]), np.array([-2.0, 1.0]), np.array([1.1, 0.0]))
    assert found.error == pytest.approx(0.1)
    assert found.worst == 0
    found = verify_lcp(np.diag([2.0, 1.0]), np.array([-2.0, 1.0]), np.array([0.9, -0.3]))
    assert found.penetration == pytest.approx(0.2)
    assert found.adhesion == pytest.approx(0.3)


@pytest.mark.parametrize("huge", [-1e10, 1e10])
def test_a_huge_entry_does_not_hide_a_wrong_one(huge):
    value = np.array([max(0.0, -huge), 0.0])  # right in the first row, wrong in the second
    assert verify_lcp(np.eye(2), np.array([huge, -1.0]), value).error >= 5e-5
    value[1] = 1.0
    assert verify_lcp(np.eye(2), np.array([huge, -1.0]), value).error == 0.0


def test_a_solution_that_runs_away_cannot_pass():
    matrix, vector = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array([-1.0, -1.0])
    for size in 10.0 ** np.arange(0, 30, 2):
        assert verify_lcp(matrix, vector, np.full(2, size)).error >= 0.99


def test_values_that_are_not_finite_cannot_pass():
    assert verify_lcp(np.eye(2), -np.ones(2), np.array([1.0, np.nan])).error == np.inf


def test_the_error_is_the_same_in_all_units_and_scales():
    mass, directions, vector = granular(30)
    matrix = condensed(mass, directions).toarray()
    rng = np.random.default_rng(seed=5)
    value = rng.uniform(0.0, 1.0, vector.size)
    error = verify_lcp(matrix, vector, value).error
    scale = 10.0 ** rng.uniform(-6.0, 6.0, vector.size)
    scaled = verify_lcp(scale[:, None] * matrix * scale, scale * vector, value / scale)
    assert scaled.error == pytest.approx(error)
    assert verify_lcp(1e-9 * matrix, vector, 1e9 * value).error == pytest.approx(error)


def test_rounding_alone_is_no_error():
    mass, directions, vector = loaded_column(100, mass_ratio=1e8)
    weight = 9.81e-3 * np.cumsum(mass.diagonal()[::-1])[::-1]  # each contact carries what is above
    matrix = condensed(mass, directions)
    assert verify_lcp(matrix, vector, weight).error <= 1e-10
    assert verify_lcp(matrix, vector, weight * (1.0 + 1e-4)).error >= 5e-5
