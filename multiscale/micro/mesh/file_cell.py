"""Cells on meshes from files: overhangs, pores, and volumes with moduli of their own."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError, listed
from multiscale.fe.mesh_file import load_mesh
from multiscale.laws.bulk import J2, Elastic, GradedElastic
from multiscale.micro.cell import CellSides, MeshCell
from multiscale.micro.mesh.graph_elements import ElementKind, scalar_element

if TYPE_CHECKING:
    from skfem import Mesh

__all__ = ["cell_from_file"]


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
    """Build a cell on a mesh of gmsh, or of any program whose files meshio reads.

    Parameters
    ----------
    path : Path
        Tetrahedra or hexahedra of first or second order between planes x = const and y = const.
    law : Elastic or J2, law of a mesh without named volumes
    element : ElementKind, element of the displacement on the corners of the file
    scale : float, length of one unit of the file, m
    volumes : mapping of str to Elastic, optional
        Law of every named volume. If there are any, every element belongs to one of them.
    contact, base : str, names of the face that meets the obstacle and of the clamped one
    sides : CellSides
    points : tuple of int, optional
        Points along x and y of the fields that are kept.
    friction_coefficient : float, as of :class:`MeshCell`

    Raises
    ------
    CaseError
        If the file cannot be read, elements are inverted, or names and elements do not fit.
    """
    mesh = load_mesh(path, scale=scale, curved=True)
    if mesh.dim() != 3:
        raise CaseError(f"{path} is a plane mesh, and a cell has three dimensions; mesh a solid")
    if element.simplex != (len(mesh.t) == 4):
        own = "tetrahedra" if len(mesh.t) == 4 else "hexahedra"
        fit = [kind.value for kind in ElementKind if kind.simplex != element.simplex]
        raise CaseError(
            f"{path} has {own}, which an element {element.value!r} does not fit; use one of {fit}"
        )
    if element.order == 1 and mesh.doflocs.shape[1] > mesh.nvertices:
        own = "tet10" if element.simplex else "hex27"
        raise CaseError(
            f"{path} has elements of second order, which an element {element.value!r} does not "
            f"fit; use {own!r}, or save the mesh in first order"
        )
    found = dict(mesh.boundaries or {})
    missing = [name for name in (contact, base) if name not in found]
    if missing:
        raise CaseError(
            f"{path} has no face named {' and '.join(map(repr, missing))}; its named faces are "
            f"{listed(found)}"
        )
    named = {"top": found[contact], "base": found[base]}
    own_law = law if not volumes and not mesh.subdomains else _law_of(mesh, volumes or {}, path)
    return MeshCell(
        mesh.with_boundaries(named),
        scalar_element(element),
        own_law,
        sides,
        points=points,
        friction_coefficient=friction_coefficient,
    )


def _law_of(mesh: "Mesh", volumes: Mapping[str, Elastic], path: Path) -> GradedElastic:
    """Moduli of every element, from the laws of named volumes."""
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
            f"{int((count > 1).sum())} to several; each needs one law"
        )
    return GradedElastic(*moduli)
