"""The general path: an elastic body on any scikit-fem mesh and element, factorised once."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from multiscale.fe.elasticity import assemble_elasticity
from multiscale.fe.faces import face_of
from multiscale.fe.mesh_file import check_orientation
from multiscale.fe.rigid_motion import rigid_motions
from multiscale.laws.bulk.moduli import lame_parameters
from multiscale.micro.averages import ContactSurface, recovered_force
from multiscale.micro.contact_area import element_edges
from multiscale.micro.elastic.active_set import (
    ElasticBody,
    Inverse,
    ReferenceInverse,
    solve_elastic_contact,
)
from multiscale.micro.elastic_cell import (
    ContactState,
    ElasticCell,
    at_first_touch,
    obstacle_normal,
)
from multiscale.micro.mesh.mesh_cell import CellSides, MeshCell
from multiscale.micro.mesh.unknowns import CellUnknowns, cell_unknowns, mean_strain
from multiscale.numerics.factorisation import factorise
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from skfem import CellBasis

__all__ = [
    "ElasticMesh",
    "assemble_elastic_mesh",
]

Operator = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class ElasticMesh:
    """The equations of an elastic body on a mesh, with contact quantities at the contact nodes.

    Attributes
    ----------
    problem : ElasticCell
    basis : CellBasis, of one displacement component
    unknowns : CellUnknowns
    stiffness : csr_array, shape (unknowns, unknowns)
        N/m.
    """

    problem: ElasticCell
    basis: "CellBasis"
    unknowns: CellUnknowns
    stiffness: sparse.csr_array


def assemble_elastic_mesh(cell: MeshCell, *, recover_stress: bool = False) -> ElasticMesh:
    """Set up operators and contact geometry on any mesh."""
    basis = cell_basis(cell)
    lame, shear = lame_parameters(cell.law.youngs_modulus, cell.law.poissons_ratio)
    unknowns = cell_unknowns(cell, basis)
    expand, nodes = unknowns.expand, unknowns.nodes
    stiffness = sparse.csr_array(expand.T @ assemble_elasticity(basis, lame, shear) @ expand)
    stiffness.sum_duplicates()

    surface = unknowns.coefficients @ basis.doflocs[2]
    obstacle, slopes = _obstacle(cell.obstacle, basis.doflocs[:2, nodes])
    obstacle, _ = at_first_touch(surface, obstacle)
    normal = obstacle_normal(*slopes)
    gap, closing = (obstacle - surface) * normal[:, 2], normal[:, 2]
    follows = unknowns.number[:, 2] < 0  # a node that moves with another one touches after it
    gap[follows] += 1e3 * float(np.ptp(basis.doflocs[2]))
    solve = partial(_solver(cell, basis, unknowns, stiffness, normal), gap, closing)

    def recover(u: np.ndarray, active: np.ndarray) -> np.ndarray:
        touching = np.zeros(basis.N, dtype=bool)
        touching[nodes[active]] = True
        vertices = touching[unknowns.image][basis.nodal_dofs[0]]
        moved = (expand @ u).reshape(-1, 3).T
        return recovered_force(cell.mesh, cell.element, moved, vertices, lame, shear)

    problem = ElasticCell(
        solve,
        normal,
        surface,
        obstacle,
        unknowns.weight,
        surface_displacement=lambda u: unknowns.coefficients @ (expand @ u).reshape(-1, 3),
        recover=recover if recover_stress else None,
        arrange=_arrangement(cell, basis, unknowns),
    )
    return ElasticMesh(problem, basis, unknowns, stiffness)


def cell_basis(cell: MeshCell) -> "CellBasis":
    """Finite-element space of one displacement component of a cell."""
    from skfem import Basis
    from skfem.refdom import RefTet, RefTri

    # exact for straight-sided elements: gradients squared (order p counts per direction on bricks)
    simplex = cell.mesh.refdom in (RefTri, RefTet)
    order = 2 * (cell.element.maxdeg - 1) if simplex else 2 * (cell.element.maxdeg // 3)
    basis = Basis(cell.mesh, cell.element, intorder=max(order, 1))
    check_orientation(basis)
    return basis


def _solver(
    cell: MeshCell,
    basis: "CellBasis",
    unknowns: CellUnknowns,
    stiffness: sparse.csr_array,
    normal: np.ndarray,
) -> Callable[..., ContactState]:
    """Choose what solves contact: factors of the stiffness, or multigrid where it is large."""
    number = unknowns.number
    rows, component = np.nonzero(np.broadcast_to(number[:, 2:] >= 0, normal.shape) & (number >= 0))
    shape = (len(number), stiffness.shape[0])
    trace = sparse.csr_array(
        (normal[rows, component], (rows, number[rows, component])), shape=shape
    )
    push = sparse.csr_array(trace.T)
    apply: Operator = stiffness.__matmul__
    inverse: Inverse
    if cell.multigrid:
        from multiscale.micro.mesh.multigrid import MultigridInverse

        place, size = unknowns.place, float(np.ptp(basis.doflocs))
        modes = rigid_motions(basis.doflocs.T[place // 3] / size, place % 3)
        inverse = MultigridInverse(stiffness, modes, place, number[:, 2])
    else:
        solve_free = factorise(stiffness, name="the stiffness of the cell")
        if cell.sides is CellSides.TRACTION:
            constraint = mean_strain(basis) @ unknowns.expand
            apply, solve_free = _constrained(stiffness, solve_free, constraint)

        def solve(
            force: np.ndarray | None, correct: Operator, out: np.ndarray | None = None
        ) -> np.ndarray:
            u = np.zeros(stiffness.shape[0]) if force is None else solve_free(force)
            return u - solve_free(push @ correct(trace @ u))

        inverse = ReferenceInverse(
            solve, lambda force: trace @ solve_free(push @ force), lambda values: values
        )

    def add(vector: np.ndarray, values: np.ndarray) -> None:
        vector += push @ values

    body = ElasticBody(
        apply=lambda u, out=None: apply(u),
        trace=lambda u: trace @ u,
        add=add,
        inverse=inverse,
        shape=(stiffness.shape[0],),
    )
    return partial(solve_elastic_contact, body)


def _constrained(
    stiffness: sparse.csr_array, solve_free: Operator, constraint: np.ndarray
) -> tuple[Operator, Operator]:
    r"""Stiffness and its inverse among displacements with :math:`C u = 0`, by projection.

    The multipliers are the uniform stresses on the sides.
    """
    across = np.linalg.solve(constraint @ constraint.T, constraint)
    moved = solve_free(np.ascontiguousarray(constraint.T))
    reaction = np.linalg.solve(constraint @ moved, moved.T)

    def apply(u: np.ndarray) -> np.ndarray:
        force = stiffness @ u
        return np.asarray(force - constraint.T @ (across @ force))

    def solve(force: np.ndarray) -> np.ndarray:
        return np.asarray(solve_free(force) - moved @ (reaction @ force))

    return apply, solve


def _arrangement(
    cell: MeshCell, basis: "CellBasis", unknowns: CellUnknowns
) -> Callable[[ContactSurface], ContactSurface]:
    """Return how the contact surface of a cell is averaged: on a grid if its nodes form one."""
    nodes = unknowns.nodes
    if cell.layer is None:

        @cache
        def look() -> tuple[np.ndarray, sparse.csr_array]:
            return uppermost_facets(cell)

        def to_grid(values: np.ndarray) -> np.ndarray:
            spread, (height, interpolate) = np.zeros(basis.N), look()
            spread[nodes] = values
            there = interpolate @ spread[unknowns.image][basis.nodal_dofs[0]]
            return np.asarray(there.reshape(height.shape))

        return partial(replace, neighbours=unknowns.neighbours, to_grid=to_grid)

    grid, points = cell.layer.surface, basis.doflocs[:2, nodes]
    i, j = (
        np.rint(at / step).astype(int) % n
        for at, step, n in zip(points, grid.spacing, grid.heights.shape, strict=True)
    )
    there = np.empty(grid.heights.shape, dtype=int)
    there[i[::-1], j[::-1]] = np.arange(len(i))[::-1]  # contact node of every point of the grid
    if cell.sides is not CellSides.PERIODIC:  # nodes at both ends of a line
        return partial(
            replace, neighbours=unknowns.neighbours, to_grid=lambda values: values[there]
        )
    edges = element_edges(cell.layer)
    return lambda surface: surface.on_grid(there, edges)


def uppermost_facets(cell: MeshCell) -> tuple[np.ndarray, sparse.csr_array]:
    """Look down on the contact face of a cell that has points for its fields.

    Returns the height of the uppermost facet above every point, shape (nx, ny), m, and the matrix,
    shape (nx ny, nodes), from values at the vertices of the mesh to values there, linear on
    triangles.
    """
    mesh, (nx, ny) = cell.mesh, cell.points or (0, 0)
    face = face_of(mesh, "top")
    corner = face.nodes[face.facets].T
    triangles = np.hstack([corner[[0, k, k + 1]] for k in range(1, len(corner) - 1)])
    low, high = mesh.p.min(axis=1), mesh.p.max(axis=1)
    axes = [low[k] + (high - low)[k] * np.arange(n) / n for k, n in ((0, nx), (1, ny))]
    height = np.full((nx, ny), -np.inf)
    owner, share = np.zeros((nx, ny, 3), dtype=int), np.zeros((nx, ny, 3))
    near = 1e-9
    for triangle in triangles.T:
        (x0, x1, x2), (y0, y1, y2), z = mesh.p[:, triangle]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-12 * float((high - low)[:2].prod()) / (nx * ny):  # upright
            continue
        margin = near * (high - low)
        pieces = tuple(
            slice(*np.searchsorted(axis, (min(ends) - room, max(ends) + room)))
            for axis, ends, room in zip(axes, ((x0, x1, x2), (y0, y1, y2)), margin[:2], strict=True)
        )
        x, y = np.meshgrid(axes[0][pieces[0]], axes[1][pieces[1]], indexing="ij")
        b = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / area
        c = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / area
        weights = np.stack([1.0 - b - c, b, c], axis=-1)
        over = np.all(weights > -near, axis=-1) & (weights @ z > height[*pieces])
        height[*pieces][over] = (weights @ z)[over]
        owner[*pieces][over], share[*pieces][over] = triangle, weights[over]
    rows = np.repeat(np.arange(nx * ny), 3)
    interpolate = sparse.csr_array(
        (share.ravel(), (rows, owner.ravel())), shape=(nx * ny, mesh.nvertices)
    )
    return height, interpolate


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
