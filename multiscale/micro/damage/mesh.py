"""Periodic tetrahedral meshes of a volume with cavities and cracks, by gmsh."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.damage.bodies import Bodies, Cracks, Cylinders, Ellipsoids
from multiscale.micro.damage.cavities import Cavities

__all__ = ["CrackedMesh", "mesh_cavities"]

FRONT = 0.15
"""Size of the elements at the front of a crack over its smaller semi-axis."""


ROUND = 14
"""Elements around a full circle of a cavity, at least."""


@dataclass(frozen=True)
class CrackedMesh:
    """Tetrahedra of a volume whose cracks are open.

    Attributes
    ----------
    points : ndarray, shape (3, n)
        Corners, m; on a crack there are two at one place.
    cells : ndarray of int, shape (4, elements)
        Corners of the elements.
    front : ndarray of int
        Corners on the fronts of cracks.
    """

    points: np.ndarray
    cells: np.ndarray
    front: np.ndarray


def mesh_cavities(rve: Cavities, element_size: float) -> CrackedMesh:
    """Mesh the solid of a periodic volume, opposite faces alike.

    Parameters
    ----------
    rve : Cavities
        Ellipsoids and cylinders may reach through the faces of the box; cracks lie inside it.
    element_size : float
        Edge of the elements, m; smaller at the fronts of cracks.

    Returns
    -------
    CrackedMesh
        Corners on flat cracks are doubled, but not on their fronts.

    Raises
    ------
    CaseError
        If a crack reaches a face, the element size is not positive, the solid cannot be meshed,
        or gmsh cannot be loaded.
    """
    if not (element_size > 0.0 and np.isfinite(element_size)):
        raise CaseError(f"element_size must be positive (m), got {element_size:g}")
    _check_cracks(rve)
    length = max(rve.size)  # gmsh's tolerances are absolute: mesh in units of the longest edge
    with _model() as gmsh:
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
        points, cells, number = _arrays(gmsh)
        cracks = [kind for kind in rve.images if isinstance(kind, Cracks)]
        normals = np.concatenate([np.empty((0, 3)), *(kind.normal for kind in cracks)])
        fronts = [np.empty(0, dtype=int)]
        for (surface, _), normal in zip(discs, normals, strict=True):
            fronts.append(_front(gmsh, number, surface))
            points, cells = _open_crack(gmsh, points, cells, number, surface, normal)
    return CrackedMesh(length * points, cells, np.concatenate(fronts))


@contextmanager
def _model() -> Iterator[Any]:
    """Open an empty model of gmsh, which leaves the signals of the process as they were."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise CaseError(
            f"the mesh generator gmsh cannot be loaded ({error}); install gmsh and the system's "
            f"libglu1-mesa, libxrender1, libxcursor1, libxft2 and libxinerama1"
        ) from error
    started = not gmsh.isInitialized()
    if started:
        main = threading.current_thread() is threading.main_thread()
        before = signal.getsignal(signal.SIGPIPE) if main else None
        gmsh.initialize(interruptible=False)
        if before is not None:
            signal.signal(signal.SIGPIPE, before)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("volume")
    try:
        yield gmsh
    finally:
        gmsh.model.remove()
        if started:
            gmsh.finalize()


def _check_cracks(rve: Cavities) -> None:
    """Refuse cracks that reach a face of the box."""
    for kind in rve.bodies:
        if isinstance(kind, Cracks):
            low, high = kind.centre - kind.reach, kind.centre + kind.reach
            out = np.any((low <= 0.0) | (high >= rve.size), axis=1)
            if out.any():
                raise CaseError(
                    f"crack {int(np.argmax(out))} reaches a face of the box; shift the volume so "
                    f"that cracks lie inside, or use a voxel image"
                )


def _geometry(gmsh: Any, rve: Cavities, length: float) -> list[tuple[int, list[int]]]:
    """Build the solid; return surface and front curves of each crack."""
    occ = gmsh.model.occ
    box = (3, occ.addBox(0.0, 0.0, 0.0, *(np.array(rve.size) / length)))
    tools: list[tuple[int, int]] = []
    discs: list[tuple[int, int]] = []
    for kind in rve.images:
        for k in range(len(kind.centre)):
            if isinstance(kind, Cracks):
                discs.append((2, _disc(occ, kind, k, length)))
            else:
                tools.append((3, _solid(occ, kind, k, length, rve)))
    solid = occ.cut([box], tools)[0] if tools else [box]
    if not solid:
        raise CaseError("the cavities leave no solid; make them smaller")
    surfaces = []
    if discs:
        _, origin = occ.fragment(solid, discs)
        surfaces = list(origin[len(solid) :])
        if any(len(parts) != 1 for parts in surfaces):
            raise CaseError("cracks meet each other or a cavity; move them apart to mesh them")
    occ.synchronize()
    return [
        (parts[0][1], [tag for _, tag in gmsh.model.getBoundary(parts, oriented=False)])
        for parts in surfaces
    ]


