"""The general path: an elastic body on any scikit-fem mesh and element, factorised once."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from multiscale.errors import CaseError
from multiscale.fe.elasticity import assemble_elasticity
from multiscale.laws.bulk.moduli import lame_parameters
from multiscale.micro.averages import recovered_force
from multiscale.micro.cell import MeshCell
from multiscale.micro.contact_state import CellProblem, obstacle_normal
from multiscale.micro.elastic_contact import ElasticBody, solve_elastic_contact
from multiscale.numerics.factorisation import factorise
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from skfem import CellBasis
    from skfem import FacetBasis as Facets

__all__ = ["assemble_mesh_cell"]

Operator = Callable[[np.ndarray], np.ndarray]


def assemble_mesh_cell(cell: MeshCell, *, recover_stress: bool = False) -> CellProblem:
    """Set up operators and contact geometry on any mesh.

    Raises
    ------
    CaseError
        If the cell is periodic and the nodes of opposite sides do not match.
    """
    from skfem import Basis, FacetBasis
    from skfem.refdom import RefTet, RefTri

    # exact for straight-sided elements: gradients squared, on bricks with as many as degree Gauss
    # points (the default would cost five times as much for nothing)
    simplex = cell.mesh.refdom in (RefTri, RefTet)
    order = 2 * (cell.element.maxdeg - 1) if simplex else cell.element.maxdeg
    basis = Basis(cell.mesh, cell.element, intorder=max(order, 1))
    lame, shear = lame_parameters(cell.law.youngs_modulus, cell.law.poissons_ratio)
    points = basis.doflocs
    image = _periodic_images(points) if cell.periodic else np.arange(basis.N)
    expand = _expansion(basis, image, periodic=cell.periodic)
    stiffness = sparse.csr_array(expand.T @ assemble_elasticity(basis, lame, shear) @ expand)
    solve_free = factorise(stiffness, name="the stiffness of the cell")

    nodes, weight = _contact_nodes(FacetBasis(cell.mesh, cell.element, facets="top"), image)
    surface = points[2, nodes]
    obstacle, slopes = _obstacle(cell.obstacle, points[:2, nodes])
    obstacle = obstacle + np.max(surface - obstacle)
    normal = obstacle_normal(*slopes)
    rows = np.repeat(np.arange(len(nodes)), 3)
    columns = (3 * nodes[:, None] + np.arange(3)).ravel()
    shape = (len(nodes), 3 * basis.N)
    along = sparse.csr_array((normal.ravel(), (rows, columns)), shape=shape)
    trace = sparse.csr_array(along @ expand)
    push = sparse.csr_array(trace.T)

    def solve(force: np.ndarray, correct: Operator | None) -> np.ndarray:
        u = solve_free(force)
        return u if correct is None else u - solve_free(push @ correct(trace @ u))

    def add(vector: np.ndarray, values: np.ndarray) -> None:
        vector += push @ values

    body = ElasticBody(
        apply=lambda u: stiffness @ u,
        solve=solve,
        trace=lambda u: trace @ u,
        add=add,
        compliance=lambda force: trace @ solve_free(push @ force),
        surface_stiffness=lambda values: values,
        shape=(stiffness.shape[0],),
    )

    def recover(u: np.ndarray, active: np.ndarray) -> np.ndarray:
        touching = np.zeros(basis.N, dtype=bool)
        touching[nodes[active]] = True
        vertices = touching[image][basis.nodal_dofs[0]]
        return recovered_force(
            cell.mesh, cell.element, (expand @ u).reshape(-1, 3).T, vertices, lame, shear
        )

    closing = normal[:, 2]
    return CellProblem(
        partial(solve_elastic_contact, body, (obstacle - surface) * closing, closing),
        normal,
        surface,
        obstacle,
        weight,
        surface_displacement=lambda u: (expand @ u).reshape(-1, 3)[nodes],
        recover=recover if recover_stress else None,
    )


def _expansion(basis: "CellBasis", image: np.ndarray, *, periodic: bool) -> sparse.csr_array:
    """Displacements of all nodes from the unknowns.

    These are clamped at the base, one for all periodic images, without motion across sliding sides.
    """
    points = basis.doflocs
    free = np.ones((basis.N, 3), dtype=bool)
    free[image != np.arange(basis.N)] = False
    free[image[basis.get_dofs("base").all()]] = False
    if not periodic:
        low, high = points.min(axis=1), points.max(axis=1)
        for k in range(2):
            edge = np.isclose(points[k], low[k]) | np.isclose(points[k], high[k])
            free[edge, k] = False
    number = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)
    unknown = number[image].ravel()
    kept = np.flatnonzero(unknown >= 0)
    return sparse.csr_array(
        (np.ones(len(kept)), (kept, unknown[kept])), shape=(3 * basis.N, int(free.sum()))
    )


def _periodic_images(points: np.ndarray) -> np.ndarray:
    """Return the node that stands for each node: itself, or its image on the low sides."""
    from scipy.spatial import KDTree

    low, high = points.min(axis=1), points.max(axis=1)
    size = high - low
    place = points.copy()
    for k in range(2):
        place[k, np.isclose(points[k], high[k], rtol=0.0, atol=1e-9 * size[k])] -= size[k]
    moved = np.flatnonzero(np.any(place != points, axis=0))
    image = np.arange(points.shape[1])
    distance, partner = KDTree(points.T).query(place[:, moved].T)
    worst = float(np.max(distance, initial=0.0))
    if worst > 1e-6 * float(size.max()):
        where = points[:, moved[int(np.argmax(distance))]]
        raise CaseError(
            f"the mesh is not periodic: the node at {np.array2string(where, precision=4)} m has no "
            f"partner on the opposite side (nearest {worst:.2g} m away); mesh opposite sides alike "
            f"or let them slide with periodic=False"
        )
    image[moved] = partner
    return image


def _contact_nodes(basis: "Facets", image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Contact nodes and their nominal areas: every facet's projection, shared by its nodes."""
    area = np.sum(np.asarray(basis.normals)[2] * basis.dx, axis=1)
    dofs = basis.element_dofs  # of the elements behind the facets
    onto = np.isin(dofs, basis.get_dofs("top").all())
    share = np.where(onto, area / onto.sum(axis=0), 0.0)
    weight = np.bincount(image[dofs.ravel()], share.ravel(), minlength=len(image))
    nodes = np.unique(image[basis.get_dofs("top").all()])
    return nodes, weight[nodes]


def _obstacle(
    obstacle: Surface | None, place: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Height and slopes of the obstacle at points, from a periodic cubic spline."""
    if obstacle is None:
        nothing = np.zeros(place.shape[1])
        return nothing, (nothing, nothing)
    from scipy.interpolate import RectBivariateSpline

    margin = 4
    padded = np.pad(obstacle.heights, margin, mode="wrap")
    axes = [
        np.arange(-margin, n + margin) * step
        for n, step in zip(obstacle.heights.shape, obstacle.spacing, strict=True)
    ]
    spline = RectBivariateSpline(*axes, padded, s=0)
    x, y = (place[k] % obstacle.size[k] for k in range(2))
    return spline.ev(x, y), (spline.ev(x, y, dx=1), spline.ev(x, y, dy=1))
