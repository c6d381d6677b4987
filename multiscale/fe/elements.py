r"""Internal forces and tangent of a body, for any bulk law, without volume locking.

In every element the volume ratio of the law is its mean over the undeformed element,

.. math:: \bar J = \frac{1}{V}\int J \, \mathrm{d}V, \qquad
    \Pi = \int \psi_s(F)\, \mathrm{d}V + V\, U(\bar J),    \tag{1}

so that neither plastic flow nor :math:`\nu \to 1/2` locks quadrilaterals and hexahedra of first
order; on triangles and tetrahedra of first order the mean is the value itself. Elements of second
order take the volume ratio of every point.

References
----------
.. [1] J. C. Simo, R. L. Taylor and K. S. Pister, Comput. Methods Appl. Mech. Eng. 51 (1985)
   177-208, doi:10.1016/0045-7825(85)90033-7: mean dilatation.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multiscale.laws.bulk import BulkLaw
from multiscale.laws.bulk.bulk_law import cofactor_derivative, volume_ratio

if TYPE_CHECKING:
    from scipy.sparse import csr_array
    from skfem import CellBasis, Element, Mesh


@dataclass(frozen=True)
class Elements:
    """Shape functions and weights of the elements of a mesh at their quadrature points."""

    gradient: np.ndarray  # (elements, points, nodes, d), of the shape functions, 1/m
    weight: np.ndarray  # (elements, points), volumes of the points, m³ (m² in two dimensions)
    unknowns: np.ndarray  # (elements, nodes * d), unknown d a + i of every entry
    size: int  # number of unknowns
    mean_volume: bool = True  # whether the volume ratio is its mean over the element, (1)


def element_of_order(mesh: "Mesh", order: int) -> "Element":
    """Return the scalar element of first or second order on tetrahedra or hexahedra."""
    from skfem import ElementHex1, ElementHex2, ElementTetP1, ElementTetP2

    kinds = (ElementTetP1, ElementTetP2) if mesh.t.shape[0] == 4 else (ElementHex1, ElementHex2)
    return kinds[order - 1]()


def is_first_order(basis: "CellBasis") -> bool:
    """Whether the nodes of a basis are the corners of its mesh."""
    return isinstance(basis.elem, type(basis.mesh.elem()))


def prepare_elements(mesh: "Mesh") -> Elements:
    """Gradients and weights of a mesh of first-order elements."""
    from skfem import Basis, MeshHex, MeshQuad

    order = 3 if isinstance(mesh, (MeshQuad, MeshHex)) else 1
    if isinstance(mesh, MeshHex):
        order = 2  # two points per direction, as scikit-fem counts on hexahedra
    return elements_of_basis(Basis(mesh, mesh.elem(), intorder=order), mean_volume=True)


def elements_of_basis(basis: "CellBasis", *, mean_volume: bool) -> Elements:
    """Gradients and weights at the quadrature points of a basis of a displacement component."""
    mesh = basis.mesh
    shape = np.asarray(basis.dx).shape
    d = mesh.dim()
    gradient = np.stack(
        [np.broadcast_to(np.asarray(field[0].grad), (d, *shape)) for field in basis.basis]
    )
    unknowns = d * basis.element_dofs.T[:, :, None] + np.arange(d)
    return Elements(
        np.ascontiguousarray(gradient.transpose(2, 3, 0, 1)),
        np.ascontiguousarray(basis.dx),
        unknowns.reshape(shape[0], -1),
        d * basis.N,
        mean_volume,
    )


def element_response(
    elements: Elements,
    law: BulkLaw,
    displacement: np.ndarray,
    state: np.ndarray,
    *,
    shape_only: bool = False,
) -> "tuple[np.ndarray, csr_array, np.ndarray, float]":
    """Compute internal force, tangent, new state and smallest volume ratio of a body.

    With ``shape_only`` the response of the law to a change of volume is left out.
    """
    from scipy.sparse import csr_array

    from multiscale.fe.integration import integrate

    G, w = elements.gradient, elements.weight
    d = G.shape[3]
    u = displacement[elements.unknowns].reshape(w.shape[0], -1, d)
    F = np.zeros((3, 3, *w.shape))
    F[:d, :d] = np.einsum("eai,eqaj->ijeq", u, G, optimize=True)
    for i in range(3):
        F[i, i] += 1.0
    J, slope = volume_ratio(law, F)
    if not float(J.min()) > 0.0:
        empty = csr_array((elements.size, elements.size))
        return np.full(elements.size, np.nan), empty, state, float(J.min())

    volume = w.sum(axis=1)
    response = law.respond_shape(F, state)
    if shape_only:
        pressure, curvature = np.zeros((1, 1)), np.zeros_like(volume)
        tangent = response.tangent
    elif elements.mean_volume:
        first, curvature = law.respond_volume(np.sum(w * J, axis=1) / volume)  # (1)
        pressure, tangent = first[:, None], response.tangent
    else:
        pressure, bulk = law.respond_volume(J)
        curvature = np.zeros_like(volume)
        tangent = response.tangent + bulk * slope[:, :, None, None] * slope
    stress = response.stress + pressure * slope
    if law.finite_strain:
        tangent = tangent + pressure * cofactor_derivative(F)
    blocks, force = integrate(
        G,
        w,
        np.ascontiguousarray(stress[:d, :d].transpose(2, 3, 0, 1)),
        np.ascontiguousarray(tangent[:d, :d, :d, :d].transpose(4, 5, 0, 1, 2, 3)),
        np.ascontiguousarray(slope[:d, :d].transpose(2, 3, 0, 1)),
        curvature / volume,
    )
    size = (elements.size, elements.size)
    matrix = sum_blocks(blocks, elements.unknowns, elements.unknowns, size)
    total = np.bincount(elements.unknowns.ravel(), force.ravel(), minlength=elements.size)
    return total, matrix, response.state, float(J.min())


def sum_blocks(
    blocks: np.ndarray, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]
) -> "csr_array":
    """Sum blocks (n, r, c) into a matrix, at their rows (n, r) and columns (n, c)."""
    from scipy.sparse import csr_array

    i = np.broadcast_to(rows[:, :, None], blocks.shape)
    j = np.broadcast_to(columns[:, None, :], blocks.shape)
    return csr_array((blocks.ravel(), (i.ravel(), j.ravel())), shape=shape)
