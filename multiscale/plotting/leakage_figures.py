"""Figures of what an interface lets through: aperture against pressure, and the channels."""

from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.plotting.figure import add_colour_bar, axes_or_current

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["plot_flow_channels", "plot_leakage"]

LEAST = 0.1
"""Lower end of a band on a logarithmic axis over the least value, where it is zero."""

FAINT = 1e-2
"""Flow over its mean below which a channel is not drawn."""


def plot_leakage(law: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot hydraulic apertures of an interface against mean pressure, as far as it is open."""
    ax = axes_or_current(ax)
    pressure = 1e-6 * law["fit_pressure"].to_numpy()
    ax.plot(pressure, 1e6 * law["fit_mean_gap"], color="0.5", label="mean gap")
    aperture = 1e6 * law["hydraulic_aperture"].where(law["hydraulic_aperture"] > 0.0)
    for name, mark in (("x", "o"), ("y", "s")):
        along = aperture.sel(direction=name)
        ax.plot(pressure, along, mark, color="C1", markersize=4, label=f"aperture along {name}")
    both = aperture.sel(direction="both").to_numpy()
    band = 1e6 * law["hydraulic_aperture_mean_law"].sel(direction="both").to_numpy()
    low, high = np.maximum(band, LEAST * np.nanmin(both, initial=np.inf)) + 0.0 * both
    ax.fill_between(pressure, low, high, color="C0", alpha=0.3, linewidth=0, label="95 % band")
    ax.plot(pressure, both, color="C0", label="aperture, both")
    tight = pressure[law["hydraulic_aperture"].sel(direction="both") == 0.0]
    if tight.size:
        ax.axvspan(tight[0], tight[-1], color="0.9", zorder=0, label="tight")
    ax.set(xscale="log", yscale="log", xlabel="mean pressure (MPa)", ylabel="gap, aperture (µm)")
    ax.set_title("what the interface lets through")
    ax.legend()
    return ax


def plot_flow_channels(
    fields: "xr.Dataset", *, direction: str = "x", ax: "Axes | None" = None
) -> "Axes":
    """Plot the flow along x or y at the highest pressure at which a path leads through a cell."""
    from matplotlib.colors import LogNorm

    from multiscale.micro.gap_flow import gap_flow, open_gap

    ax = axes_or_current(ax)
    gap, pressure = (fields[name].to_numpy().swapaxes(1, 2) for name in ("gap", "pressure"))
    size = np.array([fields.attrs["size_x"], fields.attrs["size_y"]])
    spacing = (float(size[0] / gap.shape[1]), float(size[1] / gap.shape[2]))
    nominal = fields["nominal_pressure"].to_numpy()
    for step in np.argsort(-nominal):
        flow = gap_flow(open_gap(gap[step], pressure[step]), spacing, "xy".index(direction))
        if flow.aperture > 0.0:
            break
    drawn: Any = {"origin": "lower", "extent": 1e6 * np.array([0.0, size[0], 0.0, size[1]])}
    touching = np.where(pressure[step].T > 0.0, 1.0, np.nan)
    ax.imshow(touching, cmap="Greys", vmin=0.0, vmax=2.0, interpolation="none", **drawn)
    speed = np.where(flow.speed > FAINT, flow.speed, np.nan).T
    norm = LogNorm(vmin=FAINT, vmax=max(1.0, float(flow.speed.max())))
    image = ax.imshow(speed, cmap="Blues", norm=norm, interpolation="none", **drawn)
    add_colour_bar(image, ax, "flow over its mean")
    ax.set(xlabel="x (µm)", ylabel="y (µm)")
    ax.set_title(f"flow along {direction} at {1e-6 * nominal[step]:.3g} MPa; grey: contact")
    return ax
