"""Figures of structures of links: a ``result`` follows ``MACRO_RESULT``, with links."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io import make_folder
from multiscale.plotting.figure import (
    Axes,
    axes_or_current,
    new_figure,
    plot_energy_parts,
    save_figure,
    set_box,
)
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

__all__ = ["draw_links", "plot_deformed_links", "plot_energies", "plot_sorted_tensions"]


def plot_sorted_tensions(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the tensions of cables in falling order, one line for each converged step."""
    from matplotlib import colormaps

    ax = axes_or_current(ax)
    tension = 1e-3 * result["tension"].values[:, result["law"].values == "cable"]
    name, symbol, unit = _step_coordinate(result)
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(tension)))
    rank = np.arange(1, tension.shape[1] + 1)
    for k in np.flatnonzero(result["converged"].values):
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
    step : int, step; the last one if not given
    scale : float, factor of the displacements
    """
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    one = result.isel(step=step)
    moved = one["position"].values + scale * one["displacement"].values
    lines, tension = moved[one["ends"].values], 1e-3 * one["tension"].values
    slack = one["slack"].values > 0.0
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
    ax.set_title(f"{symbol} = {float(one[name]):.3g}{unit}, displacements times {scale:g}")
    return ax


def plot_energies(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the parts of the energy of a moving structure, and their sum, which is constant."""
    parts = {
        "kinetic": "kinetic_energy",
        "elastic": "elastic_energy",
        "lost to the time scheme": "numerical_dissipation",
        "lost in the links": "link_dissipation",
    }
    return plot_energy_parts(result, parts, "work of the loads, negative", ax)


def draw_links(result: Dataset, folder: Path, *, scale: float = 1.0) -> list[Path]:
    """Draw the figures of a result into PNG files.

    Parameters
    ----------
    folder : Path
        Folder, made if needed, for the deformed structure, and for the sorted tensions or, of a
        motion, the energies.
    scale : float, factor of the displacements
    """
    make_folder(folder)
    figure = new_figure()
    ax = figure.add_subplot()
    if "time" in result.coords:
        plot_energies(result, ax=ax)
        first = save_figure(figure, folder / "energies.png")
    else:
        plot_sorted_tensions(result, ax=ax)
        first = save_figure(figure, folder / "sorted_tensions.png")
    figure = new_figure(7.5, 5.5)
    ax = figure.add_subplot(projection="3d")
    plot_deformed_links(result, scale=scale, ax=ax)
    return [first, save_figure(figure, folder / "deformed_links.png")]


def _step_coordinate(result: Dataset) -> tuple[str, str, str]:
    """Name, symbol and unit of the coordinate of the steps."""
    return ("time", "t", " s") if "time" in result.coords else ("load_factor", "α", "")
