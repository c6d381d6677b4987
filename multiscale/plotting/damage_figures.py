"""Figures of damage, stiffness and fatigue."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.plotting.figure import (
    Axes,
    add_colour_bar,
    axes_or_current,
    colour_faces,
    outer_faces,
)
from multiscale.schema import Dataset
from multiscale.units import length_unit

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

    from multiscale.micro.damage.sections import Volume

ELEMENT_FIELDS = {
    "damage": (1.0, "mean damage of the inclusions"),
    "cracked_share": (100.0, "cracked inclusions (%)"),
    "equivalent_amplitude": (1e-6, "von Mises amplitude (MPa)"),
    "stiffness_share": (1.0, "remaining stiffness"),
}
"""Factor and label of the drawn fields of elements, by name."""


def plot_damage_sphere(sections: Dataset, *, ax: "Axes3D") -> "Axes3D":
    """Colour the sphere of normals by the damage of their worst sections.

    Parameters
    ----------
    ax : Axes3D
        Axes to draw on. An arrow shows the worst normal.
    """
    worst = sections["damage"].values.max(axis=1)
    return colour_sphere(sections["normal"].values, worst, sections["worst_normal"].values, ax=ax)


def colour_sphere(
    normals: np.ndarray, damage: np.ndarray, worst: np.ndarray, *, ax: "Axes3D"
) -> "Axes3D":
    """Colour the sphere of normals (n, 3) by damage (n,), with an arrow at the worst normal."""
    from scipy.spatial import ConvexHull

    points, values = np.concatenate([normals, -normals]), np.concatenate([damage, damage])
    corners = ConvexHull(points).simplices
    label, limits = "damage of the worst section", (0.0, float(damage.max()) or 1.0)
    style = {"edgecolors": "white", "linewidths": 0.2}
    colour_faces(ax, points[corners], values[corners].mean(axis=1), label, limits, **style)
    n = worst if worst[2] >= 0.0 else -worst
    ax.quiver(*n, *(0.6 * n), color="black", arrow_length_ratio=0.25)
    ax.view_init(
        elev=25.0, azim=float(np.degrees(np.arctan2(n[1], n[0]))) - 35.0
    )  # view on the arrow
    ax.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), zlim=(-1.2, 1.2))
    ax.set(xlabel="x", ylabel="y", zlabel="z")
    ax.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1], zticks=[-1, 0, 1])
    ax.set_box_aspect((1.0, 1.0, 1.0))
    return ax


def plot_element_field(
    life: Dataset, name: str = "damage", *, near: bool = False, ax: Axes | None = None
) -> Axes:
    """Colour the elements of a body, seen along the axis in which it is thinnest.

    Parameters
    ----------
    life : Dataset, follows ``FATIGUE_LIFE``, with the mesh of the body, or ``CRACKED_BODY``
    name : str, a key of :data:`ELEMENT_FIELDS`
    near : bool
        Whether only the surroundings of damaged elements are shown. A ring marks the crack.
    ax : Axes, optional
    """
    from matplotlib.collections import PolyCollection

    ax = axes_or_current(ax)
    place, corners = life["position"].values, life["corners"].values
    outer = outer_faces(corners)
    faces, owner = outer.corners, outer.element
    depth = int(np.argmin(np.ptp(place, axis=0)))
    first, second = (k for k in range(3) if k != depth)
    middle = place[corners].mean(axis=1)[owner, depth]
    seen = place[faces][..., depth].mean(axis=1) > middle
    flat = place[faces][..., [first, second]]
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    size = np.ptp(place, axis=0).max()
    seen &= np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > (1e-6 * size) ** 2
    order = np.flatnonzero(seen)
    order = order[np.argsort(place[faces[order]][..., depth].mean(axis=1))]
    factor, label = ELEMENT_FIELDS[name]
    values = factor * life[name].values[owner[order]]
    drawn = PolyCollection(
        1e3 * flat[order], array=values, cmap="viridis", edgecolors="white", linewidths=0.1
    )
    ax.add_collection(drawn)
    ax.autoscale_view()
    if near and (damaged := np.flatnonzero(life["damage"].values > 0.0)).size:
        around = 1e3 * place[corners[damaged]][..., [first, second]].reshape(-1, 2)
        half = 1.5 * np.ptp(around, axis=0).max()
        x, y = around.mean(axis=0)
        ax.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
    ax.set(aspect="equal", xlabel=f"{'xyz'[first]} (mm)", ylabel=f"{'xyz'[second]} (mm)")
    if "crack_position" in life:
        x, y = 1e3 * life["crack_position"].values[[first, second]]
        ax.plot(x, y, "o", color="red", markersize=14, fillstyle="none", label="crack")
        ax.legend(loc="best")
    add_colour_bar(drawn, ax, label)
    return ax


def plot_worst_section(rve: "Volume", sections: Dataset, *, ax: Axes | None = None) -> Axes:
    """Draw the void in the worst section.

    Parameters
    ----------
    rve : Cavities or VoxelImage, the volume of the sections
    """
    from matplotlib.colors import ListedColormap

    from multiscale.micro.damage.cavities import perpendicular

    ax = axes_or_current(ax)
    normal = sections["worst_normal"].values
    origin = 0.5 * np.array(rve.size) + float(sections["worst_offset"]) * normal
    along, value = _section_image(rve, origin, perpendicular(normal[None])[0])
    inside = np.isfinite(value)
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    unit = length_unit([max(rve.size)])
    low, high = (unit.scale * along[[k[0], k[-1]]] for k in (columns, rows))
    ax.imshow(
        value[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1],
        origin="lower",
        extent=(low[0], low[1], high[0], high[1]),
        cmap=ListedColormap(["0.8", "C3"]),
        vmin=0.0,
        vmax=1.0,
        interpolation="nearest",
    )
    label = f"along the section ({unit.name})"
    ax.set(xlabel=label, ylabel=label)
    at = ", ".join(f"{0.0 if abs(k) < 5e-3 else k:.2f}" for k in normal)
    ax.set_title(f"D = {float(sections['maximum_damage']):.3f}, normal ({at})")
    return ax


def plot_woehler(curve: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot stress amplitude against cycles to initiation and to rupture; run-outs are arrows."""
    ax = axes_or_current(ax)
    amplitude = 1e-6 * curve["amplitude"].values
    life, onset = curve["cycles_to_rupture"].values, curve["cycles_to_initiation"].values
    broken = np.isfinite(life)
    ax.semilogx(life[broken], amplitude[broken], "o-", label="rupture")
    begun = broken & np.isfinite(onset) & (onset > 0.0)
    ax.semilogx(onset[begun], amplitude[begun], "s--", label="onset of damage")
    endless = np.isinf(life)
    if endless.any():
        end = 3.0 * life[broken].max() if broken.any() else 1e7
        ax.semilogx(
            np.full(endless.sum(), end), amplitude[endless], ">", color="C2", label="endless"
        )
    ax.set(xlabel="cycles", ylabel="stress amplitude (MPa)")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    return ax


def _section_image(
    rve: "Volume", origin: np.ndarray, frame: np.ndarray, points: int = 400
) -> tuple[np.ndarray, np.ndarray]:
    """Sample a plane: coordinates (points,), m, and values, 0 in solid, 1 in void, NaN outside."""
    size = np.array(rve.size)
    half = 0.5 * float(np.linalg.norm(size))
    along = half * (2.0 * (np.arange(points) + 0.5) / points - 1.0)
    place = origin[:, None, None] + (
        frame[0][:, None, None] * along[None, None, :]
        + frame[1][:, None, None] * along[None, :, None]
    )
    inside = np.all((place >= 0.0) & (place < size[:, None, None]), axis=0)
    void = rve.void_at(place, 4.0 * half / points)
    return along, np.where(inside, void.astype(float), np.nan)
