"""Figures of laws of interfaces and of rubber, of the stiffness of joints and of footprints."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.plotting.figure import Axes, add_colour_bar, axes_or_current
from multiscale.plotting.lines import draw_band, draw_bands, plot_lines
from multiscale.schema import SHOWN, Dataset, unit_in
from multiscale.units import ZERO_CELSIUS
from multiscale.upscaling import (
    areas_from_dataset,
    conductance_ratios,
    fitted_laws,
    hysteretic_from_dataset,
    law_band,
    loading_branch,
)
from multiscale.upscaling.reading import frictions_at

BAND_PERCENTILES = (2.5, 97.5)  # percentiles of the 95 % bands
LEAST = 0.1  # lower end of a band on a logarithmic axis over the smallest value, if the end is zero
STATISTICS = ("mean", "std")  # statistics over realisations, drawn as markers with bars


def plot_gap_law(response: Dataset, law: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot pressure against mean gap: realisations as markers, the law as a line with its band."""
    ax = axes_or_current(ax)
    response = loading_branch(response)
    pressure = 1e-6 * response["nominal_pressure"].values
    for gap in 1e6 * response["mean_gap"].values:
        ax.plot(gap, pressure, ".", color="0.6", markersize=4)
    along = 1e-6 * np.geomspace(law.attrs["pressure_min"], law.attrs["pressure_max"], 200)
    laws = fitted_laws(law, [None, *range(law.sizes["sample"])])
    _draw_law(ax, along, [1e6 * sample.gap_at(1e6 * along) for sample in laws], sideways=True)
    ax.set(yscale="log", xlabel="mean gap (µm)", ylabel="mean pressure (MPa)")
    ax.set_title("normal law and realisations")
    return ax


def _draw_law(
    ax: Axes, along: np.ndarray, answers: Sequence[np.ndarray], *, sideways: bool = False
) -> None:
    """Draw the answer of the mean law, the first, as a line, and of its samples as a band."""
    mean, *samples = answers
    if samples:
        draw_band(ax, along, np.percentile(samples, BAND_PERCENTILES, axis=0), sideways=sideways)
    ax.plot(*((mean, along) if sideways else (along, mean)), color="C0", label="law")
    ax.legend()


