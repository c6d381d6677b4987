"""Figures of structures of links: a ``result`` follows ``MACRO_RESULT``, with links."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.plotting.figure import (
    Axes,
    axes_or_current,
    set_box,
)
from multiscale.schema import SHOWN, Dataset

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

ENERGIES = (
    "kinetic_energy",
    "elastic_energy",
    "link_dissipation",
    "contact_dissipation",
    "numerical_dissipation",
    "damping_dissipation",
)
"""Terms of the energy balance of a motion."""


MOST_LINES = 12  # in a figure of the tensions


def plot_sorted_tensions(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the tensions of cables in falling order at up to 12 converged steps, a line each."""
    from matplotlib import colormaps

    ax = axes_or_current(ax)
    tension = 1e-3 * result["tension"].values[:, result["law"].values == "cable"]
    name, symbol, unit = _step_coordinate(result)
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(tension)))
    rank = np.arange(1, tension.shape[1] + 1)
    steps = np.flatnonzero(result["converged"].values)
    few = np.linspace(0, max(steps.size - 1, 0), min(steps.size, MOST_LINES)).round().astype(int)
    for k in steps[few]:
        at = float(result[name][k])
        ax.plot(
            rank, np.sort(tension[k])[::-1], color=colours[k], label=f"{symbol} = {at:.3g}{unit}"
        )
    ax.set(xlabel="cables, sorted (number)", ylabel="tension (kN)")
    ax.legend()
    return ax


def plot_deformed_links(
    result: Dataset, *, ax: "Axes3D", step: int = -1, scale: float = 1.0
) -> "Axes3D":
    """Plot the deformed structure coloured by tension; slack links are dashed in black.

    With compression, which is negative, the colours diverge from zero.

    Parameters
    ----------
    ax : Axes3D, where to draw
    step : int, step; the last step if not given
    scale : float, factor of the displacements
    """
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    shown = result.isel(step=step)
    moved = shown["position"].values + scale * shown["displacement"].values
    lines, tension = moved[shown["ends"].values], 1e-3 * shown["tension"].values
    slack = shown["slack"].values > 0.0
    largest, signed = float(np.abs(tension).max()) or 1.0, bool(tension.min() < 0.0)
    taut = Line3DCollection(
        lines[~slack], cmap="coolwarm" if signed else "viridis_r", linewidths=1.2
    )
    taut.set_array(tension[~slack])
    taut.set_clim(-largest if signed else 0.0, largest)
    ax.add_collection3d(taut)
    if slack.any():
        ax.add_collection3d(
            Line3DCollection(
                lines[slack], colors="black", linestyles="dashed", linewidths=0.8, label="slack"
            )
        )
        ax.legend(loc="lower left")
    set_box(ax, moved.min(axis=0), moved.max(axis=0))
    ax.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    ax.figure.colorbar(taut, ax=ax, label="tension (kN)", shrink=0.6, pad=0.12)
    name, symbol, unit = _step_coordinate(result)
    ax.set_title(f"{symbol} = {float(shown[name]):.3g}{unit}, displacements times {scale:.3g}")
    return ax


def plot_past_limit(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the load factor of a path over the displacement of the node that the mode moves most.

    The displacement is along the critical mode; states that are not stable are dashed.
    """
    ax = axes_or_current(ax)
    mode = result["critical_mode"].values
    node = int(np.argmax(np.linalg.norm(mode, axis=1)))
    along = mode[node] / np.linalg.norm(mode[node])
    moved, factor = result["displacement"].values[:, node, :3] @ along, result["load_factor"].values
    critical = int(np.argmin(np.abs(factor - float(result["critical_factor"]))))
    moved = moved * (np.sign(moved[critical]) or 1.0)
    unstable = result["stability_eigenvalue"].values < 0.0
    line = ax.plot(1e3 * moved, np.where(unstable, np.nan, factor), label="stable")[0]
    after = unstable | np.append(unstable[1:], False) | np.append(False, unstable[:-1])
    ax.plot(
        1e3 * moved, np.where(after, factor, np.nan), "--", color=line.get_color(), label="unstable"
    )
    ax.plot(1e3 * moved[critical], factor[critical], "ko", label=result.attrs["critical"])
    ax.set(xlabel=f"displacement of node {node} along the mode (mm)", ylabel="load factor")
    ax.legend()
    return ax


def plot_energies(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the terms of the energy balance of a moving structure or of grains over time.

    With the negative work of the loads their sum is constant. Terms that are always zero are left
    out.
    """
    ax, time = axes_or_current(ax), result["time"].to_numpy()
    contacts = "contact_dissipation" in result  # includes their elastic energy
    names = [name for name in ENERGIES if name in result]
    names = [name for name in names if not (contacts and name == "elastic_energy")]
    terms = {SHOWN[name].label: result[name].to_numpy() for name in names}
    terms["work, negative"] = -result["work"].to_numpy()
    for label, energy in terms.items():
        if np.nanmax(np.abs(energy)) > 0.0:
            ax.plot(time, energy, label=label)
    ax.plot(time, np.sum([*terms.values()], axis=0), "k--", label="sum")
    ax.set(xlabel="time (s)", ylabel="energy (J)")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    return ax


def _step_coordinate(result: Dataset) -> tuple[str, str, str]:
    """Name, symbol and unit of the coordinate of the steps."""
    return ("time", "t", " s") if "time" in result.coords else ("load_factor", "α", "")
