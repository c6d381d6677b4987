"""Figures of rough joints, and of bodies under named loads, of a ``MACRO_RESULT``."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.faces import plane_axes
from multiscale.plotting.figure import (
    Axes,
    add_colour_bar,
    axes_or_current,
    colour_faces,
    list_faces,
    outer_faces,
    set_box,
)
from multiscale.plotting.law_figures import plot_joint_stiffness
from multiscale.plotting.lines import BANDS, draw_band, plot_lines
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from matplotlib.collections import Collection
    from mpl_toolkits.mplot3d import Axes3D

ZONES = ("open", "stick", "sliding")  # names of the values 0, 1 and 2 of contact_state
ZONE_COLOURS = ("0.8", "C0", "C3")  # colours of the zones


LEGEND_BELOW = 0.45  # distance of the legend of the zones below the axes, inches
BESIDE = 0.05  # width of the drawn margin of a joint, over its longer edge
LEVEL = 1e-6  # height, relative to a body, up to which corners lie on its top

QUANTITIES = {
    "pressure": "pressure (MPa)",
    "dissipation": "loss of the last cycle (J/m²)",
}
"""Quantities of the points of a joint that have a colour bar, and its label."""


def plot_joint_plan(
    result: Dataset,
    *,
    quantity: str = "contact_state",
    step: int = -1,
    joint: int = 0,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Plot the open, sticking and sliding zones of a joint in plan, its pressure or its loss.

    The joint is seen along its normal, as :func:`draw_points` draws it.

    Parameters
    ----------
    quantity : str
        ``"contact_state"``, ``"pressure"`` or ``"dissipation"``, the loss of the last cycle.
    step : int, step; the last step if not given
    joint : int, number of the joint
    title : str, its preload and shear if not given
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch
    from matplotlib.transforms import ScaledTranslation

    ax = axes_or_current(ax)
    points = np.flatnonzero(result["point_joint"].values == joint)
    area = result["point_area"].values[points]
    if quantity == "contact_state":
        state = result["contact_state"].values[step, points]
        draw_points(result, points, state, ax).set(
            cmap=ListedColormap(ZONE_COLOURS), clim=(-0.5, 2.5)
        )
        middle = ScaledTranslation(0.5, 0.0, ax.transAxes)  # type: ignore[arg-type]
        handles = [
            Patch(
                color=colour,
                label=f"{name}, {100.0 * area[state == k].sum() / area.sum():.3g} %",
            )
            for k, (name, colour) in enumerate(zip(ZONES, ZONE_COLOURS, strict=True))
        ]
        ax.legend(
            handles=handles,
            title="share of the nominal area",
            frameon=False,
            ncols=3,
            loc="upper center",
            bbox_to_anchor=(0.0, -LEGEND_BELOW),
            bbox_transform=ax.figure.dpi_scale_trans + middle,
        )
    else:
        value = -1e-6 * result["traction"].values[step, points, 0]
        if quantity == "dissipation":
            value = result["dissipation"].values[_last_cycle(result)][:, points].sum(axis=0)
        dots = draw_points(result, points, value, ax)
        dots.set_clim(0.0, float(np.nanmax(value)))
        add_colour_bar(dots, ax, QUANTITIES[quantity])
    if not title:
        preload, shear = (1e-6 * float(result[name].values[step]) for name in ("preload", "shear"))
        at = f"shear {shear:.3g} MPa" if quantity != "dissipation" else f"cycles of {shear:.3g} MPa"
        title = f"preload {preload:.3g} MPa, {at}"
    if quantity == "contact_state":
        force = 100.0 * float(result["interface_slipping_load"].values[step, joint])
        title += f"\n{force:.3g} % of the contact force at sliding"
    ax.set_title(title)
    return ax


def draw_points(result: Dataset, points: np.ndarray, value: np.ndarray, ax: Axes) -> "Collection":
    """Draw values at points of a joint, on their shares of faces or else on discs."""
    from matplotlib.collections import EllipseCollection, PolyCollection

    axes, names = _seen(result, points)
    faces = _faces(result, points)
    place = 1e3 * result["point_position"].values[points] @ axes[1:].T
    drawn: Collection
    if faces.size:
        corner = place[faces]  # (faces, corners, 2)
        edge = 0.5 * (corner + np.roll(corner, -1, axis=1))
        centre = np.broadcast_to(corner.mean(axis=1, keepdims=True), corner.shape)
        quarters = np.stack([corner, edge, centre, np.roll(edge, 1, axis=1)], axis=2)
        colours = value[faces.ravel()]
        drawn = PolyCollection(
            list(quarters.reshape(-1, 4, 2)), array=colours, edgecolors="face", linewidths=0.6
        )
    else:
        across = 1e3 * np.sqrt(4.0 / np.pi * result["point_area"].values[points])
        drawn = EllipseCollection(
            across,
            across,
            0.0,
            units="xy",
            offsets=place,
            offset_transform=ax.transData,
            array=value,
        )
    for line in _outlines(result, axes):
        ax.plot(*(1e3 * line), color="black", linewidth=0.8, solid_capstyle="butt", zorder=3)
    ax.add_collection(drawn)
    ax.set_aspect("equal")
    seen = drawn.get_datalim(ax.transData)
    seen = seen.padded(BESIDE * max(seen.width, seen.height))
    ax.set(xlim=seen.intervalx, ylim=seen.intervaly)  # bodies may be larger
    ax.set(xlabel=f"{names[0]} (mm)", ylabel=f"{names[1]} (mm)")
    return drawn


def _faces(result: Dataset, points: np.ndarray) -> np.ndarray:
    """Faces of a body with all corners among the points, (faces, corners), as numbers of points."""
    if "corners" not in result:
        return np.empty((0, 3), dtype=int)
    place = np.concatenate([result["point_position"].values[points], result["position"].values])
    _, same = np.unique(place, axis=0, return_inverse=True)
    number = np.full(same.size, -1)
    number[same[: points.size]] = np.arange(points.size)
    faces = number[same[points.size :]][list_faces(result["corners"].values)]
    for body in np.unique(result["element_body"].values):
        body_faces = faces[result["element_body"].values == body].reshape(-1, faces.shape[2])
        body_faces = body_faces[np.all(body_faces >= 0, axis=1)]
        if np.unique(body_faces).size == points.size:
            return np.asarray(body_faces)
    return np.empty((0, 3), dtype=int)


def _seen(result: Dataset, points: np.ndarray) -> tuple[np.ndarray, tuple[str, str]]:
    """Return normal and two axes of the plane of some points, (3, 3), and the names of the axes."""
    axes = plane_axes(result["point_position"].values[points])
    across, first, second = np.argmax(np.abs(axes), axis=1)
    straight = axes[0, across] == 1.0
    return axes, ("xyz"[first], "xyz"[second]) if straight else ("along", "across")


def _outlines(result: Dataset, axes: np.ndarray) -> list[np.ndarray]:
    """Outline of the top of every body along the first axis, (2, points), m, NaN between edges."""
    if "corners" not in result:
        return []
    place, corners = result["position"].values, result["corners"].values
    faces = list_faces(corners)
    lines = []
    for body in np.unique(result["element_body"].values):
        body_faces = faces[result["element_body"].values == body].reshape(-1, faces.shape[2])
        height = place[body_faces] @ axes[0]
        top = body_faces[np.all(height > height.max() - LEVEL * np.ptp(height), axis=1)]
        edges = np.sort(np.stack([top, np.roll(top, 1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        edge, count = np.unique(edges, axis=0, return_counts=True)
        ends = place[edge[count == 1]] @ axes[1:].T  # (edges, 2, 2)
        gap = np.full((len(ends), 1, 2), np.nan)
        lines.append(np.concatenate([ends, gap], axis=1).reshape(-1, 2).T)
    return lines


def _sheared(result: Dataset) -> int:
    """Return the number of the first step of a path with shear."""
    return int(np.flatnonzero(np.cumsum(np.abs(result["shear"].values)) > 0.0)[0])


def _last_cycle(result: Dataset) -> slice:
    after = result.sizes["step"] - _sheared(result)
    return slice(-4 * (after // (4 * result.sizes["cycle"] + 1)), None)


def plot_hysteresis(result: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the shear of the cycles over its displacement; the loop encloses the dissipated energy.

    The elastic displacement, shear over the stiffness without slip, is subtracted: it would hide a
    slender loop, and encloses no area. The bands are loops that enclose the ends of the intervals
    of the loss, if known, with widths scaled about the middle of both branches.
    """
    ax = axes_or_current(ax)
    first = _sheared(result)
    steps = slice(max(first - 1, 0), None)
    stiffness = result["tangential_stiffness"].values[max(first - 1, 0)]
    shear = 1e-6 * result["shear"].values[steps]
    slip = 1e6 * (result["shear_displacement"].values[steps] - 1e6 * shear / stiffness)
    slip -= slip[0]
    loss = result["cycle_energy"].values[-1]
    last = _last_cycle(result).start - 1
    half = -last // 2 + 1  # steps from one amplitude to the other, both counted
    back, forth = slip[last:][:half], slip[last:][half - 1 :][::-1]
    middle, width = 0.5 * (back + forth), 0.5 * (forth - back)
    for kind, alpha in BANDS.items():
        if f"cycle_energy_{kind}" not in result or not loss > 0.0:
            continue
        low, high = result[f"cycle_energy_{kind}"].values[:, -1] / loss
        for side, label in ((-1.0, f"{kind.replace('_', ' ')}, 95 %"), (1.0, None)):
            ends = np.stack([middle + side * ratio * width for ratio in (low, high)])
            draw_band(ax, shear[last:][:half], ends, alpha=alpha, label=label, sideways=True)
        ax.legend(loc="upper left", fontsize="small")
    ax.plot(slip, shear, ".-", color="C0", linewidth=1.0, markersize=4)
    caption = "no loss known" if np.isnan(loss) else f"{1e3 * loss:.3g} mJ dissipated"
    ax.set_title(f"last cycle: {caption}")
    ax.set_xlabel("tangential minus elastic displacement (µm)")
    ax.set_ylabel("tangential traction (MPa)")
    return ax


