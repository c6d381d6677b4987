"""scikit-fem meshes with named faces: from a mesh file, boxes, plane blocks."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.fe.faces import facet_normals
from multiscale.io import read_text
from multiscale.io.gmsh_model import mesh_geometry
from multiscale.io.meshes import read_mesh

if TYPE_CHECKING:
    from skfem import CellBasis, Mesh

FLAT = 1e-9
"""Jacobian of an element, relative to the cube of its length, up to which it has no volume."""


def load_geometry(path: Path, element_size: float, *, scale: float, volume: str = "") -> "Mesh":
    """Mesh a gmsh ``.geo`` geometry by tetrahedra of a size, m; see :func:`load_mesh`."""
    try:
        made = mesh_geometry(read_text(path), element_size / scale)
    except CaseError as error:
        raise CaseError(f"{path}: {error}") from error
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"{path.stem}.msh"
        file.write_bytes(made)
        try:
            return load_mesh(file, scale=scale, volume=volume)
        except CaseError as error:
            raise CaseError(str(error).replace(str(file), str(path))) from error


def load_mesh(path: Path, *, scale: float = 1.0, volume: str = "", curved: bool = False) -> "Mesh":
    """Read a mesh with its named boundaries from a file of gmsh or of another program.

    Groups of facets name boundaries. Sets of nodes also name boundaries: the outer facets with all
    corners in the set, if no group has its name.

    Parameters
    ----------
    path : Path, a mesh of gmsh, Salome, Abaqus, CalculiX, or any other that meshio or gmsh reads
    scale : float, length of a unit of the file, m: ``1e-3`` for a file in millimetres
    volume : str
        Named group of elements that is the body, ``"tetra"`` or ``"hexahedron"`` of a file with
        both, or a named face of one of several disconnected pieces; all elements if not given.
        Facets of other elements are left out of the boundaries.
    curved : bool
        Whether to keep the nodes between the corners of elements of second order; hexahedra of 20
        nodes get nodes in the middle of their faces. Edges are straight otherwise.

    Returns
    -------
    Mesh
        Mesh of triangles, quadrilaterals, tetrahedra or hexahedra; coordinates in m. Its
        subdomains are the named sets of elements, if all elements are read.
    """
    from skfem import MeshHex, MeshQuad, MeshTet, MeshTri

    arrays = read_mesh(path, volume, curved=curved)
    kinds = {"triangle": MeshTri, "quad": MeshQuad, "tetra": MeshTet, "hexahedron": MeshHex}
    order = HEX_ORDER if arrays.kind == "hexahedron" else slice(None)
    mesh = kinds[arrays.kind](scale * arrays.points, np.ascontiguousarray(arrays.cells.T[order]))
    _check_elements(mesh, path)
    known = {tuple(sorted(facet)): k for k, facet in enumerate(mesh.facets.T.tolist())}
    boundaries = {}
    for name, facets in arrays.boundaries.items():
        index = [known.get(tuple(sorted(facet)), -1) for facet in facets.tolist()]
        if min(index) < 0 and not volume:
            raise CaseError(f"{path}: boundary {name!r} has a facet without an element")
        if max(index) >= 0:
            boundaries[name] = np.unique([facet for facet in index if facet >= 0])
    outer = mesh.boundary_facets()
    for name, nodes in arrays.node_sets.items():
        inside = outer[np.isin(mesh.facets[:, outer], nodes).all(axis=0)]
        if len(inside):
            boundaries.setdefault(name, inside)
    if arrays.middles is not None:
        mesh = _bend(mesh, arrays.cells, scale * arrays.middles)
    return mesh.with_boundaries(boundaries).with_subdomains(arrays.volumes)


EDGES = {
    4: ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)),
    8: tuple((k, (k + 1) % 4) for k in range(4))
    + tuple((4 + k, 4 + (k + 1) % 4) for k in range(4))
    + tuple((k, k + 4) for k in range(4)),
}
"""Corners of the edges of tetrahedra and hexahedra, in the order of VTK."""

FACES = ((0, 3, 4, 7), (1, 2, 5, 6), (0, 1, 4, 5), (2, 3, 6, 7), (0, 1, 2, 3), (4, 5, 6, 7))
"""Corners of the faces of hexahedra, in the order of VTK."""


def _bend(mesh: "Mesh", cells: np.ndarray, middles: np.ndarray) -> "Mesh":
    """Set the nodes in the middle of edges, faces and elements to their places in the file."""
    from skfem import MeshHex2, MeshTet2
    from skfem.assembly import Dofs

    hexahedra, edges = cells.shape[1] == 8, EDGES[cells.shape[1]]
    if hexahedra and middles.shape[2] == len(edges):
        middles = np.concatenate([middles, _serendipity(mesh.p[:, cells], middles)], axis=2)
    bent = (MeshHex2 if hexahedra else MeshTet2).from_mesh(mesh)
    dofs, points = Dofs(bent, bent.elem()), bent.doflocs.copy()

    def place(
        corners: tuple[tuple[int, ...], ...], entities: np.ndarray, first: int, at: Any
    ) -> None:
        number = {tuple(ends): k for k, ends in enumerate(np.sort(entities, axis=0).T.tolist())}
        for k, ends in enumerate(corners):
            named = np.sort(cells[:, list(ends)], axis=1).tolist()
            points[:, at[0, [number[tuple(entity)] for entity in named]]] = middles[:, :, first + k]

    place(edges, mesh.edges, 0, dofs.edge_dofs)
    if hexahedra:
        place(FACES, mesh.facets, len(edges), dofs.facet_dofs)
        points[:, dofs.interior_dofs[0]] = middles[:, :, -1]
    return replace(bent, doflocs=points)


def _serendipity(corners: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Middles of the faces and of hexahedra of 20 nodes, shape (3, elements, 7)."""
    between = [set(ends) for ends in EDGES[8]]
    faces = [
        0.5 * edges[:, :, [k for k, ends in enumerate(between) if ends <= set(face)]].sum(axis=2)
        - 0.25 * corners[:, :, list(face)].sum(axis=2)
        for face in FACES
    ]
    inside = 0.25 * edges.sum(axis=2) - 0.25 * corners.sum(axis=2)
    return np.stack([*faces, inside], axis=2)


