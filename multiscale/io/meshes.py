"""Bodies with named boundaries from mesh files of gmsh, Abaqus, Salome and others."""

import warnings
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from multiscale.errors import CaseError, listed
from multiscale.io.files import check_file, system_reason
from multiscale.io.gmsh_model import write_whole_mesh
from multiscale.io.mesh_deck import read_deck
from multiscale.io.mesh_groups import CORNERS, NamedMesh, named_mesh

SHAPES = {
    **dict.fromkeys(("hexahedron", "hexahedron20", "hexahedron27"), "hexahedron"),
    **dict.fromkeys(("tetra", "tetra10"), "tetra"),
    **dict.fromkeys(("quad", "quad8", "quad9"), "quad"),
    **dict.fromkeys(("triangle", "triangle6"), "triangle"),
    **dict.fromkeys(("line", "line3"), "line"),
}
"""Elements of first order with the corners of elements of first and second order."""

FACETS = {"hexahedron": "quad", "tetra": "triangle", "quad": "line", "triangle": "line"}
"""Bodies and their facets."""

CURVED = ("hexahedron20", "hexahedron27", "tetra10")  # solids of second order

SOLIDS, PLATES = ("hexahedron", "tetra", "wedge", "pyramid", "poly"), ("quad", "triangle")
"""Beginnings of the kinds of elements of three and of two dimensions."""

HEADS = {
    ".msh": (b"$MeshFormat", b"$NOD", b"$Comments"),
    **dict.fromkeys((".med", ".mmed", ".rmed", ".cgns"), (b"\x89HDF",)),
    ".unv": (b"",),
}
"""First bytes of meshes that gmsh reads; it would run another text as a script."""


@dataclass(frozen=True)
class MeshArrays:
    """A mesh of a single kind of element as plain arrays, coordinates in the unit of the file."""

    kind: str  # "triangle", "quad", "tetra" or "hexahedron"
    points: np.ndarray  # (d, n), coordinates of the corners
    cells: np.ndarray  # (elements, corners), corners in the order of VTK
    boundaries: dict[str, np.ndarray]  # (facets, corners) of every named boundary
    volumes: dict[str, np.ndarray] = field(default_factory=dict)  # elements of every named set
    node_sets: dict[str, np.ndarray] = field(default_factory=dict)  # corners of every named set
    # (d, elements, nodes) of elements of second order: nodes of edges, of faces and inside, as VTK
    middles: np.ndarray | None = None


def open_mesh(path: Path) -> NamedMesh:
    """Read a mesh of any elements with its named groups."""
    check_file(path, "mesh file")
    try:
        with path.open("rb") as file:
            head = file.read(64)
            file.seek(max(0, file.seek(0, 2) - 64))
            tail = file.read().rstrip()
    except OSError as error:
        raise CaseError(f"{path}: {system_reason(error)}") from error
    if path.suffix.lower() == ".inp" or head.lstrip().startswith(b"*"):
        return read_deck(path)
    try:
        mesh = _read_by_meshio_or_gmsh(path, head, tail)
    except CaseError as error:
        raise CaseError(f"{path} cannot be read as a mesh: {error}") from error
    for kind, nodes in mesh.cells.items():
        if nodes.min() < 0 or nodes.max() >= len(mesh.points):
            raise CaseError(f"{path}: an element ({kind}) has a node that the file does not define")
    return mesh


def _read_by_meshio_or_gmsh(path: Path, head: bytes, tail: bytes) -> NamedMesh:
    """Read a file by meshio, or by gmsh if its first bytes, ``head``, are of a format of gmsh."""
    try:
        return _read_by_meshio(path)
    except CaseError as error:
        if path.suffix == ".unv" and not tail.endswith(b"-1"):
            raise CaseError("the file ends too early") from error
        if not head.startswith(HEADS.get(path.suffix, ())):
            raise
    with TemporaryDirectory() as folder:
        converted = Path(folder) / "mesh.msh"
        write_whole_mesh(path, converted)
        return _read_by_meshio(converted)


