r"""Named faces of meshes with normals and frames, and the mortar rows between two faces.

With the shape functions :math:`N` of both sides and the functions :math:`\psi` of the corners of
the facets of side 1, which are positive for every order of :math:`N` [2]_, integrated over the
intersections of the facets [1]_, :math:`M u_2 - D u_1` is the weighted jump with

.. math:: D_{ab} = \int \psi_a N^1_b \,\mathrm{d}\Gamma, \qquad
    M_{ab} = \int \psi_a N^2_b \,\mathrm{d}\Gamma.    \tag{1}

The rows of both matrices have equal sums, which passes the patch test: the nodal forces of an even
traction are in balance. The sum of a row of D is the area of its corner.

.. [1] M. A. Puso and T. A. Laursen, Comput. Methods Appl. Mech. Eng. 193 (2004) 601-629,
   doi:10.1016/j.cma.2003.10.010.
.. [2] M. A. Puso, T. A. Laursen, J. Solberg, Comput. Methods Appl. Mech. Eng. 197 (2008) 555-566,
   doi:10.1016/j.cma.2007.08.009.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError, listed

if TYPE_CHECKING:
    from scipy.sparse import csr_array
    from skfem import CellBasis, Mesh

COINCIDENT = 1e-6  # distance up to which nodes coincide, relative to the size of a face
STRAIGHT = 1e-6  # 1 - cosine between the normal of a plane and an axis up to which they align
ROUNDING = 1e-12  # integrals below this share of the largest are rounding
SLIVER = 1e-9  # corners with a smaller share of the area of the largest are left out


@dataclass(frozen=True, eq=False)
class OrientedFace:
    """Facets of a named boundary, oriented outwards."""

    facets: np.ndarray  # (facets, corners), places in nodes
    nodes: np.ndarray  # (n,), vertices of the mesh, sorted
    position: np.ndarray  # (n, d), of the vertices, m

    @cached_property
    def normals(self) -> np.ndarray:
        """Outward normals of the facets, as long as their area, shape (facets, d), m²."""
        return facet_normals(self.position[self.facets])


def face_of(mesh: "Mesh", boundary: str) -> OrientedFace:
    """Orient the facets of a named boundary outwards."""
    check_boundary(mesh, boundary)
    index = np.asarray(mesh.boundaries[boundary])
    corners = mesh.facets[:, index].T
    inside = mesh.p[:, mesh.t[:, mesh.f2t[0, index]]].mean(axis=1).T
    x = mesh.p.T[corners]
    centre = x.mean(axis=1)
    if mesh.dim() == 3 and corners.shape[1] == 4:  # by their angle around the centre
        n = (centre - inside) / np.linalg.norm(centre - inside, axis=1, keepdims=True)
        arm = x - centre[:, None]
        first = arm[:, 0] - np.sum(arm[:, 0] * n, axis=1, keepdims=True) * n
        ahead, aside = (np.einsum("fcd,fd->fc", arm, axis) for axis in (first, np.cross(n, first)))
        corners = np.take_along_axis(corners, np.argsort(np.arctan2(aside, ahead), axis=1), axis=1)
        x = mesh.p.T[corners]
    outward = np.sum(facet_normals(x) * (centre - inside), axis=1) > 0.0
    corners = np.where(outward[:, None], corners, corners[:, ::-1])
    nodes, local = np.unique(corners, return_inverse=True)
    return OrientedFace(local.reshape(corners.shape), nodes, mesh.p.T[nodes])


def check_boundary(mesh: "Mesh", boundary: str) -> None:
    """Refuse a boundary that the mesh does not name."""
    known = mesh.boundaries or {}
    if boundary not in known:
        raise CaseError(
            f"the mesh has no boundary {boundary!r}; its boundaries are {listed(known)}"
        )


def facet_normals(x: np.ndarray) -> np.ndarray:
    """Area-weighted normals of facets with corners (facets, corners, d), m² (m in 2D)."""
    if x.shape[2] == 2:
        t = x[:, 1] - x[:, 0]
        return np.stack([t[:, 1], -t[:, 0]], axis=1)
    if x.shape[1] == 3:
        return 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    return 0.5 * np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])


def nodal_normals(face: OrientedFace, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Average facets around each node, moved to x, to unit normals (n, d), zero where not free."""
    normal = np.zeros_like(x)
    facet = facet_normals(x[face.facets])
    for corner in face.facets.T:
        np.add.at(normal, corner, facet)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = np.where(free, normal, 0.0)
    size = np.linalg.norm(along, axis=1, keepdims=True)
    return np.where(size > 0.7, along / np.where(size > 0.0, size, 1.0), normal)


