"""Linear elasticity of small strain, assembled from scalar forms."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array, kron

from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.laws.bulk.moduli import lame_parameters

if TYPE_CHECKING:
    from skfem import CellBasis, Element, Mesh

__all__ = ["assemble_elasticity", "assemble_mass", "displacement_basis", "elastic_matrix"]


def displacement_basis(mesh: "Mesh", element: "Element | None" = None) -> "CellBasis":
    """Finite-element space of one displacement component.

    Parameters
    ----------
    mesh : Mesh, any scikit-fem mesh
    element : Element, optional
        Any *scalar* element that fits the mesh, for instance ``ElementHex2()`` for 27 nodes.
        The default has 8 nodes.

    Returns
    -------
    CellBasis, its quadrature integrates the stiffness of undistorted elements exactly
    """
    from skfem import Basis, ElementHex1, MeshHex

    element = element or ElementHex1()
    # on a hexahedron the order counts per direction: (0, 0, 1) has the degree of one factor
    per_direction = element.maxdeg // mesh.dim() if isinstance(mesh, MeshHex) else element.maxdeg
    return Basis(mesh, element, intorder=2 * per_direction)


def assemble_elasticity(
    basis: "CellBasis", lame: float | np.ndarray, shear: float | np.ndarray
) -> csr_array:
    r"""Assemble isotropic elasticity from Lamé's parameters.

    Parameters
    ----------
    basis : CellBasis
        Basis of a scalar element; d space dimensions, n unknowns per component. Two dimensions mean
        plane strain.
    lame, shear : float or ndarray, shape (elements,), :math:`\lambda` and :math:`\mu`, Pa

    Returns
    -------
    csr_array, shape (d n, d n)
        Symmetric stiffness, N/m. Component ``i`` of unknown ``a`` is row ``d a + i``, which is
        also the numbering of ``ElementVector``.

    Notes
    -----
    The block of components i and j is

    .. math::
        K_{ij} = \int \lambda\, \partial_i v\, \partial_j u + \mu\, \partial_j v\, \partial_i u
        + \delta_{ij}\, \mu\, \partial_k v\, \partial_k u .    \tag{1}

    It is put together from scalar forms, which is many times faster than one vector form.
    """
    d = basis.mesh.dim()
    if np.ndim(lame) == 0 and np.ndim(shear) == 0:
        unit = _products(basis, np.ones(1))
        by_lame, by_shear = ([[c * one for one in row] for row in unit] for c in (lame, shear))
    else:
        by_lame, by_shear = (_products(basis, np.asarray(c)) for c in (lame, shear))
    laplace = sum(by_shear[k][k] for k in range(d))

    def block(i: int, j: int) -> csr_array:
        return by_lame[i][j] + by_shear[j][i] + (laplace if i == j else 0.0 * laplace)  # (1)

    return _interleave([[block(i, j) for j in range(d)] for i in range(d)])


def assemble_mass(basis: "CellBasis", density: float) -> csr_array:
    """Assemble the consistent mass of a body of even density.

    Parameters
    ----------
    basis : CellBasis, basis of a scalar element, see :func:`displacement_basis`
    density : float, kg/m3

    Returns
    -------
    csr_array, shape (d n, d n), kg; rows are numbered as in :func:`assemble_elasticity`
    """
    from skfem import BilinearForm

    scalar = BilinearForm(lambda u, v, w: density * u * v).assemble(basis)
    return csr_array(kron(csr_array(scalar), np.eye(basis.mesh.dim())))


def elastic_matrix(
    basis: "CellBasis", law: Elastic | AnisotropicElastic, share: np.ndarray | None = None
) -> csr_array:
    r"""Assemble the small-strain elasticity of a law.

    Parameters
    ----------
    basis : CellBasis, basis of a scalar element, see :func:`displacement_basis`
    law : Elastic or AnisotropicElastic
        In plane strain the tensor is taken without its rows and columns along z.
    share : ndarray, shape (elements,), optional
        Share of the stiffness of every element that is left; 1 if not given.

    Returns
    -------
    csr_array, shape (d n, d n)
        As of :func:`assemble_elasticity`; for a tensor C the block of components i and j is

        .. math:: K_{ij} = \int C_{ikjl}\, \partial_k v\, \partial_l u .    \tag{2}
    """
    if isinstance(law, Elastic):
        lame, shear = lame_parameters(law.youngs_modulus, law.poissons_ratio)
        if share is None:
            return assemble_elasticity(basis, lame, shear)
        return assemble_elasticity(basis, lame * share, shear * share)
    d = basis.mesh.dim()
    products, C = _products(basis, np.ones(1) if share is None else share), law.tensor
    blocks = [
        [
            sum(C[i, k, j, m] * products[k][m] for k in range(d) for m in range(d))  # (2)
            for j in range(d)
        ]
        for i in range(d)
    ]
    return _interleave(blocks)


def _interleave(blocks: Sequence[Sequence[Any]]) -> csr_array:
    """Put the blocks of components i and j at the rows d a + i and columns d b + j."""
    d = len(blocks)

    def place(i: int, j: int) -> csr_array:
        unit = np.zeros((d, d))
        unit[i, j] = 1.0
        return kron(blocks[i][j], unit, format="csr")

    return csr_array(sum(place(i, j) for i in range(d) for j in range(d)))


def _products(basis: "CellBasis", coefficient: np.ndarray) -> list[list[Any]]:
    """Matrices of the integrals of coefficient * d_i v * d_j u over the mesh."""
    from skfem import BilinearForm

    d = basis.mesh.dim()
    shape = basis.dx.shape
    field = np.broadcast_to(np.broadcast_to(coefficient, shape[0])[:, None], shape)

    def product(i: int, j: int) -> Any:
        def form(u: Any, v: Any, w: Any) -> Any:
            return w["coefficient"] * v.grad[i] * u.grad[j]

        return csr_array(BilinearForm(form).assemble(basis, coefficient=field))

    upper = {(i, j): product(i, j) for i in range(d) for j in range(i, d)}
    return [
        [upper[i, j] if i <= j else csr_array(upper[j, i].T) for j in range(d)] for i in range(d)
    ]