def _read_by_meshio(path: Path) -> NamedMesh:
    """Read a file without prints and warnings; the error has the reason that meshio gives."""
    import meshio

    printed = StringIO()
    try:
        with redirect_stdout(printed), redirect_stderr(StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return named_mesh(meshio.read(path))
    except (meshio.ReadError, ImportError, OSError) as error:
        raise CaseError(str(error).rstrip(".")) from error
    except SystemExit as error:  # a file that is of none of the formats of its ending
        reasons = filter(None, (line.strip() for line in printed.getvalue().splitlines()))
        raise CaseError("; ".join(reasons) or "no format of its ending") from error
    except Exception as error:  # damaged files make meshio fail in any way
        raise CaseError(
            f"meshio stops with {type(error).__name__} ({str(error) or 'no reason given'}), so "
            f"the file is damaged or of an unknown variant; save it as .msh, .med or .inp"
        ) from error


def read_mesh(path: Path, volume: str = "", *, curved: bool = False) -> MeshArrays:
    """Read a body of a single kind of element with its named boundaries."""
    mesh = open_mesh(path)
    # elements of the body, and their corners without points that no element uses
    full, chosen = _select(mesh, path, volume)
    kind = SHAPES[full]
    cells = mesh.cells[full][chosen]
    middles = None
    if curved and full in CURVED:
        middles = np.moveaxis(mesh.points[cells[:, CORNERS[kind] :]], 2, 0)
    cells = cells[:, : CORNERS[kind]]
    used, renumbered = np.unique(cells, return_inverse=True)
    points = mesh.points[used].T
    if not np.all(np.isfinite(points)):
        raise CaseError(f"{path}: the nodes of the body have coordinates that are not finite")
    if kind in PLATES:
        if len(points) == 3 and np.ptp(points[2]) > 1e-9 * np.ptp(points[:2], axis=1).max():
            raise CaseError(
                f"{path}: {kind}s must lie in a plane z = const, got a curved shell; mesh the "
                f"volume that it bounds"
            )
        points = points[:2]
    number = np.full(len(mesh.points), -1)
    number[used] = np.arange(len(used))

    # facets of the body, with all corners in it
    boundaries: dict[str, list[np.ndarray]] = {}
    for name, members in mesh.groups.items():
        for facet, numbers in members.items():
            if SHAPES.get(facet) == FACETS[kind]:
                corners = number[mesh.cells[facet][numbers, : CORNERS[FACETS[kind]]]]
                facets = corners[np.all(corners >= 0, axis=1)]
                if len(facets):
                    boundaries.setdefault(name, []).append(facets)
    nodes = {name: number[points] for name, points in mesh.node_sets.items()}
    return MeshArrays(
        kind,
        np.ascontiguousarray(points),
        renumbered.reshape(cells.shape),
        {name: np.concatenate(facets) for name, facets in boundaries.items()},
        {}
        if volume
        else {name: kinds[full] for name, kinds in mesh.groups.items() if full in kinds},
        {name: numbers[numbers >= 0] for name, numbers in nodes.items()},
        middles,
    )


def _select(mesh: NamedMesh, path: Path, volume: str) -> tuple[str, np.ndarray]:
    """Kind of the elements of a body, and their numbers."""
    whole = {kind: np.arange(len(cells)) for kind, cells in mesh.cells.items()}
    solid = any(kind.startswith(SOLIDS) for kind in whole)
    bodies = [kind for kind in whole if kind.startswith(SOLIDS if solid else PLATES)]
    named = {
        name: {kind: members for kind, members in kinds.items() if kind in bodies}
        for name, kinds in mesh.groups.items()
    }
    named = {name: kinds for name, kinds in named.items() if kinds}
    by_kind: dict[str, dict[str, np.ndarray]] = {}
    for kind in bodies:
        by_kind.setdefault(SHAPES.get(kind, kind), {})[kind] = whole[kind]
    selected = {kind: whole[kind] for kind in bodies}
    if volume in {**by_kind, **named}:
        selected = (by_kind | named)[volume]
    elif volume:
        selected = _component_with(mesh, bodies, volume)
        if not selected:
            faces = listed({*mesh.groups, *mesh.node_sets} - {*named})
            raise CaseError(
                f"{path}: no volume {volume!r} is named; its volumes are {listed(named)}, its "
                f"kinds of elements {listed(by_kind)}, and its faces {faces}"
            )
    if len(selected) != 1 or not selected.keys() <= SHAPES.keys():
        counts = ", ".join(f"{len(members)} {kind}" for kind, members in sorted(selected.items()))
        choices = {**by_kind, **named} if len(by_kind) > 1 else {}
        raise CaseError(
            f"{path}: a body needs elements of one kind out of {', '.join(FACETS)} or of their "
            f"second order, got {counts or listed(whole)}; "
            + (
                f"give as volume one of {listed(choices)}, or a face of the volume"
                if choices
                else "mesh the body again"
            )
        )
    return next(iter(selected.items()))


def _component_with(mesh: NamedMesh, bodies: list[str], face: str) -> dict[str, np.ndarray]:
    """Elements by kind of the connected component of a mesh with a named face."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    members = [mesh.cells[kind][rows].ravel() for kind, rows in mesh.groups.get(face, {}).items()]
    nodes = np.concatenate([mesh.node_sets.get(face, np.zeros(0, dtype=int)), *members])
    pairs = [
        np.stack([np.repeat(cells[:, 0], cells.shape[1] - 1), cells[:, 1:].ravel()])
        for cells in (mesh.cells[kind] for kind in bodies)
    ]
    links, n = np.concatenate(pairs, axis=1), len(mesh.points)
    graph = coo_array((np.ones(links.shape[1]), links), shape=(n, n))
    component = connected_components(graph, directed=False)[1]
    elements = {
        kind: np.flatnonzero(np.isin(component[mesh.cells[kind][:, 0]], component[nodes]))
        for kind in bodies
    }
    return {kind: rows for kind, rows in elements.items() if len(rows)}
