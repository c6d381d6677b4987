"""Step length of a convex potential, and paths whose steps fail."""

import numpy as np
import pytest

from multiscale.convergence import Solution, Status
from multiscale.errors import ConvergenceError
from multiscale.numerics.newton import march, step_length


@pytest.mark.parametrize("minimum", [0.02, 0.3, 0.7, 1.05, 3.0, 40.0])
def test_the_step_length_minimises_a_quadratic_potential(minimum):
    length = step_length(lambda step: step / minimum - 1.0, -1.0)
    assert length == pytest.approx(minimum, rel=0.1)


def test_a_path_goes_on_with_half_steps_after_a_step_that_raises():
    calls = []

    def attempt(state, aim):
        calls.append(aim)
        if len(calls) > 1 and aim - state > 0.26:
            raise ConvergenceError("too far")
        status = Status.CONVERGED if aim - state < 0.6 else Status.STALLED
        return Solution(np.array(aim), status, (0.0,)), aim

    path = march(attempt, 0.0, (0.0, 1.0), cuts=3)
    assert [part.aim for part in path] == [1.0, 0.25, 0.5, 0.75, 1.0]
