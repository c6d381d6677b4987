"""Figures of cells that slide show the numbers of the dataset."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from multiscale.plotting import plot_lines
from multiscale.schema import SLIDING_RESPONSE


@pytest.fixture
def response():
    both = (2, 3)
    friction = np.array([[0.0, 0.2, 0.3], [0.0, 0.25, 0.28]])
    names = ("mean_gap", "contact_fraction", "increments", "wall_time")
    counts = ("converged", "active_set_iterations", "linear_iterations")
    return SLIDING_RESPONSE.build(
        {
            "traction": np.zeros((*both, 3)),
            "effective_friction": friction,
            "steady_friction": friction[:, 1:].mean(axis=1),
            "nominal_pressure": [1e6, 2e6],
            "sliding_distance": [0.0, 1e-6, 2e-6],
        }
        | dict.fromkeys(names, np.zeros(both))
        | dict.fromkeys(counts, np.ones(both, dtype=int))
    )


def test_every_pressure_has_a_line(response):
    ax = plot_lines(response, "effective_friction", by="nominal_pressure", ax=Figure().subplots())
    lines = [line for line in ax.lines if line.get_label().endswith("MPa")]
    assert [line.get_label() for line in lines] == ["1 MPa", "2 MPa"]
    np.testing.assert_allclose(lines[0].get_xdata(), [0.0, 1.0, 2.0])
    np.testing.assert_allclose(lines[1].get_ydata(), [0.0, 0.25, 0.28])


def test_the_steady_friction_stands_over_the_pressure(response):
    ax = plot_lines(response, "steady_friction", ax=Figure().subplots())
    np.testing.assert_allclose(ax.lines[0].get_xydata(), [[1.0, 0.25], [2.0, 0.265]])
