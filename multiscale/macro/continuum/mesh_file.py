"""scikit-fem mesh of a body from a mesh file."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.boxes import HEX_ORDER
from multiscale.io import read_mesh

if TYPE_CHECKING:
    from skfem import Mesh

__all__ = ["load_mesh"]


def load_mesh(path: Path, *, scale: float = 1.0) -> "Mesh":
    """Read a mesh with its named boundaries from a file of gmsh or of another program.

    Parameters
    ----------
    path : Path
        A ``.msh`` file or any other that meshio reads.
    scale : float
        Length of one unit of the file, m: ``1e-3`` for a file in millimetres.

    Returns
    -------
    Mesh
        Mesh of triangles, quadrilaterals, tetrahedra or hexahedra; coordinates in m.

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
    return mesh.with_boundaries(boundaries)
