"""Figures of a measured surface: ``statistics`` follow ``SURFACE_STATISTICS``."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.plotting.figure import add_colour_bar, axes_or_current
from multiscale.surfaces import fit_of_statistics
from multiscale.units import length_unit

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["plot_bearing_curve", "plot_measured_heights", "plot_spectral_density"]

SHOWN = (0.002, 0.998)
"""Quantiles of the heights between which colours differ: a speck of dust takes no colours."""

SHOWN_DENSITY = 1e9
"""Largest over smallest density that is shown: beyond cut-offs there is rounding alone."""


def plot_measured_heights(statistics: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the heights of a map in colours, or of a line scan as a line."""
    ax = axes_or_current(ax)
    size, height = statistics["size"].values, statistics["height"].values
    up, along = length_unit([float(statistics["rms_height"])]), length_unit(size)
    height, (length, width) = up.scale * height, along.scale * size
    if int(statistics["dimensions"]) == 1:
        ax.plot(np.linspace(0.0, length, height.size), height[0], linewidth=0.8)
        ax.set(xlabel=f"x ({along.name})", ylabel=f"height ({up.name})")
        return ax
    level = height - height.mean()
    largest = float(np.abs(np.quantile(level, SHOWN)).max())
    image = ax.imshow(
        level,
        origin="lower",
        extent=(0.0, length, 0.0, width),
        cmap="RdBu_r",
        vmin=-largest,
        vmax=largest,
    )
    add_colour_bar(image, ax, f"height ({up.name})")
    ax.set(xlabel=f"x ({along.name})", ylabel=f"y ({along.name})")
    return ax


def plot_spectral_density(
    statistics: "xr.Dataset", *, measured: bool = True, ax: "Axes | None" = None
) -> "Axes":
    """Plot the spectral density over the wavelength; of a measured surface reliable waves and fit.

    The waves of a cell are all those that it was given.
    """
    ax = axes_or_current(ax)
    map_or_line = int(statistics["dimensions"])
    name = "power_spectral_density" if map_or_line == 2 else "profile_density"
    wave = 2e6 * np.pi / statistics["wavenumber"].values
    ends = [1e6 * float(statistics[f"{end}_reliable"]) for end in ("shortest", "longest")]
    if measured and ends[0] < ends[1]:
        ax.axvspan(*ends, color="0.9", label="reliable waves")
    scale = 1e6 ** (2 + map_or_line)
    density = scale * statistics[name].values
    ax.loglog(wave, density, color="C0", linewidth=1.0, label="measured")
    if measured and (fit := fit_of_statistics(statistics)) is not None:
        q = 2.0 * np.pi / np.geomspace(statistics["longest_reliable"], statistics["fitted_to"], 99)
        q = q[q >= 2.0 * np.pi / float(statistics["longest_wave"])]
        told = f"fit, Hurst exponent {fit.hurst_exponent:.2g}"
        ax.loglog(2e6 * np.pi / q, scale * fit.density(q), "k--", label=told)
    lowest = 0.1 * float(np.min(density[wave >= 0.5 * ends[0]]))
    ax.set_ylim(bottom=max(lowest, float(density.max()) / SHOWN_DENSITY))
    ax.invert_xaxis()
    ax.set(xlabel="wavelength (µm)", ylabel=f"power spectral density (µm$^{2 + map_or_line}$)")
    if measured:
        ax.legend()
    return ax


def plot_bearing_curve(statistics: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the share of the surface that lies at or above each height."""
    ax = axes_or_current(ax)
    share, height = statistics["bearing_share"].values, statistics["bearing_height"].values
    unit = length_unit([float(statistics["rms_height"])])
    ax.plot(100.0 * share, unit.scale * height)
    label = f"height above the mean ({unit.name})"
    ax.set(xlabel="share at or above the height (%)", ylabel=label)
    ax.set_xlim(0.0, 100.0)
    return ax
