r"""Interfaces between named faces of meshes: points and areas, matching nodes, mortar rows.

Where the nodes of two faces do not match, the facets of side 2 are projected onto the plane of
every facet of side 1 and clipped against it, and the shape functions :math:`N` of both sides are
integrated over the pieces [1]_,

.. math:: D_{ab} = \int \psi_a N^1_b \,\mathrm{d}\Gamma, \qquad
    M_{ab} = \int \psi_a N^2_b \,\mathrm{d}\Gamma,    \tag{1}

so that :math:`M u_2 - D u_1` is the jump weighted by the functions :math:`\psi` of side 1: the
shape functions of the corners of its facets, which are positive whatever the order of :math:`N` is
[2]_. The rows of both matrices have the same sums, which passes the patch test: an even traction
gives each side the nodal forces that it is in balance with. The sum of a row of D is the area of
its corner.

References
----------
.. [1] M. A. Puso and T. A. Laursen, Comput. Methods Appl. Mech. Eng. 193 (2004) 601-629,
   doi:10.1016/j.cma.2003.10.010: projection and clipping in three dimensions.
.. [2] M. A. Puso, T. A. Laursen, J. Solberg, Comput. Methods Appl. Mech. Eng. 197 (2008) 555-566,
   doi:10.1016/j.cma.2007.08.009: linear multipliers between quadratic displacements.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.fe.elements import sum_blocks
from multiscale.fe.faces import COINCIDENT, OrientedFace, check_boundary, facet_normals

if TYPE_CHECKING:
    from skfem import CellBasis

__all__ = [
    "corner_integrals",
    "face_operator",
    "face_points",
    "facet_nodes",
    "match_faces",
    "mean_rows",
    "mortar_rows",
]

ROUNDING = 1e-12
"""Integrals below this share of the largest are rounding."""

SLIVER = 1e-9
"""Corners with a smaller share of the area of the largest are left out."""


# --- points of one face ----------------------------------------------------------------------


def face_operator(
    basis: "CellBasis", boundary: str, *, order: int = 3
) -> tuple[csr_array, np.ndarray, np.ndarray]:
    """Values of a component at the Gauss points of a face, their areas, m², and positions, m."""
    from skfem import FacetBasis

    check_boundary(basis.mesh, boundary)
    face = FacetBasis(basis.mesh, basis.elem, facets=boundary, intorder=order, dofs=basis.dofs)
    weight = np.asarray(face.dx)
    point = np.arange(weight.size).reshape(weight.shape)
    position = np.asarray(face.global_coordinates())
    values = np.stack([np.broadcast_to(np.asarray(field[0]), weight.shape) for field in face.basis])
    columns = np.broadcast_to(face.element_dofs[:, :, None], values.shape)
    rows = np.broadcast_to(point, values.shape)
    operator = csr_array(
        (values.ravel(), (rows.ravel(), columns.ravel())), shape=(weight.size, basis.N)
    )
    return operator, weight.ravel(), position.reshape(position.shape[0], -1)


def face_points(
    basis: "CellBasis", boundary: str, order: int | None = None
) -> tuple[csr_array, csr_array]:
    r"""Values of a component at the points of a face, and areas of the points in its facets, m².

    Points are the Gauss points of an order, or the nodes: tractions of stiff interfaces oscillate
    with Gauss points and do not with points at the nodes [1]_. Shapes (points, nodes of the body)
    and (points, facets).

    References
    ----------
    .. [1] J. C. J. Schellekens, R. de Borst, Int. J. Numer. Methods Eng. 36 (1993) 43-66,
       doi:10.1002/nme.1620360104.
    """
    from skfem import FacetBasis

    check_boundary(basis.mesh, boundary)
    facets = len(basis.mesh.boundaries[boundary])
    if order is not None:
        values, weight, _ = face_operator(basis, boundary, order=order)
        at = np.arange(weight.size)
        return values, csr_array((weight, (at, at // (at.size // facets))), (at.size, facets))
    face = FacetBasis(basis.mesh, basis.elem, facets=boundary, intorder=2, dofs=basis.dofs)
    share = np.stack([(np.asarray(field[0]) * face.dx).sum(axis=1) for field in face.basis])
    local, facet = np.nonzero(share > ROUNDING * share.max())  # nodes off the face have no area
    nodes, point = np.unique(face.element_dofs[local, facet], return_inverse=True)
    area = csr_array((share[local, facet], (point, facet)), shape=(nodes.size, facets))
    at = np.arange(nodes.size)
    return csr_array((np.ones(nodes.size), (at, nodes)), shape=(nodes.size, basis.N)), area


def corner_integrals(
    basis: "CellBasis", boundary: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    r"""Entries of D in (1) over every facet of one face: facet, corner, node and integral, m²."""
    from skfem import FacetBasis

    check_boundary(basis.mesh, boundary)
    where = {"facets": boundary, "intorder": 1 + basis.elem.maxdeg}
    test = FacetBasis(basis.mesh, basis.mesh.elem(), **where)
    trial = FacetBasis(basis.mesh, basis.elem, dofs=basis.dofs, **where)
    corners, nodes = (np.stack([field[0] for field in space.basis]) for space in (test, trial))
    blocks = np.einsum("afq,bfq,fq->fab", corners, nodes, np.asarray(trial.dx), optimize=True)
    # nodes off the face have no integrals
    facet, a, b = np.nonzero(np.abs(blocks) > ROUNDING * np.abs(blocks).max())
    return facet, test.element_dofs[a, facet], trial.element_dofs[b, facet], blocks[facet, a, b]


# --- two faces -------------------------------------------------------------------------------


def match_faces(
    bases: tuple["CellBasis", "CellBasis"], boundaries: tuple[str, str]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Nodes of side 1 at the nodes of side 2, which rise, and facets of side 1 at its facets.

    None if nodes or facets do not lie at the same places, or the elements are of another kind.
    """
    from scipy.spatial import cKDTree

    nodes, middles = [], []
    for basis, boundary in zip(bases, boundaries, strict=True):
        nodes.append(np.unique(basis.get_dofs(boundary).all()))
        facets = basis.mesh.facets[:, basis.mesh.boundaries[boundary]]
        middles.append(basis.mesh.p[:, facets].mean(axis=1).T)
    first, second = (basis.doflocs[:, at].T for basis, at in zip(bases, nodes, strict=True))
    apart, nearest = cKDTree(first).query(second)
    astray, partner = cKDTree(middles[0]).query(middles[1])
    size = float(np.ptp(second, axis=0).max())
    alike = type(bases[0].elem) is type(bases[1].elem)
    if alike and max(apart.max(), astray.max()) <= COINCIDENT * size:
        return nodes[0][nearest], partner
    return None


