"""Figures of the growth of time and memory with the size of a structure.

``work_precision`` follows ``WORK_PRECISION``, with the number of cables.
"""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.plotting.figure import Axes, axes_or_current, new_figure
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_growth_panels", "plot_growth"]

QUANTITIES = {"wall_time": ("wall time (s)", 1.0), "peak_memory": ("peak memory (MB)", 1e-6)}
"""Label and unit factor of each quantity that can be plotted."""

LEGEND_ROOM = 3.0
"""Factor by which the axis extends above the lines, for the legend."""


def plot_growth(
    work_precision: Dataset, *, quantity: str = "wall_time", ax: Axes | None = None
) -> Axes:
    """Plot time or memory against the number of cables, one line per method and scene.

    A method has one colour; the first scene has filled markers, the other scenes open ones. The
    legend gives the growth of a line between its two largest structures: the slope of the time, or
    the memory per cable, since memory begins with interpreter and libraries. The dotted line is
    proportional to the number of cables. Runs that did not converge are left out.

    Parameters
    ----------
    quantity : str
        ``"wall_time"`` or ``"peak_memory"``.
    """
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    ax = axes_or_current(ax)
    label, factor = QUANTITIES[quantity]
    runs = work_precision.isel(run=np.flatnonzero(work_precision["converged"].values))
    methods, scenes = (list(dict.fromkeys(runs[name].values)) for name in ("method", "scene"))
    cables, cost = runs["cables"].values, runs[quantity].values
    for i, method in enumerate(methods):
        for scene in scenes:
            mine = (runs["method"].values == method) & (runs["scene"].values == scene)
            first = scene == scenes[0]
            ax.plot(
                cables[mine],
                factor * cost[mine],
                "o-" if first else "s--",
                color=f"C{i}",
                markersize=5 if first else 8,
                markerfacecolor=f"C{i}" if first else "none",
                label=f"{method}, {scene}{_growth(quantity, cables[mine], cost[mine])}",
            )
    ax.set(xscale="log", yscale="log")
    low, high = ax.get_ylim()
    ax.set_ylim(low, LEGEND_ROOM * high)
    if high < 100.0 * low:  # few decades: label 1, 2 and 5 of each
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        ax.yaxis.set_minor_formatter(NullFormatter())
    if cables.size:
        _draw_proportion(ax, cables, factor * cost)
    ax.set(xlabel="number of cables", ylabel=label)
    ax.grid(color="0.92")
    ax.legend(loc="upper left", fontsize=8)
    return ax


def draw_growth_panels(work_precision: Dataset) -> "Figure":
    """Draw time and memory side by side."""
    figure = new_figure(11.0, 5.0)
    for ax, quantity in zip(figure.subplots(1, 2), QUANTITIES, strict=True):
        plot_growth(work_precision, quantity=quantity, ax=ax)
    return figure


def _growth(quantity: str, cables: np.ndarray, cost: np.ndarray) -> str:
    """Slope of time, or memory per cable, between the two largest structures; empty for fewer."""
    if cables.size < 2:
        return ""
    last = np.argsort(cables)[-2:]
    if quantity == "wall_time":
        rise, run = (np.diff(np.log(values[last]))[0] for values in (cost, cables))
        return f": slope {rise / run:.2f}"
    rise, run = (np.diff(values[last])[0] for values in (cost, cables))
    return f": {1e-3 * rise / run:.2g} kB per cable"


def _draw_proportion(ax: Axes, cables: np.ndarray, cost: np.ndarray) -> None:
    """Draw a line of slope one below the cheapest run of the largest structure, if in view."""
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    largest = cables.max()
    end = 0.5 * cost[cables == largest].min()
    if end > bottom:
        along = np.array([cables.min(), largest])
        ax.plot(along, end * along / largest, ":", color="0.5", label="slope 1")
        ax.set(xlim=(left, right), ylim=(bottom, top))
