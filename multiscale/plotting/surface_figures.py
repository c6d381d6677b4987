"""Figures of cells, heights and contact pressure: ``fields`` follow ``FIELDS``."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.plotting.figure import axes_or_current

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["plot_contact_map", "plot_surface"]


def plot_surface(fields: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the heights of the composite surface."""
    ax = axes_or_current(ax)
    height = 1e6 * fields["height"].values
    largest = np.abs(height - height.mean()).max()
    image = ax.imshow(
        height - height.mean(),
        origin="lower",
        extent=_extent(fields),
        cmap="RdBu_r",
        vmin=-largest,
        vmax=largest,
    )
    ax.figure.colorbar(image, ax=ax, label="height (µm)")
    ax.set(xlabel="x (µm)", ylabel="y (µm)", title="composite surface, realisation 0")
    return ax


def plot_contact_map(
    fields: "xr.Dataset", *, step: int | None = None, ax: "Axes | None" = None
) -> "Axes":
    """Plot the local contact pressure; white where there is no contact.

    Parameters
    ----------
    step : int, optional
        Load step; the middle one if not given.
    """
    ax = axes_or_current(ax)
    step = fields.sizes["step"] // 2 if step is None else step
    pressure = 1e-6 * fields["pressure"].values[step]
    image = ax.imshow(
        np.where(pressure > 0.0, pressure, np.nan),
        origin="lower",
        extent=_extent(fields),
        cmap="viridis",
        vmin=0.0,
        interpolation="none",
    )
    ax.figure.colorbar(image, ax=ax, label="local pressure (MPa)")
    ax.set(xlabel="x (µm)", ylabel="y (µm)")
    nominal = 1e-6 * float(fields["nominal_pressure"].values[step])
    ax.set_title(f"contact at {nominal:.3g} MPa mean pressure")
    return ax


def _extent(fields: "xr.Dataset") -> tuple[float, float, float, float]:
    return (0.0, 1e6 * fields.attrs["size_x"], 0.0, 1e6 * fields.attrs["size_y"])
