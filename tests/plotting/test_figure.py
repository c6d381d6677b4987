"""Common properties of all figures."""

import numpy as np
import pytest
from matplotlib import image

from multiscale.plotting.figure import MARGIN, add_colour_bar, new_figure, save_figure


@pytest.mark.parametrize(("width", "height"), [(1900.0, 150.0), (320.0, 206.0), (50.0, 160.0)])
def test_a_colour_bar_is_as_long_as_its_axes_and_stands_at_them(width, height, tmp_path):
    figure = new_figure()
    ax = figure.add_subplot()
    dots = ax.scatter([0.0, width], [0.0, height], c=[0.0, 1.0])
    ax.set(xlim=(0.0, width), ylim=(0.0, height), xlabel="x (mm)", aspect="equal")
    add_colour_bar(dots, ax, "force (N)")
    save_figure(figure, tmp_path / "bar.png")
    figure.draw_without_rendering()
    axes, bar = ax.get_window_extent(), dots.colorbar.ax.get_window_extent()
    if width > 1.5 * height:
        assert (bar.x0, bar.x1) == pytest.approx((axes.x0, axes.x1))
        assert 0.0 < axes.y0 - bar.y1 < 0.7 * figure.dpi
    else:
        assert (bar.y0, bar.y1) == pytest.approx((axes.y0, axes.y1))
        assert 0.0 < bar.x0 - axes.x1 < 0.2 * figure.dpi
    # nothing is cut off
    whole = ax.get_tightbbox()
    assert min(whole.x0, whole.y0) >= 0.0
    assert whole.x1 <= figure.bbox.x1
    assert whole.y1 <= figure.bbox.y1
    # and no label is covered
    below = dots.colorbar.ax.get_tightbbox()
    assert not below.overlaps(ax.xaxis.label.get_window_extent())


def test_a_flat_map_has_no_white_rows_above_and_below_it(tmp_path):
    figure = new_figure(5.2, 4.0)
    figure.add_subplot().imshow(np.eye(2), extent=(0.0, 10.0, 0.0, 1.0))
    drawn = image.imread(save_figure(figure, tmp_path / "map.png"))[..., :3].min(axis=(1, 2)) < 1.0
    assert drawn.size < 200  # pixels; the figure has 600
    assert drawn[MARGIN]
    assert drawn[-1 - MARGIN :].any()
