"""Meshes of cells: below a height map, with pores, or from a file with overhangs and volumes."""

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError, listed
from multiscale.fe.mesh_file import load_mesh
from multiscale.laws.bulk import J2, Elastic, GradedElastic
from multiscale.micro.layer import GraphMesh, Linear, PeriodicLayer, graded_planes
from multiscale.micro.mesh.mesh_cell import CellSides, MeshCell
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from skfem import Element, Mesh

    from multiscale.micro.damage import Cavities

VOID = 1e-4  # modulus of an element in a pore over the modulus of the solid


class ElementKind(StrEnum):
    """Elements of cells on meshes, by their number of nodes."""

    HEX8 = "hex8"
    HEX27 = "hex27"
    TET4 = "tet4"
    TET10 = "tet10"

    @property
    def order(self) -> int:
        """Order of the displacement along an edge, which has order + 1 nodes."""
        return 2 if self in (ElementKind.HEX27, ElementKind.TET10) else 1

    @property
    def simplex(self) -> bool:
        """Whether the element is a tetrahedron."""
        return self in (ElementKind.TET4, ElementKind.TET10)

    def scalar(self) -> "Element":
        """Return the scikit-fem element of a displacement component."""
        import skfem

        name = "ElementTetP" if self.simplex else "ElementHex"
        element: Element = getattr(skfem, f"{name}{self.order}")()
        return element


