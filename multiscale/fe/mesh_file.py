"""scikit-fem mesh of a body from a mesh file."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.boxes import HEX_ORDER
from multiscale.io import read_mesh

if TYPE_CHECKING:
    from skfem import CellBasis, Mesh

__all__ = ["check_orientation", "load_mesh"]


def load_mesh(path: Path, *, scale: float = 1.0) -> "Mesh":
    """Read a mesh with its named boundaries and sets of elements, by gmsh or any program.

    Parameters
    ----------
    path : Path
        A ``.msh`` file or any other that meshio reads.
    scale : float
        Length of one unit of the file, m: ``1e-3`` for a file in millimetres.

    Returns
    -------
    Mesh
        Mesh of triangles, quadrilaterals, tetrahedra or hexahedra; coordinates in m. Its
        subdomains are the named sets of elements.

    Raises
    ------
    CaseError
        If the file cannot be read, its elements are of several kinds, or a named facet does not
        belong to an element.
    """
    from skfem import MeshHex, MeshQuad, MeshTet, MeshTri

    arrays = read_mesh(path)
    kinds = {"triangle": MeshTri, "quad": MeshQuad, "tetra": MeshTet, "hexahedron": MeshHex}
    order = HEX_ORDER if arrays.kind == "hexahedron" else slice(None)
    mesh = kinds[arrays.kind](scale * arrays.points, np.ascontiguousarray(arrays.cells.T[order]))
    known = {tuple(sorted(facet)): k for k, facet in enumerate(mesh.facets.T.tolist())}
    boundaries = {}
    for name, facets in arrays.boundaries.items():
        index = [known.get(tuple(sorted(facet)), -1) for facet in facets.tolist()]
        if min(index) < 0:
            raise CaseError(f"{path}: boundary {name!r} has a facet that no element has")
        boundaries[name] = np.unique(index)
    return mesh.with_boundaries(boundaries).with_subdomains(arrays.volumes)


def check_orientation(basis: "CellBasis", *, numbered_alike: bool = False) -> None:
    """Refuse elements that are turned inside out, folded or without volume.

    Parameters
    ----------
    basis : CellBasis
        The Jacobians at its quadrature points decide.
    numbered_alike : bool
        Whether the corners of all elements have one order, as in files, so that an element of
        another sign than most others is inverted, too.

    Raises
    ------
    CaseError
        With the number of these elements and the place of the first.
    """
    jacobian = np.asarray(basis.mapping.detDF(basis.X))
    volume = np.abs(jacobian).mean(axis=1)
    size = float(np.ptp(basis.mesh.p, axis=1).max()) ** basis.mesh.dim()
    sign = np.sign(jacobian[:, :1])
    if numbered_alike:
        sign = np.sign(np.median(sign))
    wrong = np.flatnonzero(np.any(jacobian * sign <= 0.0, axis=1) | ~(volume > 1e-15 * size))
    if len(wrong):
        middle = basis.mesh.p[:, basis.mesh.t[:, wrong[0]]].mean(axis=1)
        where = np.array2string(middle, precision=4)
        raise CaseError(
            f"{len(wrong)} of {basis.mesh.nelements} elements are inverted or without volume, the "
            f"first around {where} m; mesh again, finer where the surface is steep"
        )
