"""Meshes with named boundaries, from gmsh or any file that meshio reads."""

from contextlib import redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError

if TYPE_CHECKING:
    from meshio import Mesh

__all__ = ["MeshArrays", "open_mesh", "read_mesh"]

SOLIDS = ("hexahedron", "tetra", "quad", "triangle")
"""Elements of a body, three dimensions before two."""

FACETS = {"hexahedron": "quad", "tetra": "triangle", "quad": "line", "triangle": "line"}
"""Facets of these elements."""

DIMENSIONS = {"hexahedron": 3, "tetra": 3, "quad": 2, "triangle": 2, "line": 1}


@dataclass(frozen=True)
class MeshArrays:
    """A mesh as plain arrays.

    Attributes
    ----------
    kind : str
        ``"triangle"``, ``"quad"``, ``"tetra"`` or ``"hexahedron"``.
    points : ndarray, shape (d, n)
        Coordinates of the corners in the unit of the file.
    cells : ndarray of int, shape (elements, corners)
        Corners in the order of VTK.
    boundaries : dict of str to ndarray of int, shape (facets, corners)
        Corners of the facets of every named boundary.
    volumes : dict of str to ndarray of int, shape (elements,)
        Elements of every named set of them.
    """

    kind: str
    points: np.ndarray
    cells: np.ndarray
    boundaries: dict[str, np.ndarray]
    volumes: dict[str, np.ndarray] = field(default_factory=dict)


def open_mesh(path: Path) -> "Mesh":
    """Read a mesh of any elements with its named sets.

    Parameters
    ----------
    path : Path
        A file of any format that meshio reads.

    Raises
    ------
    CaseError
        If the file is missing or cannot be read.
    """
    import meshio

    if not path.is_file():
        raise CaseError(f"no mesh file {path}")
    try:
        with redirect_stdout(StringIO()):  # it prints an empty line for each file of gmsh
            return meshio.read(path)
    except (meshio.ReadError, OSError, SystemExit) as error:
        raise CaseError(f"{path} cannot be read as a mesh: {error or 'unknown format'}") from error


def read_mesh(path: Path, volume: str = "") -> MeshArrays:
    """Read a mesh of one kind of element with its named boundaries.

    In gmsh a physical group of lines or surfaces names a boundary, and the solid needs its own
    physical group, since gmsh writes no other elements.

    Parameters
    ----------
    path : Path
        A ``.msh`` file of gmsh or any other file that meshio reads.
    volume : str
        Named group of solid elements that is read; all of them if not given.

    Returns
    -------
    MeshArrays
        The mesh without points that no element uses; a mesh in the plane z = const has two
        dimensions.

    Raises
    ------
    CaseError
        If the file cannot be read, has no solid elements, or has two kinds of them, or no such
        volume.
    """
    mesh = open_mesh(path)
    found = {name: block for name, block in mesh.cells_dict.items() if len(block)}
    kinds = [name for name in SOLIDS if name in found]
    solids = [name for name in kinds if name not in {FACETS[kind] for kind in kinds}]
    if len(solids) != 1:
        raise CaseError(
            f"{path}: a body needs elements of one kind out of {', '.join(SOLIDS)} (first order, "
            f"without nodes on edges), got {sorted(found)}"
        )
    kind = solids[0]
    cells, volumes = found[kind], _named_blocks(mesh, kind, corners=False)
    if volume:
        if volume not in volumes:
            raise CaseError(
                f"{path}: no volume {volume!r} of {kind} elements is named; its volumes are "
                f"{sorted(volumes)}"
            )
        cells, volumes = cells[volumes[volume]], {}
    used, renumbered = np.unique(cells, return_inverse=True)
    points = mesh.points[used].T
    if kind in ("triangle", "quad"):
        if len(points) == 3 and np.ptp(points[2]) > 1e-9 * np.ptp(points[:2], axis=1).max():
            raise CaseError(f"{path}: {kind}s must lie in a plane z = const, got a curved shell")
        points = points[:2]
    number = np.full(len(mesh.points), -1)
    number[used] = np.arange(len(used))
    boundaries = {
        name: number[facets]
        for name, facets in _named_blocks(mesh, FACETS[kind], corners=True).items()
        if len(facets) and np.all(number[facets] >= 0)
    }
    return MeshArrays(
        kind,
        np.ascontiguousarray(points),
        renumbered.reshape(cells.shape),
        boundaries,
        volumes,
    )


def _named_blocks(mesh: Any, kind: str, *, corners: bool) -> dict[str, np.ndarray]:
    """Elements of one kind by the name of their group: their corners, or their numbers."""
    members = {name: sets for name, sets in mesh.cell_sets.items() if ":" not in name}
    groups = mesh.cell_data.get("gmsh:physical")
    if groups is not None:  # older gmsh formats store numbers, and the names elsewhere
        for name, (tag, dimension) in mesh.field_data.items():
            if dimension != DIMENSIONS[kind]:  # groups of several dimensions may share a number
                continue
            members.setdefault(name, [np.flatnonzero(group == tag) for group in groups])
    named: dict[str, list[np.ndarray]] = {}
    for name, sets in members.items():
        before = 0
        for block, chosen in zip(mesh.cells, sets, strict=True):
            if block.type != kind:
                continue
            if chosen is not None and len(chosen):
                index = np.asarray(chosen, dtype=int)
                named.setdefault(name, []).append(block.data[index] if corners else before + index)
            before += len(block.data)
    return {name: np.concatenate(parts) for name, parts in named.items()}
