"""Linear elastic blocks: mesh, stiffness matrix and faces."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array, kron

from multiscale.errors import CaseError
from multiscale.laws.bulk import AnisotropicElastic, Elastic

if TYPE_CHECKING:
    from skfem import CellBasis, Element, Mesh

__all__ = [
    "box_mesh",
    "displacement_basis",
    "elastic_matrix",
    "face_areas",
    "face_operator",
    "face_unknowns",
    "stiffness_matrix",
]

ROUNDING = 1e-12
"""Areas below this share of the largest are rounding."""


def box_mesh(
    size: tuple[float, float, float],
    elements: tuple[int, int, int],
    *,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> "Mesh":
    """Mesh a box with equal hexahedra and name its faces.

    Parameters
    ----------
    size : tuple of float
        Lengths along x, y and z, m.
    elements : tuple of int
        Number of elements along x, y and z.
    origin : tuple of float
        Corner with the smallest coordinates, m.

    Returns
    -------
    Mesh
        Boundaries ``left`` and ``right`` (x), ``front`` and ``back`` (y), ``bottom`` and
        ``top`` (z).

    Raises
    ------
    CaseError
        If a length or a number of elements is not positive.

    Examples
    --------
    >>> mesh = box_mesh((0.1, 0.1, 0.02), (4, 4, 2))
    >>> sorted(mesh.boundaries)
    ['back', 'bottom', 'front', 'left', 'right', 'top']
    >>> len(mesh.boundaries["top"])
    16
    """
    for length, number, axis in zip(size, elements, "xyz", strict=True):
        if not (length > 0.0 and np.isfinite(length)):
            raise CaseError(f"the block must have a positive length along {axis} (m), got {length}")
        if number < 1:
            raise CaseError(f"the block needs at least one element along {axis}, got {number}")
    fractions = [np.linspace(0.0, 1.0, number + 1) for number in elements]
    from skfem import MeshHex

    unit = MeshHex.init_tensor(*fractions).with_boundaries(
        {
            "left": lambda x: x[0] == 0.0,
            "right": lambda x: x[0] == 1.0,
            "front": lambda x: x[1] == 0.0,
            "back": lambda x: x[1] == 1.0,
            "bottom": lambda x: x[2] == 0.0,
            "top": lambda x: x[2] == 1.0,
        }
    )
    return unit.scaled(size).translated(origin)


def displacement_basis(mesh: "Mesh", element: "Element | None" = None) -> "CellBasis":
    """Finite-element space of one displacement component.

    Parameters
    ----------
    mesh : Mesh
        Any scikit-fem mesh.
    element : Element, optional
        Any *scalar* element that fits the mesh, for instance ``ElementHex2()`` for 27 nodes.
        The default has 8 nodes.

    Returns
    -------
    CellBasis
        Its quadrature integrates the stiffness of undistorted elements exactly.
    """
    from skfem import Basis, ElementHex1, MeshHex

    element = element or ElementHex1()
    # on a hexahedron the order counts per direction: (0, 0, 1) has the degree of one factor
    per_direction = element.maxdeg // mesh.dim() if isinstance(mesh, MeshHex) else element.maxdeg
    return Basis(mesh, element, intorder=2 * per_direction)


def stiffness_matrix(
    basis: "CellBasis",
    youngs_modulus: float | np.ndarray,
    poissons_ratio: float | np.ndarray,
) -> csr_array:
    r"""Assemble small-strain isotropic elasticity.

    Parameters
    ----------
    basis : CellBasis
        Of a scalar element, see :func:`displacement_basis`; d space dimensions, n unknowns per
        component. Two dimensions mean plane strain.
    youngs_modulus : float or ndarray, shape (elements,)
        :math:`E > 0`, Pa.
    poissons_ratio : float or ndarray, shape (elements,)
        :math:`-1 < \nu < 1/2`, dimensionless.

    Returns
    -------
    csr_array, shape (d n, d n)
        Symmetric stiffness, N/m. Component ``i`` of unknown ``a`` is row ``d a + i``, which is
        also the numbering of ``ElementVector``.

    Raises
    ------
    CaseError
        If a modulus is outside its range.

    Notes
    -----
    With Lamé's parameters :math:`\lambda = E\nu/((1+\nu)(1-2\nu))` and
    :math:`\mu = E/(2(1+\nu))`, the block of components i and j is

    .. math::
        K_{ij} = \int \lambda\, \partial_i v\, \partial_j u + \mu\, \partial_j v\, \partial_i u
        + \delta_{ij}\, \mu\, \partial_k v\, \partial_k u .    \tag{1}

    It is put together from scalar forms, which is many times faster than one vector form.
    """
    E, nu = np.asarray(youngs_modulus, dtype=float), np.asarray(poissons_ratio, dtype=float)
    if not np.all((E > 0.0) & np.isfinite(E)):
        raise CaseError(f"youngs_modulus must be positive (Pa), got {E.min():g}")
    if not np.all((nu > -1.0) & (nu < 0.5)):
        raise CaseError(f"poissons_ratio must lie between -1 and 0.5, got {nu.max():g}")
    d = basis.mesh.dim()
    lame = _products(basis, E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)))
    shear = _products(basis, E / (2.0 * (1.0 + nu)))
    laplace = sum(shear[k][k] for k in range(d))

    def block(i: int, j: int) -> csr_array:
        return lame[i][j] + shear[j][i] + (laplace if i == j else 0.0 * laplace)  # (1)

    return _interleave([[block(i, j) for j in range(d)] for i in range(d)])


def elastic_matrix(basis: "CellBasis", law: Elastic | AnisotropicElastic) -> csr_array:
    r"""Assemble the small-strain elasticity of a law.

    Parameters
    ----------
    basis : CellBasis
        As for :func:`stiffness_matrix`.
    law : Elastic or AnisotropicElastic
        In plane strain the tensor is taken without its rows and columns along z.

    Returns
    -------
    csr_array, shape (d n, d n)
        As of :func:`stiffness_matrix`; for a tensor C the block of components i and j is

        .. math:: K_{ij} = \int C_{ikjl}\, \partial_k v\, \partial_l u .    \tag{2}
    """
    if isinstance(law, Elastic):
        return stiffness_matrix(basis, law.youngs_modulus, law.poissons_ratio)
    d = basis.mesh.dim()
    products, C = _products(basis, np.ones(1)), law.tensor
    blocks = [
        [
            sum(C[i, k, j, m] * products[k][m] for k in range(d) for m in range(d))  # (2)
            for j in range(d)
        ]
        for i in range(d)
    ]
    return _interleave(blocks)


def face_unknowns(basis: "CellBasis", boundary: str) -> np.ndarray:
    """Unknowns of one component on a named boundary, sorted by z, then y, then x.

    Two faces with the same lateral mesh are therefore numbered alike.

    Parameters
    ----------
    basis : CellBasis
        Of a scalar Lagrange element.
    boundary : str
        Name of a boundary of the mesh.

    Returns
    -------
    ndarray of int
        Unknowns ``a``; the component ``i`` of the displacement is unknown ``d a + i``.

    Raises
    ------
    CaseError
        If the mesh has no boundary of that name.
    """
    _check_boundary(basis, boundary)
    unknowns = np.asarray(basis.get_dofs(boundary).all())
    # on a grid of 1e-9 of the mesh, so that rounding does not decide the order
    extent = np.ptp(basis.mesh.p, axis=1).max()
    x = np.round(basis.doflocs[:, unknowns] / (1e-9 * extent))
    return unknowns[np.lexsort(x)]


def face_operator(
    basis: "CellBasis", boundary: str, *, order: int = 3
) -> tuple[csr_array, np.ndarray, np.ndarray]:
    """Values of one displacement component at the quadrature points of a face.

    Parameters
    ----------
    basis : CellBasis
        Of a scalar element.
    boundary : str
        Name of a boundary of the mesh.
    order : int
        Polynomial degree that the quadrature integrates exactly, per direction on a box.

    Returns
    -------
    operator : csr_array, shape (points, n)
        Maps the unknowns of a component to its values, dimensionless.
    weight : ndarray, shape (points,)
        Quadrature weights, m² (m in two dimensions).
    position : ndarray, shape (d, points)
        Coordinates of the points, m.

    Raises
    ------
    CaseError
        If the mesh has no boundary of that name.
    """
    from skfem import FacetBasis

    _check_boundary(basis, boundary)
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

    Parameters
    ----------
    basis : CellBasis
        Of a scalar element of first order.
    boundary : str
        Name of a boundary of the mesh.

    Returns
    -------
    node, facet : ndarray of int, shape (corners,)
        Unknown and facet, counted in the boundary, of every corner of a facet.
    area : ndarray, shape (corners,)
        :math:`\int \varphi` over the facet, with the shape function :math:`\varphi` of the
        corner, m² (m in two dimensions).

    Raises
    ------
    CaseError
        If the mesh has no boundary of that name.

    References
    ----------
    .. [1] J. C. J. Schellekens, R. de Borst, Int. J. Numer. Methods Eng. 36 (1993) 43-66,
       doi:10.1002/nme.1620360104: tractions of stiff interfaces oscillate with Gauss points, and
       do not with points at the nodes.
    """
    from skfem import FacetBasis

    _check_boundary(basis, boundary)
    face = FacetBasis(basis.mesh, basis.elem, facets=boundary, intorder=2, dofs=basis.dofs)
    area = np.stack([(np.asarray(field[0]) * face.dx).sum(axis=1) for field in face.basis])
    local, facet = np.nonzero(area > ROUNDING * area.max())  # nodes off the face have no area
    return face.element_dofs[local, facet], facet, area[local, facet]


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


def _check_boundary(basis: "CellBasis", boundary: str) -> None:
    """Refuse a boundary that the mesh does not name."""
    known = sorted(basis.mesh.boundaries or {})
    if boundary not in known:
        raise CaseError(f"the mesh has no boundary {boundary!r}; its boundaries are {known}")
