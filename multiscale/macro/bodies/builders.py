"""Bodies with rough joints: stacked blocks, and a bolted lap joint meshed by gmsh."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.faces import face_of
from multiscale.fe.mesh_file import HEX_ORDER, box_mesh
from multiscale.io.gmsh_model import gmsh_model
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.bodies.assembly import Assembly, Bolt, Interface
from multiscale.macro.continuum.body import Body

if TYPE_CHECKING:
    from skfem import Mesh

TIMES = (0.0, 1.0)  # times of the load cases: a preload of 1 Pa, then a shear of 1 Pa
QUAD = 3  # element type of gmsh
OVERLAP, RING = 101, 102  # numbers of the surfaces with a hole
CLOSE = 1e-6  # distance from a face or circle, relative to the overlap, at which a node lies on it


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
                f"hole, washer and overlap must rise in this order, the washer within the width, "
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

    @property
    def ring(self) -> float:
        """Area under a washer, around the hole, m²."""
        return 0.25 * pi * (self.washer**2 - self.hole**2)


def stacked_blocks(
    size: tuple[float, float, float],
    elements: tuple[int, int, int],
    materials: Sequence[Elastic | AnisotropicElastic],
    laws: Sequence[InterfaceLaw],
) -> Assembly:
    """Stack equal blocks along z, with a rough joint below each but the first.

    The first block is clamped below. The other blocks are guided on their front face (no motion
    along y) and supported only by the joints; pressure and shear, along x, act on the top of the
    last block.

    Parameters
    ----------
    size : tuple of float, lengths of a block along x, y and z, m
    elements : tuple of int, hexahedra of a block along each axis
    materials : sequence of Elastic or AnisotropicElastic, of each block, two or more
    laws : sequence of InterfaceLaw, of each joint, from below
    """
    count = len(materials)
    if count < 2 or len(laws) != count - 1:
        raise CaseError(
            f"stacked blocks need two or more materials and a law for each joint between them, "
            f"got {count} materials and {len(laws)} laws"
        )
    bodies = []
    for place, material in enumerate(materials):
        mesh = box_mesh(size, elements, origin=(0.0, 0.0, place * size[2]))
        clamped = {"bottom": (0.0, 0.0, 0.0)}
        supports = clamped if place == 0 else {"front": (None, 0.0, None)}
        load = {"top": (1.0, 0.0, partial(_fading, -1.0))} if place == count - 1 else {}
        bodies.append(Body(mesh, material, supports=supports, tractions=load, bends=True))
    interfaces = [Interface((i, i + 1), ("top", "bottom"), law) for i, law in enumerate(laws)]
    area = size[0] * size[1]
    return Assembly(tuple(bodies), tuple(interfaces), TIMES, (area, area))


def lap_joint(
    shape: LapShape,
    materials: Sequence[Elastic | AnisotropicElastic],
    law: InterfaceLaw,
    shank: float | None = None,
) -> Assembly:
    """Mesh two plates that overlap, with a bolt hole through both and a rough joint between.

    The bolt is a pressure under its washers, on the ring around the hole on both outer faces, which
    does not change with the load, or, with a shank, a :class:`Bolt`. It carries no shear. The lower
    plate is clamped at its far end. The far end of the upper plate is guided along x, and the shear
    acts there.

    Parameters
    ----------
    shape : LapShape, dimensions and mesh
    materials : sequence of Elastic or AnisotropicElastic
        Elasticity of the lower and the upper plate.
    law : InterfaceLaw, on the whole overlap
    shank : float, optional, axial stiffness of the bolt, N/m; see :func:`shank_stiffness`

    Raises
    ------
    CaseError
        If the dimensions do not fit each other, or gmsh cannot be loaded.
    """
    lower, upper = lap_meshes(shape)
    # the force of the bolt on the ring of the mesh, a polygon
    meshed = np.linalg.norm(face_of(upper, "washer").normals, axis=1).sum()
    pressure = shape.ring / float(meshed)
    below = Body(
        lower,
        materials[0],
        supports={"end": (0.0, 0.0, 0.0)},
        tractions={} if shank else {"washer": (0.0, 0.0, partial(_fading, pressure))},
        bends=True,
    )
    pressed = {} if shank else {"washer": (0.0, 0.0, partial(_fading, -pressure))}
    above = Body(
        upper,
        materials[1],
        supports={"end": (None, 0.0, 0.0)},
        tractions=pressed | {"end": (1.0, 0.0, 0.0)},
        bends=True,
    )
    interface = Interface((0, 1), ("joint", "joint"), law)
    bolts = (Bolt((0, 1), ("washer", "washer"), shank, shape.ring),) if shank else ()
    areas = (shape.ring, shape.width * shape.thickness)
    return Assembly((below, above), (interface,), TIMES[bool(bolts) :], areas, bolts=bolts)


def _fading(direction: float, position: np.ndarray, time: float) -> np.ndarray:
    """Traction that falls to zero from time 0 to 1; worker processes import it."""
    return np.full(position.shape[1], direction * (1.0 - time))


def lap_meshes(shape: LapShape) -> tuple["Mesh", "Mesh"]:
    """Mesh both plates by hexahedra; their faces match in the overlap, at z = 0.

    A plane mesh of quadrilaterals covers the overlap and the rest of each plate. Each plate is an
    extrusion of its elements, downwards or upwards.
    """
    points, quads = _plan(shape)
    middle = points[0, quads].mean(axis=0)
    half = 0.5 * shape.overlap
    return (
        _extrude(shape, points, quads[:, middle < half], -1.0),
        _extrude(shape, points, quads[:, middle > -half], 1.0),
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
        # recombination leaves triangles; subdivision turns all elements into quadrilaterals
        for name, value in (("RecombineAll", 1), ("SubdivisionAlgorithm", 1)):
            gmsh.option.setNumber(f"Mesh.{name}", value)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 2.0 * shape.element)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 8)
        gmsh.model.mesh.generate(2)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        corners = gmsh.model.mesh.getElementsByType(QUAD)[1]

    # number nodes from 0, and turn all elements anticlockwise
    place = np.full(int(tags.max()) + 1, -1)
    place[tags] = np.arange(tags.size)
    points, quads = coordinates.reshape(-1, 3).T[:2], place[corners].reshape(-1, 4).T
    ax, ay = points[:, quads[2]] - points[:, quads[0]]
    bx, by = points[:, quads[3]] - points[:, quads[1]]
    return points, np.where(ax * by > ay * bx, quads, quads[::-1])


def _extrude(shape: LapShape, points: np.ndarray, quads: np.ndarray, way: float) -> "Mesh":
    """Extrude a plate of hexahedra from z = 0 upwards (way 1) or downwards (way -1)."""
    from skfem import MeshHex

    # layers of hexahedra
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

    # boundaries: the joint at z = 0, the ring under the washer, the far end
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
