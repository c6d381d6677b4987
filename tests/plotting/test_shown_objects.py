"""Surfaces and laws show themselves in notebooks."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from multiscale.errors import CaseError
from multiscale.laws import Exponential
from multiscale.surfaces import Surface


def test_a_surface_is_drawn_with_x_along_the_first_axis():
    heights = np.zeros((8, 4))
    heights[7, 0] = 2e-6
    surface = Surface(heights, (8e-6, 4e-6))
    ax = surface.plot(ax=Figure().subplots())
    (image,) = ax.images
    assert image.get_extent() == pytest.approx([0.0, 8.0, 0.0, 4.0])
    assert np.asarray(image.get_array())[0, 7] == pytest.approx(2.0)  # µm, right of the lower edge
    assert "<td>8 x 4</td>" in surface._repr_html_()
    assert "<td>8 µm</td>" in surface._repr_html_()


def test_a_law_is_drawn_over_the_pressures_of_its_data_or_over_given_pressures():
    law = Exponential(pressure_scale=1e9, decay_length=1e-7)
    with pytest.raises(
        CaseError, match="no data with a range of pressures to plot; give pressures"
    ):
        law.plot()
    (line,) = law.plot(np.array([1e6, 1e8]), ax=Figure().subplots()).lines
    gap, pressure = line.get_data()
    np.testing.assert_allclose(law.pressure(1e-6 * np.asarray(gap)), 1e6 * np.asarray(pressure))
    assert "<caption>Exponential</caption>" in law._repr_html_()
