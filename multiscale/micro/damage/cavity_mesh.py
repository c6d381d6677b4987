"""Periodic tetrahedral meshes of a volume with cavities and cracks, by gmsh."""

from dataclasses import replace
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.io.gmsh_model import gmsh_model
from multiscale.micro.damage.cavities import Cavities
from multiscale.micro.damage.crack_faces import CrackedMesh, open_cracks
from multiscale.micro.damage.section_plane import SectionPlane
from multiscale.micro.damage.sections import box_polygon
from multiscale.micro.damage.shapes import NEGLIGIBLE, Cracks, Cylinders, Ellipsoids, Shapes

__all__ = ["mesh_cavities"]

FRONT_ELEMENT_SIZE = 0.15
"""Size of the elements at the front of a crack, relative to its smaller semi-axis."""

ELEMENTS_PER_CIRCLE = 14  # smallest number of elements around a full circle of a cavity


def mesh_cavities(rve: Cavities, element_size: float) -> CrackedMesh:
    """Mesh the solid of a periodic volume, with equal meshes on opposite faces."""
    if not (element_size > 0.0 and np.isfinite(element_size)):
        raise CaseError(f"element_size must be positive (m), got {element_size:g}")
    for kind in rve.images:
        if isinstance(kind, Cracks):
            flat = kind.reach < NEGLIGIBLE * kind.reach.max(axis=1, keepdims=True)
            on = np.minimum(np.abs(kind.centre), np.abs(kind.centre - rve.size))
            if np.any(flat & (on < NEGLIGIBLE * np.array(rve.size))):
                raise CaseError(
                    "a crack lies in a face of the box; shift all bodies, which does not change a "
                    "periodic volume"
                )
    length = max(rve.size)  # gmsh's tolerances are absolute: mesh in units of the longest edge
    with gmsh_model("volume") as gmsh:
        try:
            discs = _geometry(gmsh, rve, length)
            _match_faces(gmsh, np.array(rve.size) / length)
            _sizes(gmsh, rve, element_size / length, discs, length)
            gmsh.model.mesh.generate(3)
        except CaseError:
            raise
        except Exception as error:  # gmsh raises bare Exceptions
            raise CaseError(
                f"gmsh could not mesh the volume ({str(error).splitlines()[0]}); change "
                f"element_size or move bodies that nearly touch"
            ) from error
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        kinds, _, nodes = gmsh.model.mesh.getElements(3)
        triangles = [gmsh.model.mesh.getElements(2, surface)[2][0] for surface, _ in discs]
    corners = next(n for kind, n in zip(kinds, nodes, strict=True) if kind == 4).reshape(-1, 4)
    used = np.unique(corners)
    order = np.argsort(tags)[np.searchsorted(np.sort(tags), used)]
    points = coordinates.reshape(-1, 3)[order].T
    on_cracks = np.concatenate([np.empty(0, dtype=used.dtype), *triangles]).reshape(-1, 3)
    cells, facets = (np.searchsorted(used, one).T.copy() for one in (corners, on_cracks))
    mesh = open_cracks(points, cells, facets, np.array(rve.size) / length)
    if facets.size and mesh.points.shape[1] == points.shape[1]:
        raise CaseError("no crack has a node inside it; make element_size smaller than the cracks")
    return replace(mesh, points=length * mesh.points)


def _geometry(gmsh: Any, rve: Cavities, length: float) -> list[tuple[int, list[int]]]:
    """Build the solid; return the surfaces of cracks, each with its curves inside the box."""
    occ = gmsh.model.occ
    box = (3, occ.addBox(0.0, 0.0, 0.0, *(np.array(rve.size) / length)))
    tools: list[tuple[int, int]] = []
    discs: list[tuple[int, int]] = []
    for kind in rve.images:
        if isinstance(kind, Cracks):
            for k in _visible(kind, np.array(rve.size)):
                discs.append((2, occ.addDisk(0.0, 0.0, 0.0, 1.0, 1.0)))
                p, q = kind.root[k].T / length
                n = np.cross(p, q)
                axes = np.stack([p, q, n / np.linalg.norm(n) * np.linalg.norm(p)], axis=1)
                _place(occ, discs[-1], axes, kind.centre[k] / length)
        else:
            count = range(len(kind.centre))
            tools += [(3, _solid(occ, kind, k, length, rve)) for k in count]
    solid = occ.cut([box], tools)[0] if tools else [box]
    if not solid:
        raise CaseError("the cavities leave no solid; make them smaller")
    parts = occ.intersect(discs, solid, removeTool=False)[0] if discs else []
    if parts:
        _, origin = occ.fragment(solid, parts)
        parts = list(dict.fromkeys(piece for pieces in origin[len(solid) :] for piece in pieces))
    occ.synchronize()
    size, margin = np.array(rve.size) / length, 1e-6  # gmsh's boxes are wider by 1e-7
    found = []
    for _, surface in parts:
        inside = []
        for _, curve in gmsh.model.getBoundary([(2, surface)], oriented=False):
            ends = np.array(gmsh.model.getBoundingBox(1, curve)).reshape(2, 3)
            on_face = [np.all(np.abs(ends - side) < margin, axis=0) for side in (0.0, size)]
            if not np.any(on_face):
                inside.append(curve)
        found.append((surface, inside))
    return found


