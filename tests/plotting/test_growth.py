"""Figures of growth: the data in the axes equal the dataset, and the slopes are right."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from multiscale.plotting.work_precision_figures import plot_growth
from multiscale.schema import WORK_PRECISION

CABLES = np.array([1e3, 4e3, 16e3])


def grown(converged=1):
    """Two methods and two scenes; the times of ``steep`` grow with the power 3/2."""
    labels = [
        (method, scene, cables)
        for method in ("steep", "flat")
        for scene in ("one", "two")
        for cables in CABLES
    ]
    method, scene, cables = (np.array(column) for column in zip(*labels, strict=True))
    n = cables.size
    return WORK_PRECISION.build(
        {
            "method": method,
            "scene": scene,
            "cables": cables.astype(int),
            "wall_time": np.where(method == "steep", cables**1.5, 7.0 * cables),
            "peak_memory": 1e8 + 1e3 * cables,
            "converged": np.append(np.ones(n - 1, dtype=int), converged),
            "error": np.zeros(n),
        }
    )


def lines(ax):
    return {line.get_label(): line for line in ax.lines}


def test_every_method_and_scene_has_a_line_with_its_slope():
    drawn = lines(plot_growth(grown(), ax=Figure().add_subplot()))
    assert list(drawn) == [
        "steep, one: slope 1.50",
        "steep, two: slope 1.50",
        "flat, one: slope 1.00",
        "flat, two: slope 1.00",
        "slope 1",
    ]
    np.testing.assert_array_equal(drawn["steep, two: slope 1.50"].get_xdata(), CABLES)
    np.testing.assert_allclose(drawn["steep, two: slope 1.50"].get_ydata(), CABLES**1.5)
    x, y = drawn["slope 1"].get_data()
    assert y[1] / y[0] == pytest.approx(x[1] / x[0])


def test_memory_is_in_megabyte_and_both_axes_are_logarithmic():
    ax = plot_growth(grown(), quantity="peak_memory", ax=Figure().add_subplot())
    np.testing.assert_allclose(ax.lines[0].get_ydata(), 100.0 + 1e-3 * CABLES)
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert ax.get_ylabel() == "peak memory (MB)"


def test_what_did_not_converge_is_left_out():
    drawn = lines(plot_growth(grown(converged=0), ax=Figure().add_subplot()))
    np.testing.assert_array_equal(drawn["flat, two: slope 1.00"].get_xdata(), CABLES[:-1])
