"""Named faces of a mesh: values on them, and their areas.

Every function refuses a boundary that the mesh does not name, by a ``CaseError``.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array

from multiscale.errors import CaseError, listed

if TYPE_CHECKING:
    from skfem import CellBasis, Mesh

__all__ = ["check_boundary", "corner_integrals", "face_areas", "face_operator"]

ROUNDING = 1e-12
"""Areas below this share of the largest are rounding."""


def face_operator(
    basis: "CellBasis", boundary: str, *, order: int = 3
) -> tuple[csr_array, np.ndarray, np.ndarray]:
    """Values of one displacement component at the quadrature points of a face."""
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


def face_areas(basis: "CellBasis", boundary: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Area that every node of a face stands for: quadrature at the nodes.

    References
    ----------
    .. [1] J. C. J. Schellekens, R. de Borst, Int. J. Numer. Methods Eng. 36 (1993) 43-66,
       doi:10.1002/nme.1620360104: tractions of stiff interfaces oscillate with Gauss points, and
       do not with points at the nodes.
    """
    from skfem import FacetBasis

    check_boundary(basis.mesh, boundary)
    face = FacetBasis(basis.mesh, basis.elem, facets=boundary, intorder=2, dofs=basis.dofs)
    area = np.stack([(np.asarray(field[0]) * face.dx).sum(axis=1) for field in face.basis])
    local, facet = np.nonzero(area > ROUNDING * area.max())  # nodes off the face have no area
    return face.element_dofs[local, facet], facet, area[local, facet]


def corner_integrals(
    basis: "CellBasis", boundary: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    r"""Integrals :math:`\int \psi_a N_b` over every facet of a face.

    They weigh displacements by the shape functions :math:`\psi` of the corners of the facet, which
    are positive, whatever the order of the shape functions :math:`N` of the nodes.
    """
    from skfem import FacetBasis

    check_boundary(basis.mesh, boundary)
    where = {"facets": boundary, "intorder": 1 + basis.elem.maxdeg}
    first = FacetBasis(basis.mesh, basis.mesh.elem(), **where)
    own = FacetBasis(basis.mesh, basis.elem, dofs=basis.dofs, **where)
    corners, nodes = (np.stack([field[0] for field in one.basis]) for one in (first, own))
    blocks = np.einsum("afq,bfq,fq->fab", corners, nodes, np.asarray(own.dx), optimize=True)
    # nodes off the face have no integrals
    facet, a, b = np.nonzero(np.abs(blocks) > ROUNDING * np.abs(blocks).max())
    return facet, first.element_dofs[a, facet], own.element_dofs[b, facet], blocks[facet, a, b]


def check_boundary(mesh: "Mesh", boundary: str) -> None:
    """Refuse a boundary that the mesh does not name."""
    known = mesh.boundaries or {}
    if boundary not in known:
        raise CaseError(
            f"the mesh has no boundary {boundary!r}; its boundaries are {listed(known)}"
        )
