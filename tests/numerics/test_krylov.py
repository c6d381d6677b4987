"""Krylov methods on matrices without a solution."""

import numpy as np
import pytest

from multiscale.errors import MultiscaleError
from multiscale.numerics.krylov import conjugate_gradients


def test_conjugate_gradients_refuse_a_mechanism():
    matrix = np.diag([1.0, 0.0])
    with pytest.raises(MultiscaleError, match="stiffness of 0, so that the matrix is singular"):
        conjugate_gradients(lambda v: matrix @ v, np.array([0.0, 1.0]), np.copy, goal=0.0, limit=9)