def facet_nodes(basis: "CellBasis", boundary: str, face: OrientedFace) -> np.ndarray:
    """Numbers in the body of the nodes of every facet: corners, then middles."""
    from scipy.spatial import cKDTree

    nodes = np.unique(basis.get_dofs(boundary).all())
    if nodes.size == face.nodes.size:
        return np.asarray(face.nodes[face.facets])
    x = face.position[face.facets]
    places = [x, 0.5 * (x + np.roll(x, -1, axis=1)), x.mean(axis=1, keepdims=True)]
    place, size = np.concatenate(places, axis=1), float(np.ptp(face.position, axis=0).max())
    apart, nearest = cKDTree(basis.doflocs[:, nodes].T).query(place)
    is_node = (apart <= COINCIDENT * size).all(axis=0)  # the middle of a facet need not be
    return np.asarray(nodes[nearest[:, is_node]])


def mortar_rows(
    facets: tuple[np.ndarray, np.ndarray],
    positions: tuple[np.ndarray, np.ndarray],
    reach: float = np.inf,
    *,
    columns: tuple[np.ndarray, np.ndarray] | None = None,
    sizes: tuple[int, int] | None = None,
) -> tuple[csr_array, csr_array]:
    """Matrices D and M of (1) over the common area of two faces, m².

    Facets count the rows of ``positions``, which are the rows of the matrices too. The nodes of
    every facet are the columns, so many in all, if they are others than the corners. Facets farther
    apart than ``reach`` do not meet.
    """
    from multiscale.fe.integration import integrate_pairs

    columns = columns or facets
    sizes = sizes or (len(positions[0]), len(positions[1]))
    x = (positions[0][facets[0]], positions[1][facets[1]])
    normals = (facet_normals(x[0]), facet_normals(x[1]))
    numbers = (columns[0].shape[1], columns[1].shape[1])
    first, second, *blocks = integrate_pairs(x, normals, numbers, reach)
    rows, n = facets[0][first], len(positions[0])
    D, M = (
        sum_blocks(block, rows, nodes[pair], (n, size))
        for block, nodes, pair, size in zip(blocks, columns, (first, second), sizes, strict=True)
    )
    return D, M


def mean_rows(D: csr_array, M: csr_array) -> tuple[csr_array, csr_array, np.ndarray]:
    """Mean values of both sides about the corners of side 1 with an area, and these areas, m²."""
    area = D.sum(axis=1)
    corners = np.flatnonzero(area > SLIVER * area.max(initial=0.0))
    inverse = diags_array(1.0 / area[corners])
    return csr_array(inverse @ D[corners]), csr_array(inverse @ M[corners]), area[corners]