def tangent_frames(normal: np.ndarray) -> np.ndarray:
    """Frames of rows n, t1, t2 from unit normals (n, d): t1 is near x, or near y if n is near x."""
    n, d = normal.shape
    axis = np.zeros((n, d))
    steep = np.abs(normal[:, 0]) > 0.9
    axis[~steep, 0] = 1.0
    axis[steep, 1] = 1.0
    t1 = axis - np.sum(axis * normal, axis=1, keepdims=True) * normal
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    axes = [normal, t1] if d == 2 else [normal, t1, np.cross(normal, t1)]
    return np.asarray(np.stack(axes, axis=1))


def plane_frame(face: OrientedFace, boundary: str) -> np.ndarray:
    """Frame of a plane face of side 2, with the outward normal of side 1, shape (d, d)."""
    normals = -face.normals / np.linalg.norm(face.normals, axis=1, keepdims=True)
    if np.ptp(normals, axis=0).max() > COINCIDENT:
        raise CaseError(
            f"the boundary {boundary!r} of a joint must be plane; name each plane face separately"
        )
    normal = normals.mean(axis=0)
    return np.asarray(tangent_frames(normal[None] / np.linalg.norm(normal))[0])


def plane_axes(place: np.ndarray) -> np.ndarray:
    """Return the normal of a plane of points, (n, 3), and two axes in it, aligned if possible."""
    away = place - place.mean(axis=0)
    normal = np.linalg.eigh(away.T @ away)[1][:, 0]
    across = int(np.argmax(np.abs(normal)))
    first, second = (axis for axis in range(3) if axis != across)
    if np.abs(normal[across]) > 1.0 - STRAIGHT:
        return np.eye(3)[[across, first, second]]
    normal = normal * np.sign(normal[across])
    along = np.eye(3)[first] - normal[first] * normal
    along /= np.linalg.norm(along)
    return np.stack([normal, along, np.cross(normal, along)])


# --- points of a face ------------------------------------------------------------------------


def face_operator(
    basis: "CellBasis", boundary: str, *, order: int = 3
) -> "tuple[csr_array, np.ndarray, np.ndarray]":
    """Values of a component at the Gauss points of a face, their areas, m², and positions, m."""
    from scipy.sparse import csr_array
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
) -> "tuple[csr_array, csr_array]":
    """Values of a component at the points of a face, and areas of the points in its facets, m²."""
    from scipy.sparse import csr_array
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
    r"""Entries of D in (1) over every facet of a face: facet, corner, node and integral, m²."""
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
    """Coinciding nodes and facets of side 1, in the order of side 2; None if some are apart."""
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
) -> "tuple[csr_array, csr_array]":
    """Matrices D and M of (1) over the common area of two faces, m²."""
    from multiscale.fe.elasticity import sum_blocks
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


def mean_rows(D: "csr_array", M: "csr_array") -> "tuple[csr_array, csr_array, np.ndarray]":
    """Mean values of both sides around the corners of side 1 with an area, and these areas, m²."""
    from scipy.sparse import csr_array, diags_array

    area = D.sum(axis=1)
    corners = np.flatnonzero(area > SLIVER * area.max(initial=0.0))
    inverse = diags_array(1.0 / area[corners])
    return csr_array(inverse @ D[corners]), csr_array(inverse @ M[corners]), area[corners]
