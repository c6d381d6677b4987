"""Linear elasticity of small strain, assembled from scalar forms."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array, kron

from multiscale.fe.elements import elements_of_basis, sum_blocks
from multiscale.laws.bulk import AnisotropicElastic, Elastic

if TYPE_CHECKING:
    from skfem import CellBasis, Element, Mesh


def displacement_basis(mesh: "Mesh", element: "Element | None" = None) -> "CellBasis":
    """Finite-element space of a displacement component."""
    from skfem import Basis, ElementHex1, MeshHex

    element = element or ElementHex1()
    # on a hexahedron the order counts per direction: (0, 0, 1) has the degree of a factor
    per_direction = element.maxdeg // mesh.dim() if isinstance(mesh, MeshHex) else element.maxdeg
    return Basis(mesh, element, intorder=2 * per_direction)


def assemble_elasticity(
    basis: "CellBasis", lame: float | np.ndarray, shear: float | np.ndarray
) -> csr_array:
    r"""Assemble isotropic elasticity from Lamé's parameters.

    The block of components i and j is assembled from scalar forms, much faster than a vector form:

    .. math::
        K_{ij} = \int \lambda\, \partial_i v\, \partial_j u + \mu\, \partial_j v\, \partial_i u
        + \delta_{ij}\, \mu\, \partial_k v\, \partial_k u .    \tag{1}
    """
    d = basis.mesh.dim()
    if np.ndim(lame) == 0 and np.ndim(shear) == 0:
        unit = _products(basis, np.ones(1))
        by_lame, by_shear = (
            [[c * product for product in row] for row in unit] for c in (lame, shear)
        )
    else:
        by_lame, by_shear = (_products(basis, np.asarray(c)) for c in (lame, shear))
    laplace = sum(by_shear[k][k] for k in range(d))

    def block(i: int, j: int) -> csr_array:
        return by_lame[i][j] + by_shear[j][i] + (laplace if i == j else 0.0 * laplace)  # (1)

    return _interleave([[block(i, j) for j in range(d)] for i in range(d)])


def assemble_mass(basis: "CellBasis", density: float) -> csr_array:
    """Assemble the consistent mass of a body of even density."""
    from skfem import BilinearForm

    scalar = BilinearForm(lambda u, v, w: density * u * v).assemble(basis)
    return csr_array(kron(csr_array(scalar), np.eye(basis.mesh.dim())))


def elastic_matrix(
    basis: "CellBasis", law: Elastic | AnisotropicElastic, share: np.ndarray | None = None
) -> csr_array:
    r"""Assemble the small-strain elasticity of a law."""
    if isinstance(law, Elastic):
        factor = 1.0 if share is None else share
        return assemble_elasticity(basis, factor * law.volume_modulus, factor * law.shear_modulus)
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


def mode_stiffness(
    basis: "CellBasis", law: Elastic | AnisotropicElastic, share: np.ndarray | None = None
) -> csr_array:
    r"""Stiffness by which hexahedra of first order are too stiff without incompatible modes.

    In reference coordinates from -1 to 1, the modes :math:`1 - \xi_m^2` of every element [1]_, with
    gradients scaled to a mean of zero, so that even strain is exact on any hexahedron [2]_,

    .. math:: P_m = \frac{j_0}{j}\, J_0^{-T} \nabla_\xi (1 - \xi_m^2), \qquad
        K_{ua} K_{aa}^{-1} K_{au}, \quad K_{aa} = \int P\, C\, P, \quad
        K_{ua} = \int \nabla N\, C\, P    \tag{3}

    is taken off the stiffness, with the Jacobian :math:`J`, its determinant j, and both at the
    middle.

    .. [1] E. L. Wilson, R. L. Taylor, W. P. Doherty, J. Ghaboussi, Incompatible displacement
       models, in Numerical and Computer Methods in Structural Mechanics (1973) 43-57.
    .. [2] R. L. Taylor, P. J. Beresford, E. L. Wilson, Int. J. Numer. Methods Eng. 10 (1976)
       1211-1219, doi:10.1002/nme.1620100602.
    """
    elements = elements_of_basis(basis, mean_volume=False)
    G, w = elements.gradient, elements.weight
    if share is not None:
        w = w * share[:, None]
    middle = np.full((3, 1), 0.5)
    J = np.asarray(basis.mapping.DF(middle))[..., 0].transpose(2, 0, 1)
    ratio = np.abs(basis.mapping.detDF(middle) / basis.mapping.detDF(basis.X))  # j_0 / j
    slope = np.eye(3) * (1.0 - 2.0 * basis.X.T)[:, :, None]  # up to a factor of every mode
    P = np.einsum("eq,qmr,erj->eqmj", ratio, slope, np.linalg.inv(J))  # (3)

    def integrate(left: np.ndarray, right: np.ndarray) -> np.ndarray:
        blocks = np.einsum("eq,eqaj,ijkl,eqbl->eaibk", w, left, law.tensor, right, optimize=True)
        return np.asarray(blocks.reshape(len(w), 3 * left.shape[2], 3 * right.shape[2]))

    mixed, modes = integrate(G, P), integrate(P, P)
    blocks = mixed @ np.linalg.solve(modes, mixed.transpose(0, 2, 1))
    return sum_blocks(blocks, elements.unknowns, elements.unknowns, (elements.size,) * 2)


def _interleave(blocks: Sequence[Sequence[Any]]) -> csr_array:
    """Assemble the blocks of components i and j into the rows d a + i and columns d b + j."""
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
