"""A path of which only one step has a value is not drawn as a line."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from multiscale.pipeline.showing import format_mean
from multiscale.plotting import load_pictures, plot_lines, vibration_pictures

NAN = np.nan


@pytest.mark.parametrize(
    ("moved", "drawn"), [([NAN, 2e-6, NAN], set()), ([NAN, 2e-6, 5e-6], {"loads", "bolts"})]
)
def test_loads_and_bolts_are_drawn_from_two_steps_on(moved, drawn):
    path = xr.Dataset(
        {
            "load_displacement": (("step", "load"), np.transpose([moved])),
            "factor": (("step", "load"), [[0.0], [1.0], [2.0]]),
            "bolt_force": (("step", "bolt"), 1e9 * np.transpose([moved])),
        },
        coords={"load": ["push"]},
    )
    pictures = load_pictures(path)
    assert set(pictures) == drawn
    if drawn:
        ax = Figure().add_subplot()
        pictures["loads"](ax=ax)
        np.testing.assert_allclose(ax.lines[0].get_xdata(), [NAN, 0.0, 3.0])  # from the first known


@pytest.mark.parametrize(("second", "drawn"), [(NAN, False), (99.0, True)])
def test_frequencies_are_drawn_from_two_amplitudes_on(second, drawn):
    first = ("step", [100.0, second])
    modes = xr.Dataset(
        {
            "step_mode": ("step", [1, 1]),
            "frequency": first,
            "damping": first,
            "converged": ("step", [1, 0]),
        }
    )
    assert ("frequency_0" in vibration_pictures(modes, 1)) == drawn


def test_values_that_are_alike_have_no_scatter():
    assert format_mean(np.full(3, 0.3431) + 1e-16 * np.arange(3)) == "0.3431"
    assert format_mean(np.array([0.3431, 0.3412, 0.3450])) == "0.3431 ± 0.0019"


def test_bands_have_the_unit_of_their_line():
    ends = [[1.5e12, 2.5e12], [2.5e12, 3.5e12]]
    joint = xr.Dataset(
        {
            "preload": ("step", [1e6, 2e6]),
            "joint_stiffness": ("step", [2e12, 3e12]),
            "joint_stiffness_mean_law": (("limit", "step"), ends),
        }
    )
    ax = plot_lines(joint, "joint_stiffness", over="preload", ax=Figure().add_subplot())
    ((line,), (band,)) = ax.lines, ax.collections
    y, unit = band.get_paths()[0].vertices[:, 1], line.get_ydata()[0] / 2e12
    assert unit < 1e-3
    np.testing.assert_allclose([y.min(), y.max()], [1.5e12 * unit, 3.5e12 * unit])