def graph_mesh_cell(
    surface: Surface,
    depth: float,
    layers: int,
    law: Linear | J2,
    element: ElementKind = ElementKind.HEX8,
    *,
    sides: CellSides = CellSides.PERIODIC,
    obstacle: Surface | None = None,
    friction_coefficient: float = 0.0,
    pores: "Cavities | None" = None,
) -> MeshCell:
    r"""Mesh the layer below a surface with any element, its top nodes at the points of the surface.

    Elements of second order have twice the spacing and follow the surface with all their nodes, so
    that cells of every element have the same contact nodes.

    Parameters
    ----------
    surface : Surface
        Heights of the top, m, with even numbers of points; multiples of four for second order.
    depth : float, distance from the clamped base to the mean plane of the top, m
    layers : int, layers of nodes above the base, graded towards the top; even for second order
    law : Elastic, GradedElastic or J2, graded moduli have the shape (layers,), from the base up
    sides, obstacle, friction_coefficient : see :class:`MeshCell`
    pores : Cavities, optional
        Cavities of an elastic layer, in a box from its base to its mean plane that is lifted with
        the surface. Elements with their centres in a cavity have 1e-4 of the modulus.
    """
    layer = PeriodicLayer(surface, depth, layers, law)
    if layer.heterogeneous:
        raise CaseError(
            "moduli on a mesh of a graph vary from layer to layer at most; build a MeshCell with "
            "moduli of each element"
        )
    planes = graded_planes(depth, layers, min(surface.spacing))
    GraphMesh(surface, planes)  # raises if the mesh is not valid
    order, (nx, ny) = element.order, surface.heights.shape
    uneven = [n for n in (nx // 2, ny // 2, layers) if order == 2 and n % 2]
    if uneven or min(nx, ny) < 2:
        raise CaseError(
            f"{element} elements on a graph need two or more points along x and y (multiples of "
            f"four) and an even number of layers, got {nx} x {ny} points and {layers} layers"
            if order == 2
            else f"a mesh needs two points or more along x and y, got {nx} x {ny}"
        )
    flat, number = _flat_mesh(surface, planes[::order], element)
    mesh = _lifted(flat, surface, planes[-1])
    element_law: Linear | J2 = law
    if isinstance(law, GradedElastic):
        element_law = GradedElastic(
            *(
                np.broadcast_to(value, (layers,)).reshape(-1, order).mean(axis=1)[number]
                for value in (law.youngs_modulus, law.poissons_ratio)
            )
        )
    if pores is not None:
        element_law = _porous(flat, element_law, pores)
    return MeshCell(
        mesh,
        element.scalar(),
        element_law,
        sides,
        obstacle,
        layer,
        friction_coefficient=friction_coefficient,
    )


def _porous(flat: "Mesh", law: Linear | J2, pores: "Cavities") -> GradedElastic:
    """Return the moduli of every element below a flat surface, reduced in pores."""
    if isinstance(law, J2):
        raise CaseError(
            "a layer with pores must be elastic, but its law flows; leave out the pores"
        )
    void = pores.void_at(flat.p[:, flat.t].mean(axis=1))
    if void[flat.f2t[0, flat.boundaries["top"]]].any():
        raise CaseError("a pore cuts the surface of the layer; put it deeper")
    if not void.any():
        raise CaseError("no element has its centre in a pore; give more points, or larger pores")
    E, nu = (
        np.broadcast_to(value, void.size) for value in (law.youngs_modulus, law.poissons_ratio)
    )
    return GradedElastic(np.where(void, VOID * E, E), nu)


def _flat_mesh(
    surface: Surface, planes: np.ndarray, element: ElementKind
) -> tuple["Mesh", np.ndarray]:
    """Mesh the layer below a flat surface; return also the layer number of each element."""
    from skfem import MeshHex, MeshHex2, MeshTet2

    axes = [
        np.linspace(0.0, size, n // element.order + 1)
        for size, n in zip(surface.size, surface.heights.shape, strict=True)
    ]
    mesh: Mesh = MeshHex.init_tensor(*axes, planes)
    if element.simplex:
        mesh = mesh.to_meshtet()
    middle = mesh.p[2, mesh.t].mean(axis=0)
    number = np.searchsorted(planes, middle) - 1
    centre = mesh.p[2, mesh.facets].mean(axis=0)
    near = 1e-9 * planes[-1]
    top, base = (np.flatnonzero(abs(centre - at) < near) for at in (planes[-1], 0.0))
    if element.order == 2:
        mesh = (MeshTet2 if element.simplex else MeshHex2).from_mesh(mesh)
    return mesh.with_boundaries({"top": top, "base": base}), number


def _lifted(mesh: "Mesh", surface: Surface, depth: float) -> "Mesh":
    from dataclasses import replace

    i, j = (
        np.rint(mesh.doflocs[k] / surface.spacing[k]).astype(int) % surface.heights.shape[k]
        for k in range(2)
    )
    points = mesh.doflocs.copy()
    points[2] *= 1.0 + surface.heights[i, j] / depth
    return replace(mesh, doflocs=points)


def cell_from_file(
    path: Path,
    law: Elastic | J2,
    element: ElementKind,
    *,
    scale: float = 1.0,
    volumes: Mapping[str, Elastic] | None = None,
    contact: str = "top",
    base: str = "bottom",
    sides: CellSides = CellSides.PERIODIC,
    points: tuple[int, int] | None = None,
    friction_coefficient: float = 0.0,
) -> MeshCell:
    """Build a cell on a mesh of gmsh, or of any program with files that meshio reads.

    Parameters
    ----------
    path : Path
        Tetrahedra or hexahedra of first or second order between planes x = const and y = const.
    law : Elastic or J2, law of a mesh without named volumes
    element : ElementKind, element of the displacement on the corners of the file
    scale : float, length of a unit of the file, m
    volumes : mapping of str to Elastic, optional
        Law of every named volume. With named volumes, every element must belong to a volume.
    contact, base : str, names of the face that meets the obstacle and of the clamped face
    points : tuple of int, optional, points along x and y of the stored fields
    friction_coefficient : float, see :class:`MeshCell`
    """
    mesh = load_mesh(path, scale=scale, curved=True)
    if mesh.dim() != 3:
        raise CaseError(f"{path} is a plane mesh, but a cell has three dimensions; mesh a solid")
    if element.simplex != (len(mesh.t) == 4):
        shape = "tetrahedra" if len(mesh.t) == 4 else "hexahedra"
        fit = [kind.value for kind in ElementKind if kind.simplex != element.simplex]
        raise CaseError(
            f"{path} has {shape}, which an element {element.value!r} does not fit; use "
            f"{' or '.join(fit)}"
        )
    if element.order == 1 and mesh.doflocs.shape[1] > mesh.nvertices:
        second = "tet10" if element.simplex else "hex27"
        raise CaseError(
            f"{path} has elements of second order, which an element {element.value!r} does not "
            f"fit; use {second!r}, or save the mesh in first order"
        )
    faces = dict(mesh.boundaries or {})
    missing = [name for name in (contact, base) if name not in faces]
    if missing:
        raise CaseError(
            f"{path} has no face named {' and '.join(map(repr, missing))}; its named faces are "
            f"{listed(faces)}"
        )
    named = {"top": faces[contact], "base": faces[base]}
    element_law = law if not volumes and not mesh.subdomains else _law_of(mesh, volumes or {}, path)
    return MeshCell(
        mesh.with_boundaries(named),
        element.scalar(),
        element_law,
        sides,
        points=points,
        friction_coefficient=friction_coefficient,
    )


def _law_of(mesh: "Mesh", volumes: Mapping[str, Elastic], path: Path) -> GradedElastic:
    """Return the moduli of every element, from the laws of named volumes."""
    named = dict(mesh.subdomains or {})
    lawless, absent = sorted(set(named) - set(volumes)), sorted(set(volumes) - set(named))
    if lawless:
        raise CaseError(
            f"{path} names volumes without a law, {listed(lawless)}; give each its moduli"
        )
    if absent:
        raise CaseError(
            f"{path} has no volume named {listed(absent)}; its named volumes are {listed(named)}"
        )
    count = np.zeros(mesh.nelements, dtype=int)
    moduli = np.zeros((2, mesh.nelements))
    for name, elements in named.items():
        count[elements] += 1
        moduli[:, elements] = [[volumes[name].youngs_modulus], [volumes[name].poissons_ratio]]
    if np.any(count != 1):
        raise CaseError(
            f"{path}: {int((count == 0).sum())} elements belong to no named volume and "
            f"{int((count > 1).sum())} to several; each element needs a single law"
        )
    return GradedElastic(*moduli)
