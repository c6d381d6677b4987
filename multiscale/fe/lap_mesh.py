"""Mesh of a lap joint with a bolt hole, by gmsh."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.boxes import HEX_ORDER
from multiscale.io.gmsh_model import gmsh_model

if TYPE_CHECKING:
    from skfem import Mesh

__all__ = ["LapShape", "lap_meshes"]

QUAD = 3
"""Element type of gmsh."""

OVERLAP, RING = 101, 102
"""Numbers of the surfaces with a hole."""

CLOSE = 1e-6
"""Distance from a face or circle, relative to the overlap, at which a node lies on it."""


@dataclass(frozen=True)
class LapShape:
    """Dimensions of a lap joint, m; the hole is in the middle of the overlap.

    Parameters
    ----------
    length, width, thickness : float, lengths of each plate
    overlap : float, length along x on which the plates lie on each other, shorter than a plate
    hole, washer : float, diameters
    element : float, largest edge of an element in plan; elements on the hole are smaller
    layers : int, elements through each thickness

    Raises
    ------
    CaseError
        If the dimensions do not fit each other.
    """

    length: float
    width: float
    thickness: float
    overlap: float
    hole: float
    washer: float
    element: float
    layers: int = 2

    def __post_init__(self) -> None:
        if not 0.0 < self.hole < self.washer < min(self.overlap, self.width):
            raise CaseError(
                f"hole, washer and overlap must grow in this order, the washer within the width, "
                f"got {self.hole:g} m, {self.washer:g} m and {self.overlap:g} m on a width of "
                f"{self.width:g} m"
            )
        if not self.overlap < self.length:
            raise CaseError(
                f"the plates must be longer than their overlap ({self.overlap:g} m), got "
                f"{self.length:g} m"
            )
        if not (self.thickness > 0.0 and self.element > 0.0 and self.layers >= 1):
            raise CaseError(
                f"thickness, element and layers must be positive, got {self.thickness:g} m, "
                f"{self.element:g} m and {self.layers}"
            )


def lap_meshes(shape: LapShape) -> tuple["Mesh", "Mesh"]:
    """Mesh both plates by hexahedra; their faces match where they meet, at z = 0.

    Notes
    -----
    One plane mesh of quadrilaterals covers the overlap and the rest of each plate. Each plate is
    its part of it, drawn out downwards or upwards.
    """
    points, quads = _plan(shape)
    middle = points[0, quads].mean(axis=0)
    half = 0.5 * shape.overlap
    return (
        _draw_out(shape, points, quads[:, middle < half], -1.0),
        _draw_out(shape, points, quads[:, middle > -half], 1.0),
    )


def _plan(shape: LapShape) -> tuple[np.ndarray, np.ndarray]:
    """Points (2, n) and anticlockwise quadrilaterals (4, m) in plan."""
    half, out = 0.5 * shape.overlap, shape.length - shape.overlap
    with gmsh_model("lap joint") as gmsh:
        occ = gmsh.model.occ  # the overlap with hole and washer, between the rest of the plates
        sheets = [
            occ.addRectangle(x, -0.5 * shape.width, 0.0, long, shape.width)
            for x, long in ((-half - out, out), (-half, shape.overlap), (half, out))
        ]
        hole, washer = (
            occ.addDisk(0.0, 0.0, 0.0, 0.5 * diameter, 0.5 * diameter)
            for diameter in (shape.hole, shape.washer)
        )
        occ.cut([(2, sheets[1])], [(2, hole)], tag=OVERLAP, removeTool=False)
        occ.cut([(2, washer)], [(2, hole)], tag=RING)
        occ.fragment([(2, sheets[0]), (2, OVERLAP), (2, sheets[2])], [(2, RING)])
        occ.synchronize()
        # the recombination leaves triangles, which a subdivision of all makes quadrilaterals
        for name, value in (("RecombineAll", 1), ("SubdivisionAlgorithm", 1)):
            gmsh.option.setNumber(f"Mesh.{name}", value)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 2.0 * shape.element)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 8)
        gmsh.model.mesh.generate(2)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        corners = gmsh.model.mesh.getElementsByType(QUAD)[1]
    place = np.full(int(tags.max()) + 1, -1)
    place[tags] = np.arange(tags.size)
    points, quads = coordinates.reshape(-1, 3).T[:2], place[corners].reshape(-1, 4).T
    ax, ay = points[:, quads[2]] - points[:, quads[0]]
    bx, by = points[:, quads[3]] - points[:, quads[1]]
    return points, np.where(ax * by > ay * bx, quads, quads[::-1])


def _draw_out(shape: LapShape, points: np.ndarray, quads: np.ndarray, way: float) -> "Mesh":
    """Make a plate of hexahedra from z = 0 upwards (way 1) or downwards (way -1)."""
    from skfem import MeshHex

    used, local = np.unique(quads, return_inverse=True)
    local, plan, n = local.reshape(quads.shape), points[:, used], used.size
    heights = way * np.linspace(0.0, shape.thickness, shape.layers + 1)
    p = np.concatenate([np.tile(plan, heights.size), np.repeat(heights, n)[None]])
    floor, ceiling = (0, n) if way > 0.0 else (n, 0)  # of the first layer
    layers = [
        np.concatenate([local + floor + k * n, local + ceiling + k * n])
        for k in range(shape.layers)
    ]
    t = np.concatenate(layers, axis=1)[HEX_ORDER]
    mesh = MeshHex(np.ascontiguousarray(p), np.ascontiguousarray(t))
    corners = mesh.p[:, mesh.facets]  # (3, 4, facets)
    close, half = CLOSE * shape.overlap, 0.5 * shape.overlap
    inner, outer = np.abs(corners[2]) < close, np.abs(corners[2] - heights[-1]) < close
    radius = np.hypot(corners[0], corners[1])
    end = way * (shape.length - half)
    on = {
        "joint": inner & (np.abs(corners[0]) < half + close),
        "washer": outer & (radius < 0.5 * shape.washer + close),
        "end": np.abs(corners[0] - end) < close,
    }
    return mesh.with_boundaries({name: np.flatnonzero(at.all(axis=0)) for name, at in on.items()})
