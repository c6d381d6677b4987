"""Figures of bodies under named loads: their stress in space, interfaces, loads and bolts.

A ``result`` follows ``MACRO_RESULT`` and is computed by
:func:`multiscale.macro.substructures.follow_cut_loads`.
"""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from multiscale.plotting.element_faces import outer_faces
from multiscale.plotting.figure import Axes, axes_or_current, colour_faces, set_box
from multiscale.plotting.joint_figures import plot_joint_plan
from multiscale.plotting.lines import plot_lines
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

MOST_DRAWN = 4  # largest number of drawn interfaces, from the first
SHOWN = 0.04  # largest displacement in the figure, over the size of the bodies
BRIGHTEST = 0.995  # quantile of the stress at the end of the colour scale


def plot_body_stress(result: Dataset, *, step: int = -1, ax: "Axes3D") -> "Axes3D":
    """Draw the outer faces of bodies, displaced and coloured by von Mises' stress.

    Parameters
    ----------
    result : Dataset, follows ``MACRO_RESULT``, with elements
    step : int, load step
    ax : Axes3D
        Axes to draw on. The title has the factor of the displacements.
    """
    corners = result["corners"].to_numpy().astype(int)
    stress = 1e-6 * result["equivalent_stress"].to_numpy()[step]
    place, moved = result["position"].to_numpy(), result["displacement"].to_numpy()[step]
    extent = np.ptp(place, axis=0)
    largest = float(np.abs(moved).max()) or 1.0
    times = SHOWN * float(extent.max()) / largest
    times = float(f"{times:.1g}")
    outer = outer_faces(corners)
    points = 1e3 * (place + times * moved)
    colour_faces(
        ax,
        points[outer.corners],
        stress[outer.element],
        "von Mises stress (MPa)",
        (0.0, float(np.quantile(stress, BRIGHTEST)) or 1.0),
        edgecolors=(0.0, 0.0, 0.0, 0.25),
        linewidths=0.2,
    )
    set_box(ax, points.min(axis=0), points.max(axis=0))
    ax.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)")
    ax.view_init(elev=24.0, azim=-50.0)
    ax.set_title(f"displacements {times:g} times")
    return ax


def plot_load_paths(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot every load over its displacement since the first known step; cycles make a loop."""
    ax = axes_or_current(ax)
    moved = 1e6 * result["load_displacement"].values
    moved = moved - moved[np.argmax(np.isfinite(moved).any(axis=1))]
    for k, name in enumerate(result["load"].values):
        ax.plot(moved[:, k], result["factor"].values[:, k], ".-", linewidth=1.0, label=str(name))
    ax.set(xlabel="displacement along the load since step 0 (µm)", ylabel="factor of the load")
    ax.legend(frameon=False)
    return ax


def load_pictures(result: Dataset) -> dict[str, Callable[..., object]]:
    """Return the plots of bodies under loads, by name; interfaces at the last known step.

    Paths with a value at a single step are not drawn.
    """
    draw: dict[str, Callable[..., object]] = {}
    if np.isfinite(result["load_displacement"].values).any(axis=1).sum() > 1:
        draw["loads"] = partial(plot_load_paths, result)
    if result.sizes.get("bolt", 0) and np.isfinite(result["bolt_force"][:, 0]).sum() > 1:
        draw["bolts"] = partial(plot_lines, result, "bolt_force", by="bolt")
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
