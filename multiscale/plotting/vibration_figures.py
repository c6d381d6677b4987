"""Figures of a ``VIBRATION``: shapes of modes, frequency and damping, pressure and slip."""

from collections.abc import Callable
from functools import partial

import numpy as np

from multiscale.plotting.figure import Axes, add_colour_bar, axes_or_current, outer_faces
from multiscale.plotting.joint_figures import draw_points
from multiscale.plotting.lines import plot_lines
from multiscale.schema import Dataset
from multiscale.units import Unit, length_unit

LEAN = 0.12
"""Largest displacement in a figure of a mode, relative to the longest edge of the structure."""

QUANTITIES = ("frequency", "damping")  # quantities of backbones

AT_POINTS = {
    "pressure": ("pressure", Unit("MPa", 1e-6)),
    "slipping": ("pressure at sliding", Unit("%", 100.0)),
}
"""Quantities of the points of joints, their names and units."""


def plot_backbone(
    result: Dataset,
    *,
    quantity: str = "frequency",
    mode: int | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot frequency or damping of a mode, the first mode if not given, against its amplitude."""
    number = int(result["step_mode"][0]) if mode is None else mode
    backbone = result.isel(step=np.flatnonzero(result["step_mode"] == number))
    ax = plot_lines(backbone, quantity, ax=ax, xscale="log", title=f"mode {number}")
    if quantity == "frequency":
        still = float(result["mode_frequency"].sel(mode=number))
        ax.axhline(still, color="0.6", linewidth=0.8, label="at rest")
        ax.legend(fontsize="small")
    return ax


def plot_mode_shape(result: Dataset, *, mode: int = 1, ax: Axes | None = None) -> Axes:
    """Plot the bodies moved by a mode, seen across the plane of its largest motion."""
    from matplotlib.collections import PolyCollection

    ax = axes_or_current(ax)
    shape, place = result["shape"].sel(mode=mode).values, result["position"].values
    extent, motion = np.ptp(place, axis=0), np.abs(shape).max(axis=0)
    along = int(np.argmax(extent))
    across = int(np.argmax(np.where(np.arange(3) == along, -1.0, motion)))
    size, faces = np.linalg.norm(shape, axis=1), outer_faces(result["corners"].values).corners
    faces = faces[np.argsort(place[faces].mean(axis=1)[:, 3 - along - across])]  # far faces first
    moved = 1e3 * (place + LEAN * extent.max() / size.max() * shape)[:, [along, across]]
    still = 1e3 * place[:, [along, across]]
    ax.add_collection(PolyCollection(list(still[faces]), facecolors="none", edgecolors="0.85"))
    seen = PolyCollection(list(moved[faces]), array=size[faces].mean(axis=1), linewidths=0.2)
    seen.set(edgecolor="white", clim=(0.0, float(size.max())))
    ax.add_collection(seen)
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.set(xlabel=f"{'xyz'[along]} (mm)", ylabel=f"{'xyz'[across]} (mm)")
    ax.set_title(f"mode {mode}, {float(result['mode_frequency'].sel(mode=mode)):.4g} Hz at rest")
    return ax


def plot_vibrating_joint(
    result: Dataset,
    *,
    quantity: str = "pressure",
    step: int = -1,
    joint: int = 0,
    ax: Axes | None = None,
) -> Axes:
    """Plot the pressure of a joint, or its share at sliding where closed, at an amplitude."""
    from multiscale.macro.substructures.measures import OPEN

    ax = axes_or_current(ax)
    name, unit = AT_POINTS[quantity]
    points = np.flatnonzero(result["point_joint"].values == joint)
    value = unit.scale * result[quantity].values[0, step, points]
    if quantity == "slipping":
        pressure, area = (
            result["pressure"].values[0, step, points],
            result["point_area"].values[points],
        )
        mean = np.maximum(pressure, 0.0) @ area / area.sum()
        value = np.where(pressure > OPEN * mean, value, np.nan)
    dots = draw_points(result, points, value, ax)
    dots.set_clim(0.0, max(float(np.nanmax(value)), np.finfo(float).tiny))
    add_colour_bar(dots, ax, f"{name} ({unit.name})")
    along = length_unit(result["largest_displacement"].values[[step]])
    size = along.scale * float(result["largest_displacement"][step])
    ax.set_title(
        f"interface {joint}, mode {int(result['step_mode'][step])}, {size:.3g} {along.name}"
    )
    return ax


def vibration_pictures(result: Dataset, most: int) -> dict[str, Callable[..., object]]:
    """Return the plots of vibration, by name, of at most ``most`` modes and joints."""
    draw: dict[str, Callable[..., object]] = {}
    followed = list(dict.fromkeys(result["step_mode"].values.tolist()))[:most]
    for k, mode in enumerate(followed):
        draw[f"mode_shape_{k}"] = partial(plot_mode_shape, result, mode=mode)
        for quantity in QUANTITIES:
            backbone = result[quantity].values[result["step_mode"].values == mode]
            if np.isfinite(backbone).sum() > 1:  # a line needs two amplitudes
                draw[f"{quantity}_{k}"] = partial(
                    plot_backbone, result, quantity=quantity, mode=mode
                )
    known = np.flatnonzero(
        (result["converged"].values == 1) & (result["step_mode"].values == followed[0])
    )
    if not known.size or "pressure" not in result:
        return draw
    for joint in np.unique(result["point_joint"].values).astype(int).tolist()[:most]:
        for quantity in AT_POINTS:
            draw[f"{quantity}_{joint}"] = partial(
                plot_vibrating_joint, result, quantity=quantity, step=int(known[-1]), joint=joint
            )
    return draw
