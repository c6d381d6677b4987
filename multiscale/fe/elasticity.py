"""Elasticity and elements of any bulk law: stiffness, mass, forces, motions, condensation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.linalg import eigh, matrix_rank
from scipy.sparse import csc_array, csr_array, issparse, kron

from multiscale.laws.bulk import AnisotropicElastic, BulkLaw, Elastic
from multiscale.laws.bulk.bulk_law import cofactor_derivative, volume_ratio
from multiscale.numerics.factorisation import Solve, factorise

if TYPE_CHECKING:
    from skfem import CellBasis, Element, Mesh


ELEMENTS = 2**14  # of which element matrices are stored at once


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
    """Assemble isotropic elasticity from scalar forms, much faster than a vector form."""
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
        # K_ij = ∫ lame v,i u,j + shear v,j u,i + δ_ij shear v,k u,k (1)
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
    """Stiffness by which hexahedra of first order are too stiff without incompatible modes."""
    # Modes 1 - xi_m² (E. L. Wilson, R. L. Taylor, W. P. Doherty, J. Ghaboussi, 1973) with gradients
    # of zero mean (R. L. Taylor, P. J. Beresford, E. L. Wilson, IJNME 10 (1976) 1211-1219,
    # doi:10.1002/nme.1620100602), J_0 the middle:
    #     P_m = j_0/j J_0^-T grad(1 - xi_m²),   K_ua K_aa^-1 K_au,
    #     K_aa = ∫ P C P,   K_ua = ∫ grad N C P  (3)
    elements = elements_of_basis(basis, mean_volume=False)
    middle = np.full((3, 1), 0.5)
    J = np.asarray(basis.mapping.DF(middle))[..., 0].transpose(2, 0, 1)
    ratio = np.abs(basis.mapping.detDF(middle) / basis.mapping.detDF(basis.X))  # j_0 / j
    slope = np.eye(3) * (1.0 - 2.0 * basis.X.T)[:, :, None]  # up to a factor of every mode

    def integrate(w: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        blocks = np.einsum("eq,eqaj,ijkl,eqbl->eaibk", w, left, law.tensor, right, optimize=True)
        return np.asarray(blocks.reshape(len(w), 3 * left.shape[2], 3 * right.shape[2]))

    total = csr_array((elements.size,) * 2)
    for start in range(0, len(J), ELEMENTS):
        at = slice(start, start + ELEMENTS)
        G, w = elements.gradient[at], elements.weight[at]
        w = w if share is None else w * share[at, None]
        P = np.einsum("eq,qmr,erj->eqmj", ratio[at], slope, np.linalg.inv(J[at]))  # (3)
        mixed, modes = integrate(w, G, P), integrate(w, P, P)
        blocks = mixed @ np.linalg.solve(modes, mixed.transpose(0, 2, 1))
        unknown = elements.unknowns[at]
        total = total + sum_blocks(blocks, unknown, unknown, total.shape)
    return csr_array(total)


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
    """Compute internal force, tangent, new state and smallest volume ratio of a body."""
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
        # mean volume ratio, J. C. Simo, R. L. Taylor, K. S. Pister, CMAME 51 (1985) 177-208,
        # doi:10.1016/0045-7825(85)90033-7:
        #     J = 1/V ∫ det F dV,   energy = ∫ psi(F) dV + V U(J)  (1)
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


FREE = 1e-9  # largest energy of a free motion, relative to its energy on the diagonal stiffness


def rigid_motions(position: np.ndarray, component: np.ndarray) -> np.ndarray:
    """Displacement of unknowns in three translations and three rotations about their middle."""
    motions = np.zeros((component.size, 6))
    axes, moves = np.eye(3), component < 3
    x = position - position.mean(axis=0)
    motions[:, :3] = axes[component % 3] * moves[:, None]
    for axis in range(3):
        turning = np.cross(axes[axis], x)[np.arange(component.size), component % 3]
        motions[:, 3 + axis] = np.where(moves, turning, 0.0)
    return motions


def free_motions(stiffness: csr_array, motions: np.ndarray) -> np.ndarray:
    """Return the combinations of motions, shape (n, motions), that a stiffness does not resist."""
    size = np.sqrt(stiffness.diagonal() @ motions**2)
    energy = motions.T @ (stiffness @ motions) / np.outer(size, size)
    value, vector = eigh(0.5 * (energy + energy.T))
    return np.asarray(motions @ (vector[:, np.abs(value) < FREE] / size[:, None]))


def count_free_motions(position: np.ndarray, fixed: np.ndarray) -> int:
    """Count rigid motions that supports of displacements (and rotations), (n, c), leave free."""
    n, components = fixed.shape
    size = float(np.abs(position - position.mean(axis=0)).max()) or 1.0
    places = np.repeat(position / size, components, axis=0)
    motion = rigid_motions(places, np.tile(np.arange(components), n)).reshape(n, components, 6)
    motion[:, range(3, components), range(3, components)] = 1.0  # rotations of nodes

    def rank(rows: np.ndarray) -> int:
        tol = 1e-10 * len(rows)
        return int(matrix_rank(rows.T @ rows, tol=tol, hermitian=True)) if len(rows) else 0

    return rank(motion.reshape(-1, 6)) - rank(motion[fixed])


# --- static condensation, and compliance onto faces ------------------------------------------

COLUMNS = 64  # right-hand sides that are solved together


@dataclass(frozen=True, eq=False)
class Split:
    """Eliminated and retained unknowns of the bodies of a block-diagonal matrix."""

    inside: np.ndarray  # eliminated unknowns, body after body
    edge: np.ndarray  # retained unknowns, body after body
    edge_start: np.ndarray  # (bodies + 1,), first place of every body in edge, and its size

    @property
    def column(self) -> np.ndarray:
        """Number of every retained unknown in its body."""
        return np.asarray(np.arange(self.edge.size) - self.edge_start[self.owner])

    @property
    def owner(self) -> np.ndarray:
        """Body of every retained unknown."""
        return np.repeat(np.arange(self.edge_start.size - 1), np.diff(self.edge_start))


def split(start: np.ndarray, shared: np.ndarray) -> Split:
    """Split the unknowns; a body has the unknowns ``start[E]`` to ``start[E + 1]``."""
    inside, edge = np.flatnonzero(~shared), np.flatnonzero(shared)
    return Split(inside, edge, np.searchsorted(edge, start))


@dataclass(frozen=True, eq=False)
class CondensedStiffness:
    """Schur complements :math:`S = K_{bb} - K_{bi} K_{ii}^{-1} K_{ib}`, i inside, b retained."""

    split: Split
    blocks: list[np.ndarray]  # S of every body, N/m
    solve: Solve  # applies the inverse of K_ii of all bodies
    out: csr_array | np.ndarray  # K_bi, N/m
    back: csr_array | np.ndarray  # K_ib, N/m

    def reduce(self, force: np.ndarray) -> np.ndarray:
        """Force on the retained unknowns that is equivalent to a force on all unknowns, N."""
        inner = self.solve(force[self.split.inside])
        return np.asarray(force[self.split.edge] - self.out @ inner)

    def expand(self, force: np.ndarray, edge: np.ndarray) -> np.ndarray:
        """Displacement of all unknowns from the displacement of the retained unknowns, m."""
        u = np.empty(force.size)
        u[self.split.edge] = edge
        u[self.split.inside] = self.solve(force[self.split.inside] - self.back @ edge)
        return u


def condense(
    matrix: csr_array | np.ndarray, unknowns: Split, factorise: Callable[..., Solve]
) -> CondensedStiffness:
    """Condense a block-diagonal matrix; the dense matrix of a single body stays dense."""
    rows, edge_rows = matrix[unknowns.inside], matrix[unknowns.edge]
    back, out = rows[:, unknowns.edge], edge_rows[:, unknowns.inside]
    retained = edge_rows[:, unknowns.edge]
    solve = factorise(rows[:, unknowns.inside])
    if not issparse(matrix):
        return CondensedStiffness(unknowns, [retained - out @ solve(back)], solve, out, back)
    inner = _inverse_between(solve, out, back, unknowns.edge_start)
    bounds = pairwise(unknowns.edge_start)
    blocks = [
        retained[a:b, a:b].toarray() - block for (a, b), block in zip(bounds, inner, strict=True)
    ]
    return CondensedStiffness(unknowns, blocks, solve, out, back)


def condense_body(
    stiffness: csr_array, retained: np.ndarray, *, name: str = "the stiffness of the body"
) -> CondensedStiffness:
    """Condense the symmetric stiffness of a body onto the retained unknowns."""
    inside = np.setdiff1d(np.arange(stiffness.shape[0]), retained)
    unknowns = Split(inside, retained, np.array([0, retained.size]))
    condensed = condense(csr_array(stiffness), unknowns, partial(factorise, name=name))
    return replace(condensed, blocks=[_symmetric(block) for block in condensed.blocks])


def compliances(
    solve: Solve, faces: csr_array, start: np.ndarray | None = None
) -> list[np.ndarray]:
    r"""Compute the compliance :math:`F_E K_E^{-1} F_E^T` of every body, exactly symmetric."""
    start = np.array([0, faces.shape[0]]) if start is None else start
    return [_symmetric(block) for block in _inverse_between(solve, faces, faces.T, start)]


def _inverse_between(
    solve: Solve, rows: csr_array, columns: csr_array, start: np.ndarray
) -> list[np.ndarray]:
    sizes = np.diff(start)
    width = int(sizes.max(initial=0))
    entries = columns.tocoo()
    place = (np.arange(start[-1]) - np.repeat(start[:-1], sizes))[entries.coords[1]]
    shape = (columns.shape[0], width)
    merged = csc_array((entries.data, (entries.coords[0], place)), shape=shape)
    product = np.empty((rows.shape[0], width))
    for first in range(0, width, COLUMNS):
        batch = slice(first, first + COLUMNS)
        product[:, batch] = rows @ solve(merged[:, batch].toarray())
    return [product[a:b, : b - a] for a, b in pairwise(start)]


def _symmetric(block: np.ndarray) -> np.ndarray:
    return np.asarray(0.5 * (block + block.T))
