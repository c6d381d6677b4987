"""Figures of ``WORK_PRECISION``: error against run time, growth of time and memory with sizes."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.plotting.figure import Axes, axes_or_current, new_figure, save_figure
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from matplotlib.artist import Artist

QUANTITIES = {"wall_time": ("wall time (s)", 1.0), "peak_memory": ("peak memory (MB)", 1e-6)}
"""Label and unit factor of each quantity that can be plotted."""

SETTINGS = ("points", "realisations", "time_step", "tolerance")
"""Variables that label the runs of a method; the first in the dataset is used."""

SMALLEST_ERROR = 1e-17  # value at which an error of zero is drawn, dimensionless
LEGEND_ROOM = 0.055  # share of the axis that the legend of the lines of growth takes for each line


def plot_work_precision(
    work_precision: Dataset,
    *,
    scene: str | None = None,
    error: str = "error",
    ax: Axes | None = None,
) -> Axes:
    """Plot error against run time, one line per method; dashed, against the limit of the method.

    Differences below the uncertainty of the reference, drawn as a band, are not significant. Points
    are labelled with the ratio of scales or with their resolution, if known; runs that did not
    converge are left out.

    Parameters
    ----------
    scene : str, optional, plotted scene; all scenes if not given
    error : str
        Variable to plot. ``own_ERROR`` is the error against the limit of the method, and
        ``ERROR_uncertainty`` the uncertainty of the reference.
    """
    ax = axes_or_current(ax)
    runs = work_precision
    if scene is not None:
        runs = runs.isel(run=np.flatnonzero(runs["scene"].values == scene))
        ax.set_title(scene)
    for k, method in enumerate(dict.fromkeys(runs["method"].values)):
        method_runs = runs.isel(run=np.flatnonzero(runs["method"].values == method))
        time = method_runs["wall_time"].values
        ax.plot(time, method_runs[error].values, "o-", color=f"C{k}", label=method)
        if f"own_{error}" in method_runs:
            limit_error = method_runs[f"own_{error}"].values
            ax.plot(time, limit_error, "--", color=f"C{k}", linewidth=0.8)
        for run, label in enumerate(_labels(method_runs)):
            ax.annotate(
                label,
                (time[run], float(method_runs[error][run])),
                xytext=(3, 3),
                textcoords="offset points",
                fontsize=6,
                color=f"C{k}",
            )
    ax.margins(0.1)  # room for the labels of points
    ax.set(xscale="log", yscale="log")
    if f"{error}_uncertainty" in runs and (runs[f"{error}_uncertainty"] > 0.0).any():
        low, high = ax.get_ylim()
        uncertainty = float(runs[f"{error}_uncertainty"].max())
        low = min(low, 0.5 * uncertainty)
        ax.axhspan(0.1 * low, uncertainty, color="0.9", linewidth=0)
        ax.set_ylim(low, high)
    ax.set(xlabel="wall time (s)", ylabel=runs[error].attrs["long_name"])
    return ax


def _labels(runs: Dataset) -> list[str]:
    """Ratio of scales or setting of every run; empty if the dataset has neither."""
    if "scale_ratio" in runs:
        return [f"1/{round(1.0 / ratio)}" for ratio in runs["scale_ratio"].values]
    known = next((name for name in SETTINGS if name in runs), None)
    if known is None:
        return []
    return [f"{value:g}" if value > 0.0 else "" for value in runs[known].values]


def plot_history(work_precision: Dataset, *, scene: str, ax: Axes | None = None) -> Axes:
    """Plot the smallest error so far against time by method; open markers did not converge."""
    ax = axes_or_current(ax)
    methods = list(dict.fromkeys(work_precision["method"].values))
    for k in np.flatnonzero(work_precision["scene"].values == scene):
        run = work_precision.isel(run=k)
        rank = methods.index(run["method"].item())
        color = "black" if rank == 0 else f"C{rank - 1}"
        samples = work_precision["history_run"].values == k
        error = np.fmin.accumulate(work_precision["history_error"].values[samples])
        time = [*work_precision["history_seconds"].values[samples], float(run["wall_time"])]
        error = np.maximum([*error, float(run["error"])], SMALLEST_ERROR)
        ax.plot(time, error, color=color, label=methods[rank])
        face = color if run["converged"] else "white"
        ax.plot(time[-1], error[-1], "o", color=color, markerfacecolor=face)
        ax.axhline(float(run["tolerance"]), color="0.6", linestyle=":", linewidth=0.8)
    ax.set(xscale="log", yscale="log")
    ax.set_title(scene, fontsize="medium")
    ax.set(xlabel="time since the start (s)", ylabel="relative error (1)")
    return ax


def draw_work_precision(work_precision: Dataset, file: Path) -> Path:
    """Draw bench results into a PNG file.

    With histories each scene has a panel, in rows of three, and the growth of the time with the
    structures of known size another; with sizes only the panels show the growth of time and memory;
    otherwise scenes stand side by side, errors below each other.
    """
    scenes = list(dict.fromkeys(work_precision["scene"].values))
    if "history_error" in work_precision:
        grows = "cables" in work_precision
        rows = -(-(len(scenes) + grows) // 3)
        figure = new_figure(13.8, 3.4 * rows + 0.6)
        panels = figure.subplots(rows, 3, squeeze=False).ravel()
        lines: dict[str, Artist] = {}
        for ax, scene in zip(panels, scenes, strict=False):
            plot_history(work_precision, scene=scene, ax=ax)
            handles, labels = ax.get_legend_handles_labels()
            lines |= dict(zip(labels, handles, strict=True))
        for ax in panels[len(scenes) :]:
            ax.set_axis_off()
        if grows:
            panels[-1].set_axis_on()
            sized = work_precision.isel(run=np.isfinite(work_precision["cables"].values))
            plot_growth(sized.assign(scene=("run", ["grids"] * sized.sizes["run"])), ax=panels[-1])
        title = "filled: converged; open: not converged; dotted: tolerance"
        figure.legend([*lines.values()], [*lines], loc="outside lower center", ncols=6, title=title)
    elif size := work_precision.attrs.get("growth"):
        figure = new_figure(11.0, 5.0)
        for ax, quantity in zip(figure.subplots(1, 2), QUANTITIES, strict=True):
            plot_growth(work_precision, quantity=quantity, size=size, ax=ax)
    else:
        shown = [name for name in ("error", "contact_error", "over_copy") if name in work_precision]
        errors = [name for name in shown if work_precision[name].notnull().any()]
        figure = new_figure(4.6 * len(scenes), 3.6 * len(errors))
        panels = figure.subplots(len(errors), len(scenes), squeeze=False)
        for row, error in zip(panels, errors, strict=True):
            for ax, scene in zip(row, scenes, strict=True):
                plot_work_precision(work_precision, scene=scene, error=error, ax=ax)
        panels[0, 0].legend(fontsize=7)
    return save_figure(figure, file)


def plot_growth(
    work_precision: Dataset,
    *,
    quantity: str = "wall_time",
    size: str = "cables",
    ax: Axes | None = None,
) -> Axes:
    """Plot time or memory against cables or unknowns by method, with its growth in the legend."""
    ax = axes_or_current(ax)
    label, factor = QUANTITIES[quantity]
    runs = work_precision.isel(run=np.flatnonzero(work_precision["converged"].values))
    methods, scenes = (list(dict.fromkeys(runs[name].values)) for name in ("method", "scene"))
    sizes, cost = runs[size].values, runs[quantity].values
    for i, method in enumerate(methods):
        for scene in scenes:
            chosen = (runs["method"].values == method) & (runs["scene"].values == scene)
            if not chosen.any():
                continue
            first = scene == scenes[0]
            ax.plot(
                sizes[chosen],
                factor * cost[chosen],
                "o-" if first else "s--",
                color=f"C{i}",
                markersize=5 if first else 8,
                markerfacecolor=f"C{i}" if first else "none",
                label=f"{method}, {scene}{_growth(quantity, sizes[chosen], cost[chosen], size)}",
            )
    ax.set(xscale="log", yscale="log", xlabel=f"number of {size}", ylabel=label)
    if sizes.size:
        along = np.array([sizes.min(), sizes.max()])
        lowest = factor * cost[sizes == along[1]].min()  # the line ends at half of it
        view = ax.get_ylim()
        ax.plot(along, 0.5 * lowest * along / along[1], ":", color="0.5", label="slope 1")
        low, room = min(view[0], 0.4 * lowest), LEGEND_ROOM * len(ax.lines)
        ax.set_ylim(low, low * (view[1] / low) ** (1.0 / (1.0 - room)))
    ax.grid(color="0.92")
    ax.legend(loc="upper left", fontsize=8)
    return ax


def _growth(quantity: str, sizes: np.ndarray, cost: np.ndarray, size: str) -> str:
    """Slope of time, or memory of a cable or unknown, between the two largest structures."""
    if sizes.size < 2:
        return ""
    last = np.argsort(sizes)[-2:]
    if quantity == "wall_time":
        rise, run = (np.diff(np.log(values[last]))[0] for values in (cost, sizes))
        return f": slope {rise / run:.2f}"
    rise, run = (np.diff(values[last])[0] for values in (cost, sizes))
    return f": {1e-3 * rise / run:.2g} kB per {size[:-1]}"
