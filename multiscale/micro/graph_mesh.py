"""The layered hexahedral mesh of a periodic cell whose top is a graph z = h(x, y)."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from skfem import MeshHex

__all__ = ["GraphMesh", "graded_planes"]


def graded_planes(depth: float, layers: int, top_thickness: float) -> np.ndarray:
    r"""Heights of the node planes, geometrically coarser from the top to the base."""
    if top_thickness * layers >= depth:
        return np.linspace(0.0, depth, layers + 1)

    power, total = np.arange(layers), depth / top_thickness
    # too large, so that Newton falls to it; scipy.optimize would load for longer than a cell takes
    ratio, step = total ** (1.0 / (layers - 1)), np.inf
    while step > 1e-15 * ratio:
        thickness = ratio**power
        step = (thickness.sum() - total) / (power @ thickness / ratio)
        ratio -= step
    thickness = ratio ** power[::-1]
    planes = np.concatenate([[0.0], np.cumsum(thickness)])
    return np.asarray(planes * (depth / planes[-1]))


@dataclass(frozen=True)
class GraphMesh:
    r"""Nodes of the conforming mesh :math:`z = Z_l + \varphi_l h(x, y)`, periodic in x and y.

    The vertical map puts the rough surface exactly on the top nodes. The node planes :math:`Z_l`
    run from the base 0 to the depth, :math:`\varphi_l = Z_l / H`.

    Parameters
    ----------
    surface : Surface
        Heights :math:`h`, m, with even numbers of points; a single point across is plane strain.
    planes : ndarray, shape (layers + 1,)
        :math:`Z_l`, m.

    Raises
    ------
    CaseError
        If the number of points is odd or a valley reaches the base.
    """

    surface: Surface
    planes: np.ndarray

    def __post_init__(self) -> None:
        nx, ny = self.surface.heights.shape
        if any(n % 2 and n > 1 for n in (nx, ny)):
            raise CaseError(
                f"the cell needs an even number of points in each direction, or one across, got "
                f"{nx} x {ny}; resample the surface to {nx + nx % 2} x {ny + ny % 2}"
            )
        depth, lowest = float(self.planes[-1]), float(self.surface.heights.min())
        if depth + lowest <= 0.0:
            raise CaseError(
                f"the cell folds over: its lowest valley is {-lowest:.3g} m below the mean plane, "
                f"its depth only {depth:.3g} m; choose a larger depth"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of elements in x, y and depth."""
        nx, ny = self.surface.heights.shape
        return nx, ny, len(self.planes) - 1

    @property
    def map_factor(self) -> np.ndarray:
        """Share of the height that a node plane carries, shape (layers + 1,)."""
        return np.asarray(self.planes / self.planes[-1])

    def hexahedra(self, first_layer: int = 0) -> "MeshHex":
        """Return the mesh, opened at its periodic faces, for scikit-fem."""
        from skfem import MeshHex

        (nx, ny, _), (dx, dy) = self.shape, self.surface.spacing
        planes = self.planes[first_layer:]
        mesh = MeshHex.init_tensor(np.arange(nx + 1) * dx, np.arange(ny + 1) * dy, planes)
        i, j = (np.rint(mesh.p[k] / step).astype(int) for k, step in ((0, dx), (1, dy)))
        points = mesh.p.copy()
        points[2] *= 1.0 + self.surface.heights[i % nx, j % ny] / self.planes[-1]
        top = mesh.facets_satisfying(lambda x: x[2] > planes[-1] - 1e-9 * planes[-1])
        return MeshHex(points, mesh.t).with_boundaries({"top": top})
