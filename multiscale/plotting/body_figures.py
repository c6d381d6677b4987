"""Figure of bodies in space: their faces, deformed, coloured by a field of their elements."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.plotting.element_faces import outer_faces
from multiscale.plotting.figure import set_box
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

__all__ = ["plot_body_stress"]

SHOWN = 0.04
"""Largest displacement in the picture, over the size of the bodies."""

BRIGHTEST = 0.995
"""Share of the elements whose stress the colours distinguish; the others have the last colour."""


def plot_body_stress(result: Dataset, *, step: int = -1, ax: "Axes3D") -> "Axes3D":
    """Draw the outer faces of bodies, displaced and coloured by von Mises' stress.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``, with elements.
    step : int, load step
    ax : Axes3D
        Axes to draw on. The title says how many times the displacements are enlarged.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    corners = result["corners"].to_numpy().astype(int)
    stress = 1e-6 * result["equivalent_stress"].to_numpy()[step]
    place, moved = result["position"].to_numpy(), result["displacement"].to_numpy()[step]
    extent = np.ptp(place, axis=0)
    largest = float(np.abs(moved).max()) or 1.0
    times = SHOWN * float(extent.max()) / largest
    times = float(f"{times:.1g}")
    outer = outer_faces(corners)
    scale = Normalize(0.0, float(np.quantile(stress, BRIGHTEST)) or 1.0)
    points = 1e3 * (place + times * moved)
    ax.add_collection3d(
        Poly3DCollection(
            points[outer.corners],
            facecolors=colormaps["viridis"](scale(stress[outer.element])),
            edgecolors=(0.0, 0.0, 0.0, 0.25),
            linewidths=0.2,
        )
    )
    set_box(ax, points.min(axis=0), points.max(axis=0))
    ax.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)")
    ax.view_init(elev=24.0, azim=-50.0)
    mappable = ScalarMappable(scale, colormaps["viridis"])
    ax.figure.colorbar(mappable, ax=ax, label="von Mises stress (MPa)", shrink=0.6, pad=0.12)
    ax.set_title(f"displacements {times:g} times")
    return ax
