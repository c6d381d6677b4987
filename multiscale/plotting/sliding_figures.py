"""Figures of sliding cells: a ``response`` follows ``SLIDING_RESPONSE``."""

from pathlib import Path

import numpy as np

from multiscale.plotting.figure import Axes, axes_or_current, new_figure, save_figure
from multiscale.schema import Dataset

__all__ = ["draw_sliding", "plot_sliding_friction", "plot_steady_friction"]


def plot_sliding_friction(response: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot friction against the sliding distance, a line per pressure, darker at lower ones."""
    from matplotlib import colormaps

    ax = axes_or_current(ax)
    distance = 1e6 * response["sliding_distance"].values
    pressure = 1e-6 * response["nominal_pressure"].values
    shades = colormaps["viridis"](np.linspace(0.0, 0.85, pressure.size))
    for one, friction, shade in zip(
        pressure, response["effective_friction"].values, shades, strict=True
    ):
        ax.plot(distance, friction, ".-", color=shade, markersize=4, label=f"{one:.3g} MPa")
    ax.axhline(0.0, color="0.7", linewidth=0.5)
    ax.set(
        xlabel="sliding distance (µm)", ylabel="effective friction", title="friction of the cell"
    )
    ax.legend(title="mean pressure", fontsize="small")
    return ax


def plot_steady_friction(response: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the mean friction over the last period against pressure."""
    ax = axes_or_current(ax)
    ax.plot(1e-6 * response["nominal_pressure"].values, response["steady_friction"].values, "o-")
    ax.set(xlabel="mean pressure (MPa)", ylabel="mean friction over the last period")
    ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))
    ax.set_title("friction against pressure")
    return ax


def draw_sliding(response: Dataset, file: Path) -> Path:
    """Draw friction against distance and against pressure, and write the figure."""
    figure = new_figure(9.0, 3.8)
    left, right = figure.subplots(1, 2)
    plot_sliding_friction(response, ax=left)
    plot_steady_friction(response, ax=right)
    return save_figure(figure, file)
