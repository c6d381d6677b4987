"""scikit-fem mesh of a body from a mesh file."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.boxes import HEX_ORDER
from multiscale.fe.facets import facet_normals
from multiscale.io import read_mesh

if TYPE_CHECKING:
    from skfem import CellBasis, Mesh

__all__ = ["check_orientation", "load_mesh"]

FLAT = 1e-9
"""Jacobian of an element, relative to the cube of its length, up to which it has no volume."""


def load_mesh(path: Path, *, scale: float = 1.0, volume: str = "") -> "Mesh":
    """Read a mesh with its named boundaries from a file of gmsh or of another program.

    Parameters
    ----------
    path : Path
        A ``.msh`` file or any other that meshio reads.
    scale : float
        Length of one unit of the file, m: ``1e-3`` for a file in millimetres.
    volume : str
        Named group of elements that is the body; all elements if not given. Facets of other
        elements are left out of the boundaries.

    Returns
    -------
    Mesh
        Mesh of triangles, quadrilaterals, tetrahedra or hexahedra; coordinates in m. Its
        subdomains are the named sets of elements, if all elements are read.

    Raises
    ------
    CaseError
        If the file cannot be read, its elements are of several kinds, degenerate or turned inside
        out, or a named facet does not belong to an element.
    """
    from skfem import MeshHex, MeshQuad, MeshTet, MeshTri

    arrays = read_mesh(path, volume)
    kinds = {"triangle": MeshTri, "quad": MeshQuad, "tetra": MeshTet, "hexahedron": MeshHex}
    order = HEX_ORDER if arrays.kind == "hexahedron" else slice(None)
    mesh = kinds[arrays.kind](scale * arrays.points, np.ascontiguousarray(arrays.cells.T[order]))
    _check_elements(mesh, path)
    known = {tuple(sorted(facet)): k for k, facet in enumerate(mesh.facets.T.tolist())}
    boundaries = {}
    for name, facets in arrays.boundaries.items():
        index = [known.get(tuple(sorted(facet)), -1) for facet in facets.tolist()]
        if min(index) < 0 and not volume:
            raise CaseError(f"{path}: boundary {name!r} has a facet that no element has")
        if max(index) >= 0:
            boundaries[name] = np.unique([facet for facet in index if facet >= 0])
    return mesh.with_boundaries(boundaries).with_subdomains(arrays.volumes)


def _check_elements(mesh: "Mesh", path: Path) -> None:
    """Refuse elements without volume, and elements that lie on the same side of their facet.

    The Jacobian of an element has one sign at its corners; the order of the corners in the file
    may be either.
    """
    element, place = mesh.elem(), mesh.p[:, mesh.t]  # (d, corners, elements)
    slopes = [element.lbasis(element.refdom.p, k)[1] for k in range(len(mesh.t))]
    tangents = np.einsum("dae,akc->ecdk", place, np.array(slopes))
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
        at = ", ".join(f"{one:.4g}" for one in mesh.p[:, mesh.t[:, first]].mean(axis=1))
        raise CaseError(
            f"{path}: {np.count_nonzero(bad)} of {bad.size} elements have no volume or are turned "
            f"inside out, the first of them at ({at}) m; mesh the body again"
        )


def check_orientation(basis: "CellBasis") -> None:
    """Refuse elements that are turned inside out, folded or without volume.

    Parameters
    ----------
    basis : CellBasis
        The Jacobians at its quadrature points decide.

    Raises
    ------
    CaseError
        With the number of these elements and the place of the first.
    """
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
