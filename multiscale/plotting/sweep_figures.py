"""Figure of a sweep, which follows ``SWEEP``."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.plotting.figure import axes_or_current

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["plot_sweep"]

LARGEST_LEGEND = 10
"""Largest number of points with a legend."""


def plot_sweep(result: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the stiffness of the joint over the preload, a line with its band for each point."""
    import matplotlib

    ax = axes_or_current(ax)
    count = result.sizes["point"]
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, count))
    for k, colour in enumerate(colours):
        point = result.isel(point=k)
        preload = 1e-6 * point["preload"].values
        label = ", ".join(map(str, point["setting"].values)) if count <= LARGEST_LEGEND else None
        ax.plot(preload, 1e-12 * point["joint_stiffness"], "o-", color=colour, label=label)
        low, high = (1e-12 * point[f"joint_stiffness_{end}"].values for end in ("low", "high"))
        ax.fill_between(preload, low, high, color=colour, alpha=0.2, linewidth=0)
    ax.set(xlabel="preload (MPa)", ylabel="joint stiffness (MPa/µm)")
    ax.set_title(", ".join(map(str, result["parameter"].values)), fontsize="small")
    if count <= LARGEST_LEGEND:
        ax.legend(fontsize="small")
    return ax