def _solid(occ: Any, kind: Bodies, k: int, length: float, rve: Cavities) -> int:
    """Add a cavity."""
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


def _disc(occ: Any, kind: Cracks, k: int, length: float) -> int:
    """Add a flat elliptic surface."""
    p, q = kind.root[k].T / length
    disc = int(occ.addDisk(0.0, 0.0, 0.0, 1.0, 1.0))
    normal = np.cross(p, q)
    _place(
        occ,
        (2, disc),
        np.stack([p, q, normal / np.linalg.norm(normal) * np.linalg.norm(p)], axis=1),
        kind.centre[k] / length,
    )
    return disc


def _place(occ: Any, entity: tuple[int, int], matrix: np.ndarray, centre: np.ndarray) -> None:
    """Map the unit shape to centre + matrix x."""
    affine = np.zeros((3, 4))
    affine[:, :3], affine[:, 3] = matrix, centre
    occ.affineTransform([entity], [*affine.ravel(), 0.0, 0.0, 0.0, 1.0])


def _match_faces(gmsh: Any, size: np.ndarray) -> None:
    """Tell gmsh which faces are copies of each other, by their centres and areas."""
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
    gmsh: Any,
    rve: Cavities,
    element_size: float,
    discs: list[tuple[int, list[int]]],
    length: float,
) -> None:
    """Set the size of the elements, smaller near the fronts of cracks."""
    gmsh.option.setNumber("Mesh.MeshSizeMax", element_size)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", ROUND)
    gmsh.option.setNumber("Mesh.Algorithm3D", 1)
    if not discs:
        return
    axes = [
        np.linalg.norm(kind.root, axis=1).min() for kind in rve.bodies if isinstance(kind, Cracks)
    ]
    smallest = float(min(axes)) / length
    field = gmsh.model.mesh.field
    distance, threshold = field.add("Distance"), field.add("Threshold")
    field.setNumbers(distance, "CurvesList", [tag for _, front in discs for tag in front])
    field.setNumber(distance, "Sampling", 200)
    field.setNumber(threshold, "InField", distance)
    field.setNumber(threshold, "SizeMin", min(element_size, FRONT * smallest))
    field.setNumber(threshold, "SizeMax", element_size)
    field.setNumber(threshold, "DistMin", 0.0)
    field.setNumber(threshold, "DistMax", smallest)
    field.setAsBackgroundMesh(threshold)


def _arrays(gmsh: Any) -> tuple[np.ndarray, np.ndarray, dict[int, int]]:
    """Return points, cells and the number of the point that each node of gmsh became."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    kinds, _, nodes = gmsh.model.mesh.getElements(3)
    corners = next(n for kind, n in zip(kinds, nodes, strict=True) if kind == 4).reshape(-1, 4)
    used = np.unique(corners)
    number = {int(tag): k for k, tag in enumerate(used)}
    order = np.searchsorted(np.sort(tags), used)
    points = coordinates.reshape(-1, 3)[np.argsort(tags)][order].T
    return points, np.searchsorted(used, corners).T.copy(), number


def _front(gmsh: Any, number: dict[int, int], surface: int) -> np.ndarray:
    """Corners on the edge of a crack."""
    inside, _, _ = gmsh.model.mesh.getNodes(2, surface, includeBoundary=False)
    whole, _, _ = gmsh.model.mesh.getNodes(2, surface, includeBoundary=True)
    return np.array([number[int(tag)] for tag in np.setdiff1d(whole, inside)], dtype=int)


def _open_crack(
    gmsh: Any,
    points: np.ndarray,
    cells: np.ndarray,
    number: dict[int, int],
    surface: int,
    normal: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Double the corners inside a crack and give the copies to the elements above it."""
    inside, _, _ = gmsh.model.mesh.getNodes(2, surface, includeBoundary=False)
    doubled = np.array([number[int(tag)] for tag in inside], dtype=int)
    if doubled.size == 0:
        raise CaseError("a crack has no node inside it; make element_size smaller than the crack")
    copy = np.arange(points.shape[1])
    copy[doubled] = points.shape[1] + np.arange(doubled.size)
    touching = np.isin(cells, doubled)
    centre = points[:, cells].mean(axis=1)
    above = normal @ (centre - points[:, doubled[:1]]) > 0.0
    cells = np.where(touching & above, copy[cells], cells)
    return np.hstack([points, points[:, doubled]]), cells
