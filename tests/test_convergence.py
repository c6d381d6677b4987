"""A solution cannot call itself converged without a finite residual."""

import numpy as np
import pytest

from multiscale.convergence import Solution, Status
from multiscale.errors import ConvergenceError


@pytest.mark.parametrize("residuals", [(), (np.nan,), (1.0, np.inf)])
def test_a_converged_solution_needs_a_finite_residual(residuals):
    with pytest.raises(ValueError, match="finite last residual"):
        Solution(np.zeros(2), Status.CONVERGED, residuals)


def test_unwrapping_an_unconverged_solution_says_why():
    with pytest.raises(
        ConvergenceError, match=r"in 2 iterations \(last residual 3.0e-04\): the it"
    ):
        Solution(np.zeros(2), Status.MAX_ITERATIONS, (1.0, 3e-4)).unwrap()


def test_unwrapping_a_converged_solution_gives_its_value():
    assert Solution(np.ones(2), Status.CONVERGED, (1e-12,)).unwrap().sum() == 2.0
