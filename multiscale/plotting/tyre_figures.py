"""Figures of rubber on a road: friction, braking force and footprint.

A ``response`` follows ``MICRO_RESPONSE``, with speeds and temperatures, and a ``result``
``MACRO_RESULT``, with braking forces and tractions.
"""

from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.plotting.figure import Axes, add_colour_bar, axes_or_current
from multiscale.schema import Dataset
from multiscale.units import ZERO_CELSIUS
from multiscale.upscaling import law_band
from multiscale.upscaling.reading import friction_at

__all__ = ["plot_footprint", "plot_friction_bell"]


def plot_friction_bell(
    response: Dataset, law: Dataset, pressure: float, *, ax: Axes | None = None
) -> Axes:
    """Plot friction against speed at every temperature: cells as markers, the law with a band.

    Parameters
    ----------
    law : Dataset
        Follows ``INTERFACE_LAW``; see :func:`multiscale.pipeline.stages.friction_law.fit_friction`.
    pressure : float, pressure, Pa; the figure shows the nearest pressure of the cells
    """
    ax = axes_or_current(ax)
    p, speed = response["nominal_pressure"].values, response["sliding_speed"].values
    nearest = float(p[np.argmin(np.abs(np.log(p / pressure)))])
    along = np.geomspace(speed.min(), speed.max(), 200)
    reference = friction_at(law, float(law.attrs["reference_temperature"]))
    for temperature, colour in _temperatures(response):
        at = (p == nearest) & (response["temperature"].values == temperature)
        shear = response["traction"].isel(component=1).where(response["converged"] == 1)
        mu = shear.values[:, at] / nearest
        ax.errorbar(
            speed[at],
            np.nanmean(mu, axis=0),
            yerr=np.nanstd(mu, axis=0),
            fmt="o",
            markersize=3,
            elinewidth=0.8,
            color=colour,
        )
        shift = friction_at(law, temperature).peak_speed / reference.peak_speed

        def bell(one: Any, shift: float = shift) -> np.ndarray:
            return np.asarray(one.coefficient(nearest, along / shift))

        try:
            low, high = law_band(law, bell)
            ax.fill_between(along, low, high, color=colour, alpha=0.25, linewidth=0)
        except CaseError:  # too few realisations for a band
            pass
        mean = friction_at(law, temperature).coefficient(np.array(nearest), along)
        ax.plot(along, mean, color=colour, label=f"{temperature - ZERO_CELSIUS:.4g} °C")
    ax.set(xscale="log", xlabel="sliding speed (m/s)", ylabel="friction coefficient")
    ax.set_ylim(bottom=0.0)
    ax.set_title(f"friction at {1e-3 * nearest:.4g} kPa: cells and law with 95 % band")
    ax.legend()
    return ax


def plot_footprint(
    result: Dataset, step: int, *, quantity: str = "pressure", ax: Axes | None = None
) -> Axes:
    """Plot the pressure or friction of a tread block on the road; the block moves to the right.

    Parameters
    ----------
    step : int, index of the step
    quantity : {"pressure", "friction"}, normal pressure, or traction against the motion
    """
    ax = axes_or_current(ax)
    one = result.isel(step=step)
    x, y = 1e3 * one["point_position"].values[:, :2].T
    traction = 1e-3 * one["traction"].values
    value = -traction[:, 0] if quantity == "pressure" else traction[:, 1]
    image = ax.tripcolor(x, y, value, shading="gouraud")
    ax.set_aspect("equal")
    ax.set(xlabel="along the motion (mm)", ylabel="across (mm)")
    add_colour_bar(image, ax, f"{quantity} (kPa)")
    ax.set_title(
        f"{quantity} at {float(one['sliding_speed']):.3g} m/s and "
        f"{float(one['temperature']) - ZERO_CELSIUS:.4g} °C"
    )
    return ax


def _temperatures(dataset: Dataset) -> list[tuple[float, str]]:
    """List the temperatures of a dataset, K, with colours from cold to warm."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    found = np.unique(dataset["temperature"].values)
    shades = colormaps["plasma"](np.linspace(0.0, 0.8, found.size))
    return [(float(one), to_hex(shade)) for one, shade in zip(found, shades, strict=True)]