def _check_elements(mesh: "Mesh", path: Path) -> None:
    """Refuse elements with a Jacobian of both signs, or neighbours on the same side of a facet."""
    place = mesh.p[:, mesh.t]  # (d, corners, elements)
    tangents = np.moveaxis(mesh.mapping().DF(mesh.elem().refdom.p), (0, 1), (-2, -1))
    jacobian = np.linalg.det(tangents)  # (elements, corners)
    size = np.ptp(place, axis=1).max(axis=0) ** mesh.dim()
    sign = np.sign(jacobian.sum(axis=1, keepdims=True))
    bad = np.min(sign * jacobian, axis=1) <= FLAT * size
    if not bad.any():
        middle = place.mean(axis=1)
        inner = np.flatnonzero(mesh.f2t[1] >= 0)
        x = mesh.p.T[mesh.facets[: mesh.dim(), inner].T]  # (facets, corners, d), three of a quad
        normal = facet_normals(x)
        sides = [
            np.sum(normal * (middle[:, elements].T - x[:, 0]), axis=1)
            for elements in mesh.f2t[:, inner]
        ]
        bad[mesh.f2t[0, inner[sides[0] * sides[1] >= 0.0]]] = True
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        at = ", ".join(f"{x:.4g}" for x in mesh.p[:, mesh.t[:, first]].mean(axis=1))
        raise CaseError(
            f"{path}: {np.count_nonzero(bad)} of {bad.size} elements have no volume or are turned "
            f"inside out, the first of them at ({at}) m; mesh the body again"
        )


