"""Figures of granulates: a ``result`` follows ``GRANULATE``."""

from collections.abc import Callable
from functools import partial

import numpy as np

from multiscale.plotting.figure import (
    Axes,
    add_colour_bar,
    axes_or_current,
)
from multiscale.plotting.lines import plot_lines
from multiscale.plotting.link_figures import plot_energies
from multiscale.schema import Dataset

ANSWERS = ("side_share", "floor_share", "plate_shear", "plate_pressure")
"""Answers of a motion, in addition to the run-out."""


def plot_force_network(
    result: Dataset,
    *,
    frame: int = -1,
    slab: tuple[float, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot grains and contact forces seen along y; the width of a line is its force.

    Parameters
    ----------
    frame : int, number of the frame; the last frame if not given
    slab : tuple of float, optional
        Range of y, m, of the plotted grains and contacts; unlimited if not given.
    """
    from matplotlib.collections import LineCollection, PatchCollection
    from matplotlib.patches import Circle

    ax = axes_or_current(ax)
    frame = range(result.sizes["frame"])[frame]
    low, high = slab if slab is not None else (-np.inf, np.inf)
    position, radius = result["position"].values[frame], result["radius"].values
    shown = (position[:, 1] >= low) & (position[:, 1] <= high)
    circles = [
        Circle((1e3 * x, 1e3 * z), 1e3 * r)
        for (x, _, z), r in zip(position[shown], radius[shown], strict=True)
    ]
    ax.add_collection(PatchCollection(circles, facecolor="0.93", edgecolor="0.75", linewidth=0.3))

    here = result["contact_frame"].values == frame
    first = position[result["contact_ends"].values[here, 0]]
    second = first - result["branch"].values[here]
    force = np.linalg.norm(result["contact_force"].values[here], axis=1)
    inside = (first[:, 1] >= low) & (first[:, 1] <= high)
    inside &= (second[:, 1] >= low) & (second[:, 1] <= high)
    lines = 1e3 * np.stack([first, second], axis=1)[inside][:, :, ::2]
    order = np.argsort(force[inside])
    largest = float(np.quantile(force[inside], 0.99)) if inside.any() else 1.0
    strength = np.clip(force[inside][order] / (largest or 1.0), 0.0, 1.0)
    network = LineCollection(lines[order], linewidths=0.2 + 3.0 * strength, capstyle="round")
    network.set_array(force[inside][order])
    ax.add_collection(network)
    ax.autoscale_view()
    ax.set_aspect("equal")
    ax.set(xlabel="x (mm)", ylabel="z (mm)")
    at = np.append(0.0, result["time"].values)[int(result["frame_step"][frame]) + 1]
    ax.set_title(f"t = {at:.3g} s, {int(inside.sum())} contacts")
    if inside.any() and ax.figure is not None:
        add_colour_bar(network, ax, "force (N)")
    return ax


def plot_contact_error(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the error of the contact solver in every step; missed tolerances have crosses."""
    ax = axes_or_current(ax)
    time, error = result["time"].values, result["residual"].values
    met = result["converged"].values == 1
    ax.semilogy(time[met], error[met], ".", markersize=2, label="tolerance met")
    if not met.all():
        ax.semilogy(time[~met], error[~met], "x", markersize=3, color="C3", label="missed")
    ax.set(xlabel="time (s)", ylabel="error relative to closing velocities")
    ax.legend()
    return ax


def plot_biaxial_curve(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot stress ratio and volumetric strain against the axial strain of a cell."""
    from multiscale.macro.granulate import biaxial_curve

    ax, curve = axes_or_current(ax), biaxial_curve(result)
    strain = 100.0 * curve["axial_strain"].values
    ax.plot(strain, curve["stress_ratio"].values, linewidth=0.8)
    ax.set_xlabel("axial strain (%)")
    ax.set_ylabel("stress ratio q/p", color="C0")
    right = ax.twinx()
    right.plot(strain, 100.0 * curve["volumetric_strain"].values, color="C1")
    right.set_ylabel("volumetric strain (%), compaction positive", color="C1")
    return ax


def _plot_answer(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the answer of a motion over time: load of walls, run-out or stress."""
    if "run_out" in result:
        times = np.append(0.0, result["time"].values)[result["frame_step"].values + 1]
        shown = result[["run_out"]].assign(time=("frame", times))
        return plot_lines(shown.rename(frame="step"), "run_out", over="time", ax=ax)
    return plot_lines(result, *ANSWERS, over="time", ax=ax)


def grain_pictures(result: Dataset) -> dict[str, Callable[..., object]]:
    """Return the plots of grains, by name: answer, forces, energies and solver."""
    y = result["position"].values[-1, :, 1]
    middle, half = 0.5 * (y.min() + y.max()), 2.0 * float(result["radius"].max())
    slab = (float(middle - half), float(middle + half))
    plots: dict[str, Callable[..., object]] = {}
    if any(name in result for name in (*ANSWERS, "run_out")):
        plots["grain_answer"] = partial(_plot_answer, result)
    if "stress" in result:
        plots["biaxial_curve"] = partial(plot_biaxial_curve, result)
    return plots | {
        "force_network": partial(plot_force_network, result, slab=slab),
        "energies": partial(plot_energies, result),
        "contact_error": partial(plot_contact_error, result),
    }
