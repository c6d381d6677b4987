"""Figures of representative volumes; ``rve`` follows ``RVE``."""

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io.images import VoxelImage
from multiscale.laws.bulk.bulk_law import youngs_modulus_along
from multiscale.micro.damage.sections import sphere_directions
from multiscale.plotting.damage_figures import colour_sphere
from multiscale.plotting.figure import Axes, axes_or_current, colour_faces
from multiscale.plotting.lines import draw_band
from multiscale.schema import Dataset
from multiscale.units import length_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

MOST_FACES = 15_000  # faces of voxels above which an image is drawn at half its resolution
LIGHT = np.array([0.35, -0.55, 0.76])  # unit vector towards the light

COLOURS = {"traction": "C0", "periodic": "black", "displacement": "C3"}


def plot_rve(rve: Dataset, *, ax: "Axes3D") -> "Axes3D":
    """Draw the voids of the first volume within its box."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
    from scipy.ndimage import gaussian_filter

    size = rve["box_size"].to_numpy()
    unit = length_unit(size)
    image = VoxelImage(rve["void"].to_numpy(), tuple(unit.scale * size))
    while (quads := _void_faces(image))[0].shape[0] > MOST_FACES:
        image = image.coarsened()
    corners, outward, voxel, cut = quads
    # the gradient of the blurred voids shades spheres of voxels as spheres
    blurred = gaussian_filter(np.pad(image.void.astype(float), 2, mode="wrap"), 1.0)
    slope = -np.stack(np.gradient(blurred))[:, 2:-2, 2:-2, 2:-2]
    normal = slope[(slice(None), *voxel.T)].T
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-3, normal / np.maximum(length, 1e-3), outward)
    bright = 0.45 + 0.55 * np.clip(normal @ LIGHT, 0.0, 1.0)
    colours = bright[:, None] * np.array([0.36, 0.55, 0.78])
    colours[cut] = [0.75, 0.33, 0.22]
    ax.add_collection3d(Poly3DCollection(corners, facecolors=colours, edgecolors="none"))
    box = np.array([*product((0.0, 1.0), repeat=3)]) * image.size
    edges = [(box[a], box[a | bit]) for a in range(8) for bit in (1, 2, 4) if not a & bit]
    ax.add_collection3d(Line3DCollection(edges, colors="0.4", linewidths=0.8))
    x, y, z = image.size
    ax.set(xlim=(0, x), ylim=(0, y), zlim=(0, z))
    ax.set(xlabel=f"x ({unit.name})", ylabel=f"y ({unit.name})", zlabel=f"z ({unit.name})")
    ax.set_box_aspect(image.size)
    ax.view_init(elev=22.0, azim=-55.0)
    ax.set_title(f"voids {100.0 * image.porosity:.3g} %")
    return ax


def _void_faces(image: VoxelImage) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return faces of voids at solid or at the box, outward normals, voxels, and cuts."""
    corners, normals, voxels, cuts = [], [], [], []
    spacing = np.array(image.spacing)
    for axis, way in product(range(3), (0, 1)):
        void = np.moveaxis(image.void, axis, 0)
        bounded = np.ones_like(void)
        inner = (slice(1, None), slice(None, -1)) if way == 0 else (slice(None, -1), slice(1, None))
        bounded[inner[0]] = ~void[inner[1]]
        at = np.argwhere(void & bounded)
        end = 0 if way == 0 else void.shape[0] - 1
        cuts.append(at[:, 0] == end)
        square = np.array([[way, 0, 0], [way, 1, 0], [way, 1, 1], [way, 0, 1]])
        place = np.moveaxis(at[:, None] + square, -1, 0)
        order = [1, 2]
        order.insert(axis, 0)
        corners.append(np.moveaxis(place[order], 0, -1) * spacing)
        voxels.append(at[:, order])
        outward = np.zeros(3)
        outward[axis] = 1.0 - 2.0 * way
        normals.append(np.broadcast_to(outward, (len(at), 3)))
    return tuple(np.concatenate(arrays) for arrays in (corners, normals, voxels, cuts))  # type: ignore[return-value]


def plot_rve_damage(rve: Dataset, *, ax: "Axes3D") -> "Axes3D":
    """Colour the sphere of normals by the damage of their worst sections, mean over volumes."""
    normals, damage = rve["normal"].to_numpy(), rve["damage"].to_numpy()
    worst = normals[np.argmax(damage)]
    return colour_sphere(normals, damage, worst, ax=ax)


def plot_modulus_surface(rve: Dataset, *, ax: "Axes3D") -> "Axes3D":
    """Draw Young's modulus as the distance of a surface from the centre along each direction."""
    from matplotlib.ticker import MaxNLocator
    from scipy.spatial import ConvexHull

    half = sphere_directions(3)
    points = np.concatenate([half, -half])
    faces = ConvexHull(points).simplices
    ratio = 1e-9 * youngs_modulus_along(rve["stiffness"].to_numpy(), points)
    low, high = float(ratio.min()), float(ratio.max())
    if high - low < 1e-6 * high:
        low, high = 0.0, high or 1.0
    surface, label = (ratio[:, None] * points)[faces], "Young's modulus along the direction (GPa)"
    style = {"edgecolors": "white", "linewidths": 0.1}
    colour_faces(ax, surface, ratio[faces].mean(axis=1), label, (low, high), **style)
    reach = 1.1 * (float(ratio.max()) or 1.0)
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-reach, reach))
    ax.set(xlabel="x (GPa)", ylabel="y (GPa)", zlabel="z (GPa)")
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_major_locator(MaxNLocator(3))
    ax.set_box_aspect((1.0, 1.0, 1.0))
    return ax