def check_orientation(basis: "CellBasis") -> None:
    """Refuse elements that are turned inside out, folded or without volume."""
    jacobian = np.asarray(basis.mapping.detDF(basis.X))
    volume = np.abs(jacobian).mean(axis=1)
    size = float(np.ptp(basis.mesh.p, axis=1).max()) ** basis.mesh.dim()
    sign = np.sign(jacobian[:, :1])
    wrong = np.flatnonzero(np.any(jacobian * sign <= 0.0, axis=1) | ~(volume > 1e-15 * size))
    if len(wrong):
        middle = basis.mesh.p[:, basis.mesh.t[:, wrong[0]]].mean(axis=1)
        where = np.array2string(middle, precision=4)
        raise CaseError(
            f"{len(wrong)} of {basis.mesh.nelements} elements are inverted or without volume, the "
            f"first around {where} m; mesh again, finer where the surface is steep"
        )


GROWTH = 1.25
"""Height of a layer of a plane block over the height of the layer below it, nearer its face."""

HEX_ORDER = [0, 4, 3, 1, 7, 5, 2, 6]
"""Places in a hexahedron of VTK of the corners of a hexahedron of scikit-fem."""


def box_mesh(
    size: tuple[float, float, float],
    elements: tuple[int, int, int],
    *,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> "Mesh":
    """Mesh a box of a size, m, with equal hexahedra, and name its faces.

    Faces are ``left`` and ``right`` (lowest and highest x), ``front`` and ``back`` (y), and
    ``bottom`` and ``top`` (z); ``origin``, m, is the corner with the lowest coordinates.
    """
    for length, number, axis in zip(size, elements, "xyz", strict=True):
        require(f"the length of the block along {axis}", length, "(0, inf)", "m")
        if number < 1:
            raise CaseError(f"the block needs at least one element along {axis}, got {number}")
    fractions = [np.linspace(0.0, 1.0, number + 1) for number in elements]
    from skfem import MeshHex

    unit = MeshHex.init_tensor(*fractions).with_boundaries(
        {
            "left": lambda x: x[0] == 0.0,
            "right": lambda x: x[0] == 1.0,
            "front": lambda x: x[1] == 0.0,
            "back": lambda x: x[1] == 1.0,
            "bottom": lambda x: x[2] == 0.0,
            "top": lambda x: x[2] == 1.0,
        }
    )
    return unit.scaled(size).translated(origin)


def plane_block(
    size: tuple[float, float], profile: np.ndarray, *, upper: bool, lift: float = 0.0
) -> "Mesh":
    """Mesh a rectangle, finest at its ``"face"``, which bulges by a periodic profile out of it."""
    from skfem import MeshQuad

    n, (L, H) = profile.size, size
    ratio = H * n / L
    layers = max(2, int(np.ceil(np.log1p(ratio * (GROWTH - 1.0)) / np.log(GROWTH))))
    thickness = GROWTH ** np.arange(layers)
    z = np.append(0.0, np.cumsum(thickness) / thickness.sum())  # distance from the face over H
    mesh = MeshQuad.init_tensor(np.arange(n + 1) / n, z).with_boundaries(
        {"face": lambda x: x[1] == 0.0, "back": lambda x: x[1] == 1.0}
    )
    x, y = mesh.p
    column = np.rint(x * n).astype(int) % n
    place = np.stack([L * (x - 0.5), H * y - (1.0 - y) * profile[column] + lift])
    if upper:
        return MeshQuad(place, mesh.t).with_boundaries(mesh.boundaries)
    mirrored = MeshQuad(place * np.array([[1.0], [-1.0]]), np.ascontiguousarray(mesh.t[::-1]))
    # turned elements: their facets have other numbers
    y = mirrored.p[1]
    return mirrored.with_boundaries(
        {"face": lambda x: x[1] == y.max(), "back": lambda x: x[1] == y.min()}
    )