def plot_unloading(response: Dataset, law: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot pressure against mean gap for unloading from the largest pressure, and for loading."""
    ax = axes_or_current(ax)
    hysteretic = hysteretic_from_dataset(law)
    up = loading_branch(response)
    down = response.drop_sel(step=up["step"].values)
    for branch, colour in ((up, "C0"), (down, "C1")):
        mean, spread = (
            getattr(1e6 * branch["mean_gap"], name)("realisation") for name in STATISTICS
        )
        ax.errorbar(
            mean,
            1e-6 * branch["nominal_pressure"],
            xerr=spread,
            fmt="o",
            markersize=3,
            color=colour,
            elinewidth=0.8,
        )
    pressed, eased = (branch["nominal_pressure"].to_numpy() for branch in (up, down))
    peak = float(law["unloading_peak_pressure"].max())
    along = np.linspace(1e-6 * pressed.min(), 1e-6 * peak, 300)
    ax.plot(1e6 * hysteretic.loading.gap_at(1e6 * along), along, color="C0", label="loading")

    share = np.linspace(eased[eased > 0.0].min() / peak, 1.0, 300)
    corner = float(hysteretic.loading.gap_at(np.array(peak)))
    if law.sizes.get("unloading_sample"):
        names = ("stiffness_ratio", "exponent")
        drawn: Any = {name: law[f"unloading_{name}_sample"].values[:, None] for name in names}
        back = replace(hysteretic, **drawn).recovery(share * peak, np.array(peak))
        ends = 1e6 * (corner + np.percentile(back, BAND_PERCENTILES, axis=0))
        draw_band(ax, 1e-6 * share * peak, ends, "C1", sideways=True)
    ax.plot(
        1e6 * (corner + hysteretic.recovery(share * peak, np.array(peak))),
        1e-6 * share * peak,
        color="C1",
        label=f"unloading: {hysteretic.stiffness_ratio:.3g} times as stiff at first",
    )
    ax.set(xlabel="mean gap (µm)", ylabel="mean pressure (MPa)")
    ax.set_title("normal law with its unloading branch")
    ax.legend()
    return ax


def plot_conductance(law: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot conductance against mean pressure: thermal, or else electrical, with its band."""
    ax = axes_or_current(ax)
    name, ratio = next(iter(conductance_ratios(law).items()))
    unit = SHOWN[name].in_unit(())
    data = law["fit_pressure"].to_numpy()
    along = np.geomspace(data.min(), data.max(), 200)
    laws = fitted_laws(law, [None, *range(law.sizes["sample"])])
    conducted = [unit.scale * ratio * sample.stiffness(sample.gap_at(along)) for sample in laws]
    _draw_law(ax, 1e-6 * along, conducted)
    ax.set(xscale="log", yscale="log", xlabel="mean pressure (MPa)")
    ax.set(ylabel=f"{SHOWN[name].label} ({unit.name})")
    ax.set_title("conductance of the interface")
    return ax


def plot_area_law(response: Dataset, law: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot contact fraction against mean pressure: realisations, and the law with its band."""
    ax = axes_or_current(ax)
    response = loading_branch(response)
    pressure = 1e-6 * response["nominal_pressure"].values
    for fraction in 100.0 * response["contact_fraction"].values:
        ax.plot(pressure, fraction, ".", color="0.6", markersize=4)
    along = np.linspace(0.0, 1e-6 * law.attrs["pressure_max"], 200)
    laws = areas_from_dataset(law, [None, *range(law.sizes["sample"])])
    _draw_law(ax, along, [100.0 * sample.contact_fraction(1e6 * along) for sample in laws])
    ax.set(xlabel="mean pressure (MPa)", ylabel="real over nominal contact area (%)")
    ax.set_title("area law and realisations")
    return ax


def plot_leakage(law: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot hydraulic apertures of an interface against mean pressure, where it is open."""
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
    draw_band(ax, pressure, np.array([low, high]))
    ax.plot(pressure, both, color="C0", label="aperture, both")
    tight = pressure[law["hydraulic_aperture"].sel(direction="both") == 0.0]
    if tight.size:
        ax.axvspan(tight[0], tight[-1], color="0.9", zorder=0, label="tight")
    ax.set(xscale="log", yscale="log", xlabel="mean pressure (MPa)", ylabel="gap, aperture (µm)")
    ax.set_title("hydraulic aperture of the interface")
    ax.legend()
    return ax


def plot_shear_law(law: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot tangential traction over full slip against slip, of sheared cells and of the bed."""
    ax = axes_or_current(ax)
    pressure, friction = law["shear_pressure"].values, float(law["shear_friction"])
    slip = law["shear_slip"].values
    along = np.abs(slip).argmax(axis=1)
    for at, colour in zip(np.unique(pressure), cycle(f"C{k}" for k in range(10)), strict=False):
        for axis, mark, line in ((0, "o", "-"), (1, "s", "--")):
            sheared = (pressure == at) & (along == axis)
            if not np.any(sheared):
                continue
            length = 1e6 * np.append(0.0, slip[sheared, axis])
            cells, bed = (
                np.append(0.0, law[name].values[sheared, axis]) / (friction * at)
                for name in ("shear_traction", "shear_bed_traction")
            )
            ax.plot(length, cells, mark, color=colour, markersize=4)
            ax.plot(length, bed, line, color=colour, label=f"{1e-6 * at:.3g} MPa, {'xy'[axis]}")
    ax.set(xlabel="slip (µm)", ylabel="traction over full slip", title="sheared cells and bed")
    ax.legend()
    return ax


def plot_joint_stiffness(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the stiffness of a joint, of its interface and of its bodies against the preload."""
    known = result.isel(step=np.flatnonzero(result["joint_stiffness"].notnull()))
    needed = [str(known[f"{name}_stiffness"].name) for name in ("joint", "interface", "solid")]
    ax = plot_lines(known, needed[0], "unloading_stiffness", *needed[1:], ax=ax)
    preload, unit = unit_in(known, "preload"), unit_in(known, "joint_stiffness")
    draw_bands(known, "joint_stiffness", preload.shown(known["preload"]), ax, unit.scale)
    ax.set(xscale="log", yscale="log", title="joint stiffness")
    ax.legend()
    return ax


def plot_friction_bell(
    response: Dataset, law: Dataset, pressure: float, *, ax: Axes | None = None
) -> Axes:
    """Plot friction against speed at every temperature: cells as markers, the law with a band."""
    ax = axes_or_current(ax)
    p, speed = response["nominal_pressure"].values, response["sliding_speed"].values
    nearest = float(p[np.argmin(np.abs(np.log(p / pressure)))])
    along = np.geomspace(speed.min(), speed.max(), 200)
    (reference,) = frictions_at(law, float(law.attrs["reference_temperature"]), [None])
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
        (at_temperature,) = frictions_at(law, temperature, [None])
        shift = at_temperature.peak_speed / reference.peak_speed

        def bell(sample: Any, shift: float = shift) -> np.ndarray:
            return np.asarray(sample.coefficient(nearest, along / shift))

        try:
            ends = np.array(law_band(law, bell))
            draw_band(ax, along, ends, colour, alpha=0.25, label=None)
        except CaseError:  # too few realisations for a band
            pass
        mean = at_temperature.coefficient(np.array(nearest), along)
        ax.plot(along, mean, color=colour, label=f"{temperature - ZERO_CELSIUS:.4g} °C")
    ax.set(xscale="log", xlabel="sliding speed (m/s)", ylabel="friction coefficient")
    ax.set_ylim(bottom=0.0)
    ax.set_title(f"friction at {1e-3 * nearest:.4g} kPa: cells and law with 95 % band")
    ax.legend()
    return ax


def plot_footprint(
    result: Dataset, step: int, *, quantity: str = "pressure", ax: Axes | None = None
) -> Axes:
    """Plot the pressure or friction of a tread block on the road; the block moves to the right."""
    ax = axes_or_current(ax)
    at = result.isel(step=step)
    x, y = 1e3 * at["point_position"].values[:, :2].T
    traction = 1e-3 * at["traction"].values
    value = -traction[:, 0] if quantity == "pressure" else traction[:, 1]
    image = ax.tripcolor(x, y, value, shading="gouraud")
    ax.set_aspect("equal")
    ax.set(xlabel="along the motion (mm)", ylabel="across (mm)")
    add_colour_bar(image, ax, f"{quantity} (kPa)")
    ax.set_title(
        f"{quantity} at {float(at['sliding_speed']):.3g} m/s and "
        f"{float(at['temperature']) - ZERO_CELSIUS:.4g} °C"
    )
    return ax


def _temperatures(dataset: Dataset) -> list[tuple[float, str]]:
    """List the temperatures of a dataset, K, with colours from cold to warm."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    values = np.unique(dataset["temperature"].values)
    shades = colormaps["plasma"](np.linspace(0.0, 0.8, values.size))
    return [(float(value), to_hex(shade)) for value, shade in zip(values, shades, strict=True)]
