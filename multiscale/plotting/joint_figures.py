"""Figures of rough joints: zones of slip, pressure and hysteresis.

A ``result`` follows ``MACRO_RESULT``, with the points of joints.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.plotting.budget_figures import plot_error_budget
from multiscale.plotting.figure import add_colour_bar, axes_or_current, save_figures

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["draw_joint", "plot_hysteresis", "plot_joint_plan"]

ZONES = ("open", "stick", "slip")
"""Names of the values 0, 1 and 2 of ``contact_state``."""

ZONE_COLOURS = ("0.8", "C0", "C3")
"""Colours of the zones."""


def plot_joint_plan(
    result: "xr.Dataset",
    *,
    quantity: str = "contact_state",
    step: int = -1,
    joint: int = 0,
    ax: "Axes | None" = None,
) -> "Axes":
    """Plot the open, sticking and slipping zones of a joint in plan, or its pressure.

    Parameters
    ----------
    quantity : str
        ``"contact_state"`` or ``"pressure"``.
    step : int
        Step; the last one if not given.
    joint : int
        Number of the joint.
    """
    ax = axes_or_current(ax)
    mine = np.flatnonzero(result["point_joint"].values == joint)
    x, y = 1e3 * result["point_position"].values[mine, :2].T
    # each marker fills about its share of the axes
    marker: dict[str, Any] = {
        "s": float(np.clip(3e4 / max(mine.size, 1), 4.0, 200.0)),
        "marker": "s",
    }
    if quantity == "pressure":
        pressure = -1e-6 * result["traction"].values[step, mine, 0]
        dots = ax.scatter(x, y, c=pressure, vmin=0.0, **marker)
    else:
        state, area = result["contact_state"].values[step, mine], result["point_area"].values[mine]
        for value, (name, colour) in enumerate(zip(ZONES, ZONE_COLOURS, strict=True)):
            here = state == value
            label = f"{name}, {100.0 * area[here].sum() / area.sum():.0f} %"
            ax.scatter(x[here], y[here], color=colour, label=label, **marker)
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=3, frameon=False)
    ax.set_aspect("equal")
    ax.set(xlabel="x (mm)", ylabel="y (mm)")
    if quantity == "pressure":
        add_colour_bar(dots, ax, "pressure (MPa)")
    preload, shear = (1e-6 * float(result[name].values[step]) for name in ("preload", "shear"))
    ax.set_title(f"preload {preload:.3g} MPa, shear {shear:.3g} MPa")
    return ax


def plot_hysteresis(result: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the shear of the last cycle over its displacement; the loop encloses the lost energy.

    The elastic displacement, shear over the stiffness without slip, is subtracted: it would hide a
    slender loop, and encloses no area.
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
    caption = "no loss known" if np.isnan(loss) else f"{1e3 * loss:.3g} mJ lost"
    ax.set_title(f"last cycle: {caption}")
    ax.set_xlabel("tangential displacement less the elastic one (µm)")
    ax.set_ylabel("tangential traction (MPa)")
    return ax


def draw_joint(result: "xr.Dataset", folder: Path) -> list[Path]:
    """Draw zones, pressure and, if known, hysteresis and error budget of a joint into PNG files.

    Zones are drawn at the step at which most of the area slips.

    Parameters
    ----------
    folder : Path
        Folder of the files, made if needed.

    Raises
    ------
    CaseError
        If no step has an answer.
    """
    slips = result["slip_fraction"].values
    if np.isnan(slips).all():
        why = result.attrs.get("failure") or result.attrs.get("cautions", "")
        raise CaseError(f"no step has an answer, so that there is no joint to draw: {why}")
    step = int(np.nanargmax(slips))
    draw = {
        "contact_zones": lambda ax: plot_joint_plan(result, step=step, ax=ax),
        "pressure": lambda ax: plot_joint_plan(result, quantity="pressure", step=step, ax=ax),
    }
    if "cycle_energy" in result:
        draw["hysteresis"] = lambda ax: plot_hysteresis(result, ax=ax)
    if "error_total" in result:
        draw["error_budget"] = lambda ax: plot_error_budget(result, ax=ax)
    return save_figures(draw, folder)
