"""Figures of rough joints: where they slip, and what a cycle costs."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io import make_folder
from multiscale.plotting.budget import plot_error_budget
from multiscale.plotting.figure import axes_or_current, new_figure, save_figure

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["draw_joint", "plot_contact_zones", "plot_hysteresis", "plot_joint_pressure"]

ZONES = ("open", "stick", "slip")
COLOURS = ("0.8", "C0", "C3")


def plot_contact_zones(
    result: "xr.Dataset", *, step: int = -1, joint: int = 0, ax: "Axes | None" = None
) -> "Axes":
    """Plot where a joint is open, sticks and slips, in plan.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``, with the points of joints.
    step : int
        Step; the last one if not given.
    joint : int
        Number of the joint.
    ax : Axes, optional
        Where to draw. The current axes if not given.
    """
    ax = axes_or_current(ax)
    x, y, mine = _plan(result, joint)
    state = result["contact_state"].values[step, mine]
    for value, (name, colour) in enumerate(zip(ZONES, COLOURS, strict=True)):
        here = state == value
        share = result["point_area"].values[mine][here].sum()
        share /= result["point_area"].values[mine].sum()
        label = f"{name}, {100.0 * share:.0f} %"
        ax.scatter(x[here], y[here], s=_marker(mine), color=colour, label=label, marker="s")
    return _finish_plan(result, step, ax, legend=True)


def plot_joint_pressure(
    result: "xr.Dataset", *, step: int = -1, joint: int = 0, ax: "Axes | None" = None
) -> "Axes":
    """Plot the pressure in a joint in plan.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``, with the points of joints.
    step : int
        Step; the last one if not given.
    joint : int
        Number of the joint.
    ax : Axes, optional
        Where to draw. The current axes if not given.
    """
    ax = axes_or_current(ax)
    x, y, mine = _plan(result, joint)
    traction = 1e-6 * result["traction"].values[step, mine]
    dots = ax.scatter(x, y, c=-traction[:, 0], s=_marker(mine), marker="s", vmin=0.0)
    ax.figure.colorbar(dots, ax=ax, label="pressure (MPa)", shrink=0.7)
    return _finish_plan(result, step, ax, legend=False)


def plot_hysteresis(result: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the shear over the displacement that it works on, a closed loop for the energy lost.

    The elastic displacement, shear over the stiffness without slip, is taken off: it would hide
    a slender loop, and encloses nothing.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``, with the cycles of a joint.
    ax : Axes, optional
        Where to draw. The current axes if not given.
    """
    ax = axes_or_current(ax)
    last = result["preload"].values == result["preload"].values[-1]
    sheared = last & (np.cumsum(np.abs(result["shear"].values)) > 0.0)
    first = int(np.flatnonzero(sheared)[0])
    steps = slice(max(first - 1, 0), None)
    stiffness = result["tangential_stiffness"].values[max(first - 1, 0)]
    shear = result["shear"].values[steps]
    slip = result["shear_displacement"].values[steps] - shear / stiffness
    ax.plot(1e6 * slip, 1e-6 * shear, ".-", color="C0", linewidth=1.0, markersize=4)
    loss = result["cycle_energy"].values[-1]
    ax.set_title(f"last cycle: {1e3 * loss:.3g} mJ lost")
    ax.set_xlabel("tangential displacement less the elastic one (µm)")
    ax.set_ylabel("tangential traction (MPa)")
    return ax


def draw_joint(result: "xr.Dataset", folder: Path) -> list[Path]:
    """Draw the figures of a joint into a folder: zones, pressure, loop if cycled, error budget.

    Zones are drawn where most of the area slips.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``, with the points of joints.
    folder : Path
        Made if needed.
    """
    step = int(np.nanargmax(result["slip_fraction"].values))
    folder, files = make_folder(folder), []
    draw = {
        "contact_zones": lambda ax: plot_contact_zones(result, step=step, ax=ax),
        "pressure": lambda ax: plot_joint_pressure(result, step=step, ax=ax),
    }
    if "cycle_energy" in result:
        draw["hysteresis"] = lambda ax: plot_hysteresis(result, ax=ax)
    if "error_total" in result:
        draw["error_budget"] = lambda ax: plot_error_budget(result, ax=ax)
    for name, plot in draw.items():
        figure = new_figure()
        plot(figure.add_subplot())  # type: ignore[no-untyped-call]
        files.append(save_figure(figure, folder / f"{name}.png"))
    return files


def _plan(result: "xr.Dataset", joint: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates of the points of a joint, mm, and their numbers."""
    mine = np.flatnonzero(result["point_joint"].values == joint)
    x, y = 1e3 * result["point_position"].values[mine, :2].T
    return x, y, mine


def _marker(points: np.ndarray) -> float:
    """Area of a marker that fills its share of the axes, about."""
    return float(np.clip(3e4 / max(points.size, 1), 4.0, 200.0))


def _finish_plan(result: "xr.Dataset", step: int, ax: "Axes", *, legend: bool) -> "Axes":
    """Label axes in plan."""
    ax.set_aspect("equal")
    ax.set(xlabel="x (mm)", ylabel="y (mm)")
    preload, shear = (1e-6 * float(result[name].values[step]) for name in ("preload", "shear"))
    ax.set_title(f"preload {preload:.3g} MPa, shear {shear:.3g} MPa")
    if legend:
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=3, frameon=False)
    return ax
