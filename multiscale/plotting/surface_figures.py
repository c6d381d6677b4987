"""Figures of measured surfaces, and of heights, contact pressure and leakage of cells."""

from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.plotting.figure import Axes, add_colour_bar, axes_or_current
from multiscale.schema import Dataset
from multiscale.surfaces.statistics import fit_of_statistics
from multiscale.units import length_unit

if TYPE_CHECKING:
    from matplotlib.image import AxesImage

    from multiscale.surfaces.surface import Surface

SHOWN = (0.002, 0.998)
"""Quantiles of the heights at the ends of the colour scale, so that outliers do not stretch it."""

SHOWN_DENSITY = 1e9
"""Largest over smallest shown density; smaller densities are rounding beyond the cut-offs."""

FAINT = 1e-2  # flow over its mean below which a channel is not drawn


def plot_surface(fields: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the heights of the composite surface."""
    title = "sum of the heights of both bodies, first realisation"
    return _show_heights(_edges(fields), fields["height"].values, ax, title)


def plot_road(road: "Surface", *, ax: Axes | None = None) -> Axes:
    """Plot the heights of a road."""
    return _show_heights(np.array(road.size), road.heights.T, ax, "road, realisation 0")


def plot_contact_map(fields: Dataset, *, step: int | None = None, ax: Axes | None = None) -> Axes:
    """Plot the local contact pressure; white where there is no contact.

    Parameters
    ----------
    step : int, optional, load step; the middle step if not given
    """
    from matplotlib.patches import Patch

    step = fields.sizes["step"] // 2 if step is None else step
    pressure = 1e-6 * fields["pressure"].values[step]
    touching = np.where(pressure > 0.0, pressure, np.nan)
    nominal = 1e-6 * float(fields["nominal_pressure"].values[step])
    title = f"contact under a mean pressure of {nominal:.3g} MPa"
    style: dict[str, Any] = {"cmap": "viridis", "vmin": 0.0, "interpolation": "none"}
    image = _show(_edges(fields), touching, ax, title, **style)
    add_colour_bar(image, image.axes, "local pressure (MPa)")
    apart = Patch(facecolor="white", edgecolor="0.5", label="no contact")
    image.axes.legend(handles=[apart], loc="upper right", fontsize="small")
    return image.axes


def plot_measured_heights(statistics: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the heights of a map in colours, or of a line scan as a line."""
    size, height = statistics["size"].values, statistics["height"].values
    if int(statistics["dimensions"]) == 2:
        return _show_heights(size, height, ax, "", SHOWN)
    ax, up, along = axes_or_current(ax), length_unit([float(height.std())]), length_unit(size)
    ax.plot(np.linspace(0.0, along.scale * size[0], height.size), up.scale * height[0], lw=0.8)
    ax.set(xlabel=f"x ({along.name})", ylabel=f"height ({up.name})")
    return ax


def plot_spectral_density(
    statistics: Dataset, *, measured: bool = True, ax: Axes | None = None
) -> Axes:
    """Plot the spectral density over the wavelength, with fit and reliable range if measured."""
    ax = axes_or_current(ax)
    map_or_line = int(statistics["dimensions"])
    name = "power_spectral_density" if map_or_line == 2 else "profile_density"
    wave = 2e6 * np.pi / statistics["wavenumber"].values
    ends = [1e6 * float(statistics[f"{end}_reliable"]) for end in ("shortest", "longest")]
    if measured and ends[0] < ends[1]:
        ax.axvspan(*ends, color="0.9", label="reliable wavelengths")
    scale = 1e6 ** (2 + map_or_line)
    density = scale * statistics[name].values
    ax.loglog(wave, density, color="C0", linewidth=1.0, label="measured")
    if measured and (fit := fit_of_statistics(statistics)) is not None:
        q = 2.0 * np.pi / np.geomspace(statistics["longest_reliable"], statistics["fitted_to"], 99)
        q = q[q >= 2.0 * np.pi / float(statistics["longest_wave"])]
        label = f"fit, Hurst exponent {fit.hurst_exponent:.2g}"
        ax.loglog(2e6 * np.pi / q, scale * fit.density(q), "k--", label=label)
    lowest = 0.1 * float(np.min(density[wave >= 0.5 * ends[0]]))
    ax.set_ylim(bottom=max(lowest, float(density.max()) / SHOWN_DENSITY))
    ax.invert_xaxis()
    ax.set(xlabel="wavelength (µm)", ylabel=f"power spectral density (µm$^{2 + map_or_line}$)")
    if measured:
        ax.legend()
    return ax


def plot_bearing_curve(statistics: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the share of the surface that lies at or above each height."""
    ax = axes_or_current(ax)
    share, height = statistics["bearing_share"].values, statistics["bearing_height"].values
    unit = length_unit([float(statistics["rms_height"])])
    ax.plot(100.0 * share, unit.scale * height)
    label = f"height above the mean ({unit.name})"
    ax.set(xlabel="share at or above the height (%)", ylabel=label)
    ax.set_xlim(0.0, 100.0)
    return ax


def plot_flow_channels(fields: Dataset, *, direction: str = "x", ax: Axes | None = None) -> Axes:
    """Plot the flow along x or y at the highest pressure at which a path leads through a cell."""
    from matplotlib.colors import LogNorm

    from multiscale.micro.averages import gap_flow, open_gap

    gap, pressure = (fields[name].to_numpy().swapaxes(1, 2) for name in ("gap", "pressure"))
    size = _edges(fields)
    spacing = (float(size[0] / gap.shape[1]), float(size[1] / gap.shape[2]))
    nominal = fields["nominal_pressure"].to_numpy()
    for step in np.argsort(-nominal):
        flow = gap_flow(open_gap(gap[step], pressure[step]), spacing, "xy".index(direction))
        if flow.aperture > 0.0:
            break
    title = f"flow along {direction} at {1e-6 * nominal[step]:.3g} MPa; grey: contact"
    touching = np.where(pressure[step].T > 0.0, 1.0, np.nan)
    contact: dict[str, Any] = {"cmap": "Greys", "vmin": 0.0, "vmax": 2.0}
    ax = _show(size, touching, ax, title, interpolation="none", **contact).axes
    speed = np.where(flow.speed > FAINT, flow.speed, np.nan).T
    norm = LogNorm(vmin=FAINT, vmax=max(1.0, float(flow.speed.max())))
    image = _show(size, speed, ax, title, interpolation="none", cmap="Blues", norm=norm)
    add_colour_bar(image, ax, "flow over its mean")
    return ax


def _edges(fields: Dataset) -> np.ndarray:
    return np.array([fields.attrs["size_x"], fields.attrs["size_y"]])


def _show_heights(
    size: np.ndarray,
    height: np.ndarray,
    ax: Axes | None,
    title: str,
    shown: tuple[float, float] = (0.0, 1.0),
) -> Axes:
    """Show heights over their mean, m, with a colour scale between two quantiles."""
    level = height - height.mean()
    largest = float(np.abs(np.quantile(level, shown)).max())
    unit = length_unit([largest])
    ends = unit.scale * largest
    image = _show(size, unit.scale * level, ax, title, cmap="RdBu_r", vmin=-ends, vmax=ends)
    add_colour_bar(image, image.axes, f"height ({unit.name})")
    return image.axes


def _show(
    size: np.ndarray, values: np.ndarray, ax: Axes | None, title: str, **style: Any
) -> "AxesImage":
    ax, unit = axes_or_current(ax), length_unit(size)
    right, top = unit.scale * size
    image = ax.imshow(values, origin="lower", extent=(0.0, right, 0.0, top), **style)
    ax.set(xlabel=f"x ({unit.name})", ylabel=f"y ({unit.name})", title=title)
    return image