def _visible(cracks: Cracks, size: np.ndarray) -> list[int]:
    """List the cracks, except cracks that lie in another one through the whole box."""
    normal, centre = cracks.normal, cracks.centre
    visible: list[int] = []
    whole = np.zeros(len(centre), dtype=bool)
    for k, root in enumerate(cracks.root):
        plane = SectionPlane.through(centre[k], normal[k])
        corners = np.linalg.pinv(root) @ (box_polygon(plane, size) @ plane.frame).T
        whole[k] = np.all(np.linalg.norm(corners, axis=0) <= 1.0)
    for k in np.argsort(~whole, kind="stable"):
        others = [j for j in visible if whole[j]]
        parallel = np.abs(normal[others] @ normal[k]) > 1.0 - NEGLIGIBLE
        away = np.abs((centre[others] - centre[k]) @ normal[k])
        if not np.any(parallel & (away < NEGLIGIBLE * size.max())):
            visible.append(int(k))
    return visible


def _solid(occ: Any, kind: Shapes, k: int, length: float, rve: Cavities) -> int:
    """Add cavity k and return its tag."""
    centre = kind.centre[k] / length
    if isinstance(kind, Cylinders):
        half = min(float(kind.half_length[k]), 2.0 * float(np.linalg.norm(rve.size))) / length
        start, along = centre - half * kind.axis[k], 2.0 * half * kind.axis[k]
        return int(occ.addCylinder(*start, *along, float(kind.radius[k]) / length))
    assert isinstance(kind, Ellipsoids)
    radius = float(np.linalg.norm(kind.root[k], 2)) / length
    if np.allclose(kind.root[k] @ kind.root[k].T, (radius * length) ** 2 * np.eye(3)):
        return int(occ.addSphere(*centre, radius))
    ball = int(occ.addSphere(0.0, 0.0, 0.0, 1.0))
    _place(occ, (3, ball), kind.root[k] / length, centre)
    return ball


def _place(occ: Any, entity: tuple[int, int], matrix: np.ndarray, centre: np.ndarray) -> None:
    """Map the points x of a unit shape to centre + matrix x."""
    affine = np.zeros((3, 4))
    affine[:, :3], affine[:, 3] = matrix, centre
    occ.affineTransform([entity], [*affine.ravel(), 0.0, 0.0, 0.0, 1.0])


def _match_faces(gmsh: Any, size: np.ndarray) -> None:
    """Declare opposite faces with equal centres and areas as periodic in gmsh."""
    faces = {
        tag: np.array([*gmsh.model.occ.getCenterOfMass(2, tag), gmsh.model.occ.getMass(2, tag)])
        for _, tag in gmsh.model.getEntities(2)
        if gmsh.model.getType(2, tag) == "Plane"
    }
    margin = 1e-6
    for axis in range(3):
        shift = np.zeros(4)
        shift[axis] = size[axis]
        affine = np.eye(4)
        affine[:3, 3] = shift[:3]
        for near, place in faces.items():
            if abs(place[axis]) > margin:
                continue
            for far, other in faces.items():
                if np.abs(other - place - shift).max() < margin:
                    gmsh.model.mesh.setPeriodic(2, [far], [near], affine.ravel())


def _sizes(
    gmsh: Any, rve: Cavities, element_size: float, discs: list[tuple[int, list[int]]], length: float
) -> None:
    """Set the size of the elements, smaller near the fronts of cracks."""
    gmsh.option.setNumber("Mesh.MeshSizeMax", element_size)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", ELEMENTS_PER_CIRCLE)
    gmsh.option.setNumber("Mesh.Algorithm3D", 1)
    axes = [
        np.linalg.norm(kind.root, axis=1).min() for kind in rve.bodies if isinstance(kind, Cracks)
    ]
    curves = [tag for _, front in discs for tag in front]
    if not curves:
        return
    smallest = float(min(axes)) / length
    field = gmsh.model.mesh.field
    distance, threshold = field.add("Distance"), field.add("Threshold")
    field.setNumbers(distance, "CurvesList", curves)
    field.setNumber(distance, "Sampling", 200)
    field.setNumber(threshold, "InField", distance)
    field.setNumber(threshold, "SizeMin", min(element_size, FRONT_ELEMENT_SIZE * smallest))
    field.setNumber(threshold, "SizeMax", element_size)
    field.setNumber(threshold, "DistMin", 0.0)
    field.setNumber(threshold, "DistMax", smallest)
    field.setAsBackgroundMesh(threshold)
