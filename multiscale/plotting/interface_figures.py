"""Figures of bodies under named loads: their interfaces, loads and bolts.

A ``result`` follows ``MACRO_RESULT`` and is of
:func:`multiscale.macro.substructures.follow_cut_loads`.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from multiscale.plotting.figure import Axes, axes_or_current
from multiscale.plotting.joint_figures import plot_joint_plan
from multiscale.schema import Dataset

__all__ = ["MOST_DRAWN", "load_pictures", "plot_bolt_forces", "plot_load_paths"]

MOST_DRAWN = 4
"""Interfaces that are drawn, from the first on."""


def plot_load_paths(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot every load over its displacement since the first step, which cycles make a loop."""
    ax = axes_or_current(ax)
    moved = 1e6 * (result["load_displacement"] - result["load_displacement"][0]).values
    for k, name in enumerate(result["load"].values):
        ax.plot(moved[:, k], result["factor"].values[:, k], ".-", linewidth=1.0, label=str(name))
    ax.set(xlabel="displacement along the load since step 0 (µm)", ylabel="factor of the load")
    ax.legend(frameon=False)
    return ax


def plot_bolt_forces(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the force of every bolt over the load steps."""
    ax = axes_or_current(ax)
    for bolt, force in enumerate(1e-3 * result["bolt_force"].values.T):
        ax.plot(force, ".-", linewidth=1.0, label=f"bolt {bolt}")
    ax.set(xlabel="load step", ylabel="force of the bolt (kN)")
    ax.legend(frameon=False)
    return ax


def load_pictures(result: Dataset) -> dict[str, Callable[..., object]]:
    """Return what is drawn of bodies under loads, by name; interfaces at the last step known."""
    draw: dict[str, Callable[..., object]] = {"loads": partial(plot_load_paths, result)}
    if result.sizes.get("bolt", 0):
        draw["bolts"] = partial(plot_bolt_forces, result)
    for k in range(min(MOST_DRAWN, result.sizes.get("interface", 0))):
        known = np.flatnonzero(np.isfinite(result["interface_slip"].values[:, k]))
        if not known.size:
            continue
        step = int(known[-1])
        factors = zip(result["load"].values, result["factor"].values[step], strict=True)
        loads = ", ".join(f"{name} {factor:.3g}" for name, factor in factors)
        for name, quantity in (("contact_zones", "contact_state"), ("pressure", "pressure")):
            draw[f"{name}_{k}"] = partial(
                plot_joint_plan,
                result,
                quantity=quantity,
                step=step,
                joint=k,
                title=f"interface {k}, {loads}",
            )
    return draw