def _plot_cycles(result: Dataset, name: str, *, ax: Axes | None = None) -> Axes:
    """Plot an answer of closed cycles over the amplitude, a line for each preload."""
    if name == "cycle_loss":  # logarithmic axes cannot show cycles without slip
        result = result.assign({name: result[name].where(result[name] > 0.0)})
    ax = plot_lines(result, name, by="cycle_preload", ax=ax, title="closed cycles, by preload")
    if name == "cycle_loss":
        shear, low = 1e-6 * result["cycle_shear"].values, 1e3 * float(result[name].min())
        ax.set(xscale="log", yscale="log", xticks=shear, ylim=(0.5 * low, None))
        ax.set_xticks([], minor=True)
        ax.set_xticklabels([f"{amplitude:.3g}" for amplitude in shear])
    return ax


def joint_pictures(result: Dataset) -> dict[str, Callable[..., object]]:
    """Return the plots of a joint, by name: zones and pressure, and under shear loop and loss.

    Zones are drawn at the last step that has an answer, at the amplitude of the shear.
    """
    slips = result["slip_fraction"].values
    if np.isnan(slips).all():
        why = result.attrs.get("failure") or result.attrs.get("cautions", "")
        raise CaseError(f"no step has an answer, so that no joint can be drawn: {why}")
    step = int(np.flatnonzero(np.isfinite(slips))[-1])
    draw: dict[str, Callable[..., object]] = {
        "contact_zones": partial(plot_joint_plan, result, step=step),
        "pressure": partial(plot_joint_plan, result, quantity="pressure", step=step),
    }
    if "cycle_energy" in result:
        draw["hysteresis"] = partial(plot_hysteresis, result)
        if np.isfinite(result["cycle_energy"].values[-1]):
            draw["loss"] = partial(plot_joint_plan, result, quantity="dissipation")
    if np.isfinite(result["joint_stiffness"].values).sum() > 1:
        draw["joint_stiffness"] = partial(plot_joint_stiffness, result)
    if "cycle_loss" in result:
        for name in ("secant_stiffness", "cycle_loss"):
            if (result[name].values > 0.0).sum(axis=1).max() > 1:  # a line needs two amplitudes
                draw[name] = partial(_plot_cycles, result, name)
    return draw


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