def plot_size_study(rve: Dataset, figure: "Figure") -> None:
    """Draw means and deviations of stiffness with all sides, and of the worst damage, over size."""
    above, below = figure.subplots(2, 1, sharex=True)
    plot_size_stiffness(rve, ax=above)
    plot_size_damage(rve, ax=below)
    above.set_xlabel("")


def plot_size_stiffness(rve: Dataset, *, ax: Axes | None = None) -> Axes:
    """Draw Young's modulus, mean over directions, against the size of the volumes."""
    ax = axes_or_current(ax)
    share = rve["share"].to_numpy()
    E = rve["apparent_modulus"].to_numpy() / rve.attrs["youngs_modulus"]
    for k, sides in enumerate(map(str, rve["sides"].values)):
        _band(ax, rve, share, E[:, k].mean(axis=-1), COLOURS[sides], f"{sides} sides")
    ax.set_ylabel("Young's modulus over solid")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    return ax


def plot_size_damage(rve: Dataset, *, ax: Axes | None = None) -> Axes:
    """Draw damage of the worst and of the mean section against the size of the volumes."""
    ax = axes_or_current(ax)
    share = rve["share"].to_numpy()
    worst = rve["largest_damage"].to_numpy().max(axis=1)
    _band(ax, rve, share, worst, "C1", "worst section")
    _band(ax, rve, share, rve["mean_damage"].to_numpy().mean(axis=1), "C2", "mean section")
    unit = length_unit(_edges(rve, share))
    ax.set(xlabel=f"edge of the volume ({unit.name})", ylabel="damage D")
    ax.set_ylim(bottom=0.0)
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    return ax


def _edges(rve: Dataset, share: np.ndarray) -> np.ndarray:
    """Edges of cubes of the same volume, m."""
    return np.asarray(share * float(np.prod(rve["box_size"].to_numpy())) ** (1.0 / 3.0))


def _band(
    ax: Axes, rve: Dataset, share: np.ndarray, value: np.ndarray, colour: str, label: str
) -> None:
    sizes = np.unique(share)
    if not np.isfinite(value).any():
        return
    samples = [value[(share == size) & np.isfinite(value)] for size in sizes]
    mean = np.array([sample.mean() if sample.size else np.nan for sample in samples])
    spread = np.array([sample.std(ddof=1) if sample.size > 1 else 0.0 for sample in samples])
    edges = _edges(rve, sizes)
    edges = edges * length_unit(_edges(rve, share)).scale
    ax.plot(edges, mean, "o-", color=colour, label=label, markersize=4)
    draw_band(ax, edges, np.stack([mean - spread, mean + spread]), colour, alpha=0.18, label=None)


def plot_crack_damage(growth: Dataset, *, ax: Axes | None = None) -> Axes:
    """Draw stress and damage of the worst section against strain, a line for each volume."""
    ax = axes_or_current(ax)
    whole = growth["share"].to_numpy() == 1.0
    strain = 1e6 * growth["strain"].to_numpy()[whole]
    stress = 1e-6 * growth["stress"].to_numpy()[whole]
    ways = (np.pad(values, ((0, 0), (1, 0))).T for values in (strain, stress))  # elastic from rest
    ax.plot(*ways, color="C0", linewidth=0.8)
    ax.set_xlabel("mean strain (µm/m)")
    ax.set_ylabel("mean stress (MPa)", color="C0")
    ax.set(xlim=(0.0, None), ylim=(0.0, None))
    right = ax.twinx()
    right.plot(strain.T, growth["damage"].to_numpy()[whole].T, color="C1", linewidth=0.8)
    right.set_ylabel("damage of the section, eq (1)", color="C1")
    right.set_ylim(0.0, 1.0)
    return ax


def plot_softening(growth: Dataset, *, ax: Axes | None = None) -> Axes:
    """Draw the stress that a crack transmits against its opening, of all volumes and the mean."""
    ax = axes_or_current(ax)
    whole = growth["share"].to_numpy() == 1.0
    opening, stress = (growth[f"softening_{name}"].to_numpy() for name in ("opening", "stress"))
    ax.plot(1e6 * opening[whole].T, 1e-6 * stress[whole].T, color="0.7", linewidth=0.6)
    mean = 1e6 * growth["mean_opening"].to_numpy(), 1e-6 * growth["mean_stress"].to_numpy()
    ax.plot(*mean, color="C0", label="mean law")
    ax.set(xlabel="opening (µm)", ylabel="stress across the crack (MPa)")
    ax.set(xlim=(0.0, None), ylim=(0.0, None))
    ax.legend()
    return ax


def plot_cracked_load(cracked: Dataset, *, ax: Axes | None = None) -> Axes:
    """Draw the load of a cracking body, ``CRACKED_BODY``, with the 95 % interval of its peak."""
    ax = axes_or_current(ax)
    moved = cracked["work_displacement"].to_numpy()
    ax.plot(moved, cracked["factor"].to_numpy(), color="C0", linewidth=0.8, label="mean law")
    for kind, colour in (("one_part", "0.9"), ("mean_law", "0.75")):
        ends = cracked[f"peak_load_{kind}"].to_numpy()
        if np.isfinite(ends).all():
            label = f"largest load, {kind.replace('_', ' ')}, 95 %"
            ax.axhspan(*ends, color=colour, zorder=0, label=label)
    ax.set(xlabel="work of the loads at factor 1 (J)", ylabel="factor of the loads")
    ax.set(xlim=(0.0, None), ylim=(0.0, None))
    ax.legend()
    return ax
