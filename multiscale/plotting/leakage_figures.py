"""Figures of what an interface lets through: aperture against pressure, and the channels."""

from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.micro.gap_flow import gap_flow, open_gap
from multiscale.plotting.figure import axes_or_current

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["plot_flow_channels", "plot_leak_rate", "plot_leakage"]

LINES = {"x": "o--", "y": "s:", "both": "-"}
"""Marks of the flow along x, along y, and of both together."""

LEAST = 0.1
"""Lower end of a band on a logarithmic axis over the least value, where it is zero."""

FAINT = 1e-2
"""Speed over the mean one below which a channel is not drawn."""


def plot_leakage(law: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot hydraulic aperture against mean pressure along x, y and both, as far as it is open.

    Parameters
    ----------
    law : Dataset
        Follows ``INTERFACE_LAW``, with hydraulic apertures.
    """
    ax = axes_or_current(ax)
    pressure = 1e-6 * law["fit_pressure"].to_numpy()
    ax.plot(pressure, 1e6 * law["fit_mean_gap"].to_numpy(), color="0.5", label="mean gap")
    for name, line in LINES.items():
        one = law.sel(direction=name)
        aperture = 1e6 * one["hydraulic_aperture"].to_numpy()
        opened = aperture > 0.0
        label = f"aperture along {name}" if name != "both" else "aperture, both"
        colour = "C0" if name == "both" else "C1"
        ax.plot(pressure[opened], aperture[opened], line, color=colour, markersize=4, label=label)
        if name == "both" and one.sizes["sample"]:
            drawn = 1e6 * one["hydraulic_aperture_sample"].to_numpy()[:, opened]
            low, high = np.percentile(drawn, (2.5, 97.5), axis=0)
            low = np.maximum(low, LEAST * aperture[opened].min(initial=np.inf))
            ax.fill_between(
                pressure[opened],
                low,
                high,
                color=colour,
                alpha=0.3,
                linewidth=0,
                label="95 % band",
            )
    _shade_tight(law["fit_pressure"], one["hydraulic_aperture"], ax)
    ax.set(xscale="log", yscale="log", xlabel="mean pressure (MPa)", ylabel="gap, aperture (µm)")
    ax.set_title("what the interface lets through")
    ax.legend()
    return ax


def plot_leak_rate(result: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the leak rate of a ring against its pressure, as far as it leaks; see ``SEAL``."""
    ax = axes_or_current(ax)
    leaking = result.isel(step=np.flatnonzero(result["leak_rate"] > 0.0))
    pressure, rate = 1e-6 * leaking["nominal_pressure"].to_numpy(), 3.6e9 * leaking["leak_rate"]
    if "leak_rate_mean_law" in result and pressure.size:
        low, high = 3.6e9 * leaking["leak_rate_mean_law"].to_numpy()
        low = np.maximum(low, LEAST * rate.to_numpy().min())
        ax.fill_between(pressure, low, high, color="C0", alpha=0.3, linewidth=0, label="95 % band")
    ax.plot(pressure, rate, "o-", color="C0", label="leak rate")
    _shade_tight(result["nominal_pressure"], result["leak_rate"], ax)
    ax.set(xscale="log", yscale="log", xlabel="mean pressure (MPa)", ylabel="leak rate (ml/h)")
    ax.set_title("leak rate of the ring")
    ax.legend()
    return ax


def _shade_tight(pressure: "xr.DataArray", passing: "xr.DataArray", ax: "Axes") -> None:
    """Shade the pressures at which nothing passes."""
    tight = 1e-6 * pressure.to_numpy()[passing.to_numpy() == 0.0]
    if tight.size:
        ax.axvspan(tight[0], tight[-1], color="0.9", zorder=0, label="tight")


def plot_flow_channels(fields: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the flow along x at the highest pressure at which a path leads through realisation 0.

    Parameters
    ----------
    fields : Dataset
        Follows ``FIELDS``.
    """
    from matplotlib.colors import LogNorm

    ax = axes_or_current(ax)
    gap, pressure = (fields[name].to_numpy().swapaxes(1, 2) for name in ("gap", "pressure"))
    size = fields.attrs["size_x"], fields.attrs["size_y"]
    spacing = size[0] / gap.shape[1], size[1] / gap.shape[2]
    nominal = 1e-6 * fields["nominal_pressure"].to_numpy()
    for step in np.argsort(-nominal):
        flow = gap_flow(open_gap(gap[step], pressure[step]), spacing, 0)
        if flow.aperture > 0.0:
            break
    extent = (0.0, 1e6 * size[0], 0.0, 1e6 * size[1])
    touching = np.where(pressure[step].T > 0.0, 1.0, np.nan)
    common: Any = {"origin": "lower", "extent": extent, "interpolation": "none"}
    ax.imshow(touching, cmap="Greys", vmin=0.0, vmax=2.0, **common)
    speed = np.where(flow.speed > FAINT, flow.speed, np.nan)
    image = ax.imshow(speed.T, cmap="Blues", norm=LogNorm(vmin=FAINT), **common)
    ax.figure.colorbar(image, ax=ax, label="flow over its mean")
    ax.set(xlabel="x (µm)", ylabel="y (µm)")
    ax.set_title(f"flow along x at {nominal[step]:.3g} MPa; grey: contact")
    return ax
