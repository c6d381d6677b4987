"""Friction of cells against pressure and distance."""

import numpy as np

from multiscale.laws.bulk import Elastic
from multiscale.micro import Cell, SecondBody, slide_cell
from multiscale.schema import SLIDING_RESPONSE
from tests.support import egg_box

N = 8


def sliding_cell():
    return Cell(
        egg_box(N, 0.02),
        0.5,
        4,
        1.0,
        0.3,
        egg_box(N, -0.02),
        friction_coefficient=0.2,
        opposite=SecondBody(0.5, 4, Elastic(1.0, 0.3)),
    )


def test_friction_is_the_ratio_of_the_averages_at_every_load_and_step():
    response = slide_cell(sliding_cell(), (0.004, 0.008), 1.0, steps=8)
    SLIDING_RESPONSE.check(response)
    assert response["converged"].values.all()
    traction = response["traction"].values
    np.testing.assert_allclose(-traction[..., 0], [[0.004] * 9, [0.008] * 9], rtol=1e-6)
    friction = response["effective_friction"].values
    np.testing.assert_allclose(friction, -traction[..., 1] / traction[..., 0])
    np.testing.assert_allclose(response["steady_friction"], friction[:, 1:].mean(axis=1))
    # uphill and downhill cost the same at a given load, but for the square of the slope
    np.testing.assert_allclose(response["steady_friction"], 0.2, rtol=0.05)
    assert np.ptp(friction[:, 1:]) > 0.02


def test_less_than_a_period_has_no_steady_friction():
    response = slide_cell(sliding_cell(), (0.004,), 0.25, steps=1)
    assert np.isnan(response["steady_friction"].values).all()
