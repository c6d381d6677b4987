"""Figures of cells, heights and contact pressure: ``fields`` follow ``FIELDS``."""

from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.plotting.figure import add_colour_bar, axes_or_current
from multiscale.units import length_unit

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

__all__ = ["plot_contact_map", "plot_surface"]


def plot_surface(fields: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the heights of the composite surface."""
    level = fields["height"].values - fields["height"].values.mean()
    largest = float(np.abs(level).max())
    unit, title = length_unit([largest]), "heights of both bodies together, first realisation"
    ends = unit.scale * largest
    image = _show(fields, unit.scale * level, ax, title, cmap="RdBu_r", vmin=-ends, vmax=ends)
    add_colour_bar(image, image.axes, f"height ({unit.name})")
    return image.axes


def plot_contact_map(
    fields: "xr.Dataset", *, step: int | None = None, ax: "Axes | None" = None
) -> "Axes":
    """Plot the local contact pressure; white where there is no contact.

    Parameters
    ----------
    step : int, optional
        Load step; the middle one if not given.
    """
    from matplotlib.patches import Patch

    step = fields.sizes["step"] // 2 if step is None else step
    pressure = 1e-6 * fields["pressure"].values[step]
    touching = np.where(pressure > 0.0, pressure, np.nan)
    nominal = 1e-6 * float(fields["nominal_pressure"].values[step])
    title = f"contact under a mean pressure of {nominal:.3g} MPa"
    image = _show(fields, touching, ax, title, cmap="viridis", vmin=0.0, interpolation="none")
    add_colour_bar(image, image.axes, "local pressure (MPa)")
    apart = Patch(facecolor="white", edgecolor="0.5", label="no contact")
    image.axes.legend(handles=[apart], loc="upper right", fontsize="small")
    return image.axes


def _show(
    fields: "xr.Dataset", values: np.ndarray, ax: "Axes | None", title: str, **style: Any
) -> "AxesImage":
    """Show values over the cell."""
    ax, edges = axes_or_current(ax), np.array([fields.attrs["size_x"], fields.attrs["size_y"]])
    unit = length_unit(edges)
    right, top = unit.scale * edges
    image = ax.imshow(values, origin="lower", extent=(0.0, right, 0.0, top), **style)
    ax.set(xlabel=f"x ({unit.name})", ylabel=f"y ({unit.name})", title=title)
    return image
