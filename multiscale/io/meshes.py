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

CURVED = {"hexahedron20": "hexahedron", "hexahedron27": "hexahedron", "tetra10": "tetra"}
"""Elements of second order, which have nodes between the corners of these elements."""

CURVED_FACETS = {"hexahedron20": "quad8", "hexahedron27": "quad9", "tetra10": "triangle6"}
"""Facets of elements of second order."""

SHAPES = CURVED | {"quad8": "quad", "quad9": "quad", "triangle6": "triangle"}
"""Elements of first order with the corners of elements of second order."""

CORNERS = {"hexahedron": 8, "tetra": 4, "quad": 4, "triangle": 3, "line": 2}

DIMENSIONS = {"hexahedron": 3, "tetra": 3, "quad": 2, "triangle": 2, "line": 1}


@dataclass(frozen=True)
class MeshArrays:
    """A mesh as plain arrays.

    Attributes
    ----------
    kind : str, ``"triangle"``, ``"quad"``, ``"tetra"`` or ``"hexahedron"``
    points : ndarray, shape (d, n), coordinates of the corners in the unit of the file
    cells : ndarray of int, shape (elements, corners), corners in the order of VTK
    boundaries : dict of str to ndarray of int, shape (facets, corners)
        Corners of the facets of every named boundary.
    volumes : dict of str to ndarray of int, shape (elements,), elements of every named set of them
    middles : ndarray, shape (d, elements, nodes), optional
        Coordinates of the nodes between the corners of elements of second order, in the order of
        VTK: of edges, of faces and inside.
    """

    kind: str
    points: np.ndarray
    cells: np.ndarray
    boundaries: dict[str, np.ndarray]
    volumes: dict[str, np.ndarray] = field(default_factory=dict)
    middles: np.ndarray | None = None


def open_mesh(path: Path) -> "Mesh":
    """Read a mesh of any elements with its named sets.

    Parameters
    ----------
    path : Path, a file of any format that meshio reads

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


def read_mesh(path: Path, volume: str = "", *, curved: bool = False) -> MeshArrays:
    """Read a mesh of one kind of element with its named boundaries.

    In gmsh a physical group of lines or surfaces names a boundary, and the solid needs its own
    physical group, since gmsh writes no other elements.

    Parameters
    ----------
    path : Path, a ``.msh`` file of gmsh or any other file that meshio reads
    volume : str, named group of solid elements that is read; all of them if not given
    curved : bool, whether elements of second order are read, too

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
    kinds = [name for name in (*(CURVED if curved else ()), *SOLIDS) if name in found]
    solids = [name for name in kinds if name not in {FACETS.get(kind) for kind in kinds}]
    if len(solids) != 1:
        raise CaseError(
            f"{path}: a body needs elements of one kind out of {', '.join(SOLIDS)} "
            + ("or of their second order" if curved else "(first order, without nodes on edges)")
            + f", got {sorted(found)}"
        )
    full = solids[0]
    kind, facet = CURVED.get(full, full), CURVED_FACETS.get(full) or FACETS[full]
    cells, volumes = found[full], _named_blocks(mesh, full, corners=False)
    if volume:
        if volume not in volumes:
            raise CaseError(
                f"{path}: no volume {volume!r} of {kind} elements is named; its volumes are "
                f"{sorted(volumes)}"
            )
        cells, volumes = cells[volumes[volume]], {}
    middles = None
    if full in CURVED:
        cells, between = cells[:, : CORNERS[kind]], cells[:, CORNERS[kind] :]
        middles = np.moveaxis(mesh.points[between], 2, 0)
    used, renumbered = np.unique(cells, return_inverse=True)
    points = mesh.points[used].T
    if kind in ("triangle", "quad"):
        if len(points) == 3 and np.ptp(points[2]) > 1e-9 * np.ptp(points[:2], axis=1).max():
            raise CaseError(f"{path}: {kind}s must lie in a plane z = const, got a curved shell")
        points = points[:2]
    number = np.full(len(mesh.points), -1)
    number[used] = np.arange(len(used))
    boundaries = {
        name: number[facets[:, : CORNERS[FACETS[kind]]]]
        for name, facets in _named_blocks(mesh, facet, corners=True).items()
        if len(facets) and np.all(number[facets[:, : CORNERS[FACETS[kind]]]] >= 0)
    }
    return MeshArrays(
        kind,
        np.ascontiguousarray(points),
        renumbered.reshape(cells.shape),
        boundaries,
        volumes,
        middles,
    )


def _named_blocks(mesh: Any, kind: str, *, corners: bool) -> dict[str, np.ndarray]:
    """Elements of one kind by the name of their group: their corners, or their numbers."""
    members = {name: sets for name, sets in mesh.cell_sets.items() if ":" not in name}
    groups = mesh.cell_data.get("gmsh:physical")
    if groups is not None:  # older gmsh formats store numbers, and the names elsewhere
        for name, (tag, dimension) in mesh.field_data.items():
            if (
                dimension != DIMENSIONS[SHAPES.get(kind, kind)]
            ):  # groups of several dimensions may share a number
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
