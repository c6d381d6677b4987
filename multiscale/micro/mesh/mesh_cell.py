"""Cells on scikit-fem meshes: any element, any geometry below a named contact face."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache, partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from multiscale.errors import CaseError, listed, require
from multiscale.laws.bulk import J2
from multiscale.laws.bulk.bulk_law import check_moduli, lame_parameters
from multiscale.micro.averages import ContactSurface, recovered_force
from multiscale.micro.layer import Linear, PeriodicLayer, at_first_touch, statistics_of
from multiscale.micro.path import (
    AVERAGES,
    CellModel,
    ContactState,
    ElasticCell,
    Path,
    cell_choices,
    obstacle_normal,
)
from multiscale.needs import Needs
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from scipy import sparse
    from skfem import CellBasis, Element, Mesh

    from multiscale.micro.elastic.active_set import Inverse
    from multiscale.micro.mesh.unknowns import CellUnknowns, ElasticMesh

Operator = Callable[[np.ndarray], np.ndarray]

MOST_FACTORED = 20_000
"""Unknowns above which factors of a stiffness in three dimensions fill up, and multigrid is used.

Cells with a rough obstacle, sides of uniform traction, a metal or friction always use factors.
"""

MESH = 4e-5  # s per load step and unknown on a core, measured


class CellSides(StrEnum):
    """Condition on the sides of a cell on a mesh.

    Opposite periodic sides have equal displacements; sliding sides stay in their planes. Sides of
    uniform displacement move down in proportion to z and not across; the force on their highest
    node is the resultant over all sides. Sides of uniform traction deform freely at zero mean
    strain in the plane. At a given approach the energies with uniform displacement and uniform
    traction bound the energy of periodic sides from above and below.
    """

    PERIODIC = "periodic"
    SLIDING = "sliding"
    DISPLACEMENT = "displacement"
    TRACTION = "traction"


@dataclass(frozen=True, eq=False)
class MeshCell:
    """A body on any scikit-fem mesh, pressed by a rigid obstacle.

    Parameters
    ----------
    mesh : Mesh
        Three-dimensional, between planes x = const and y = const, with boundaries named ``"base"``
        (clamped) and ``"top"`` (contact). The top may overhang.
    element : Element
        Scalar element for each displacement component, for instance ``ElementTetP2()``.
    law : Elastic, GradedElastic or J2, graded moduli have the shape (elements,)
    sides : CellSides
        Periodic sides, with nodes that match; sides that slide in their planes; or uniform
        displacement and uniform traction, which bound the solution of periodic sides.
    obstacle : Surface, optional, underside of the rigid obstacle; flat if not given
    layer : PeriodicLayer, optional
        The layer that the mesh discretises, if its contact nodes are the points of a surface.
    points : tuple of int, optional
        Points along x and y of the stored fields of a mesh without such a layer.
    friction_coefficient : float, coefficient of the local Coulomb law
    """

    mesh: "Mesh"
    element: "Element"
    law: Linear | J2
    sides: CellSides = CellSides.PERIODIC
    obstacle: Surface | None = None
    layer: PeriodicLayer | None = None
    points: tuple[int, int] | None = None
    friction_coefficient: float = 0.0
    small_slopes: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not isinstance(self.law, Linear | J2):
            raise CaseError(
                f"a cell on a general mesh takes Elastic, GradedElastic or J2 as its law, got "
                f"{type(self.law).__name__}"
            )
        mu = self.friction_coefficient
        require("the friction coefficient", mu, "[0, inf)")
        fits = {CellSides.PERIODIC} if mu > 0.0 else {CellSides.PERIODIC, CellSides.SLIDING}
        if self.remembers and (self.sides not in fits or self.obstacle is not None):
            raise CaseError(
                f"a mesh with {'friction' if mu > 0.0 else 'a metal that flows'} takes "
                f"{' or '.join(sorted(fits))} sides and a flat obstacle, got {self.sides} sides"
                f"{'' if self.obstacle is None else ' and a rough obstacle'}; change them, or put "
                f"the roughness on the mesh"
            )
        check_moduli(self.law.youngs_modulus, self.law.poissons_ratio, least=0.0)
        boundaries = self.mesh.boundaries or {}
        missing = sorted({"base", "top"} - set(boundaries))
        if missing:
            raise CaseError(
                f"a cell needs boundaries named {' and '.join(missing)}, which the mesh lacks; its "
                f"boundaries are {listed(boundaries)}"
            )
        for name, value in (
            ("Young's modulus", self.law.youngs_modulus),
            ("Poisson's ratio", self.law.poissons_ratio),
        ):
            if np.shape(value) not in ((), (self.mesh.nelements,)):
                raise CaseError(
                    f"{name} must be a number or have the shape ({self.mesh.nelements},) of the "
                    f"elements, got {np.shape(value)}"
                )
        if self.obstacle is not None and self.sides in (CellSides.DISPLACEMENT, CellSides.TRACTION):
            raise CaseError(
                f"sides of uniform {self.sides.value} need a flat obstacle; choose periodic or "
                f"sliding sides, or put the roughness on the mesh"
            )

    @property
    def unknowns(self) -> int:
        """Number of displacements of all nodes."""
        from skfem.assembly import Dofs

        return 3 * int(Dofs(self.mesh, self.element).N)

    @property
    def multigrid(self) -> bool:
        """Whether multigrid solves contact, in place of factors of the stiffness."""
        flat = self.obstacle is None and self.sides is not CellSides.TRACTION
        return flat and not self.remembers and self.unknowns > MOST_FACTORED

    @property
    def recovers_stress(self) -> bool:
        """Whether contact forces follow from stresses: not with sides of uniform displacement."""
        return self.sides is not CellSides.DISPLACEMENT and not self.remembers

    @property
    def remembers(self) -> bool:
        """Whether the solution depends on the path: the body flows, or there is friction."""
        return self.law.flows or self.friction_coefficient > 0.0

    @property
    def field_shape(self) -> tuple[int, int] | None:
        """Points along x and y of the fields that can be stored, if any."""
        return self.points if self.layer is None else self.layer.field_shape

    @property
    def grid_spacing(self) -> tuple[float, float] | None:
        """Distance of points along x and y of the gap, m; none without a surface."""
        return None if self.layer is None else self.layer.grid_spacing

    def cautions(self) -> list[str]:
        """Return warnings about the accuracy of the results, a sentence each."""
        cautions = [] if self.layer is None else self.layer.cautions()
        if self.law.flows and self.element.maxdeg == 1:
            cautions.append(
                "tetrahedra of first order lock where a metal flows at constant volume, and are "
                "too stiff; take the element tet10 or hex8"
            )
        return cautions

    def surface_record(self, *, heights: bool) -> dict[str, np.ndarray]:
        """Return the statistics of the surface for a response, with its heights on request, m."""
        if self.field_shape is None:
            return {}
        if self.layer is not None:
            return statistics_of(self.layer.surface, heights=heights)
        height, _ = _uppermost_facets(self)
        size = np.ptp(self.mesh.p, axis=1)
        uppermost = Surface(height - height.mean(), (float(size[0]), float(size[1])))
        return statistics_of(uppermost, heights=heights)

    def needs(self) -> Needs:
        """Return components, memory and time of a load step."""
        large, mu = self.law.finite_strain, self.friction_coefficient
        unknowns, multigrid = self.unknowns, self.multigrid
        # measured with hexahedra of 37,000 to 553,000 unknowns: assembly, stiffness, coarse spaces
        entries = {4: 45, 8: 81, 10: 85, 27: 110}[len(self.element.doflocs)]  # in a row
        factors = 0.0 if multigrid else 12 * unknowns**1.33
        matrices = 2 if self.remembers else 1  # the stiffness, and Newton's matrix
        return Needs(
            unknowns_per_contact=3 if mu > 0.0 else 1,
            kinematics=f"{'large' if large else 'small'} strain on a finite-element mesh, rigid "
            f"{'flat' if self.obstacle is None else 'rough'} obstacle",
            choices=cell_choices(
                {
                    "stiffness": "assembled to a matrix",
                    "tangent": large
                    and "stiffness of the strained elements, assembled to a matrix",
                    "friction": mu > 0.0,
                    "mean dilatation": self.law.flows
                    and self.element.maxdeg <= 3
                    and AVERAGES.format("in the energy"),
                    "factors": "Newton's matrix is factorised in every iteration"
                    if self.remembers
                    else not multigrid,
                    "multigrid": multigrid,
                    "obstacle normals": self.obstacle is not None,
                    "element moduli": np.ndim(self.law.youngs_modulus) > 0,
                },
                {
                    "layer factors": "the assembled matrix has another way to speed up the "
                    "iteration",
                    "mean dilatation": "the element is the user's choice",
                },
            ),
            state_variables=self.law.history,
            libraries=("numba", *(["pyamg"] if multigrid else []), "scikit-fem"),
            memory=int(matrices * (140 * unknowns * entries + factors)),
            seconds=MESH * unknowns,
        )

    def model(self, path: Path, *, recover_stress: bool = False) -> CellModel[Any]:
        """Set up the contact problem of the cell for a path."""
        if not self.remembers:
            path.check_still()
            return assemble_elastic_mesh(self, recover_stress=recover_stress).problem
        from multiscale.micro.mesh.mesh_history import assemble_mesh_history

        mesh = assemble_elastic_mesh(self)
        return assemble_mesh_history(mesh, self.law, self.friction_coefficient, path)


def assemble_elastic_mesh(cell: MeshCell, *, recover_stress: bool = False) -> "ElasticMesh":
    """Set up operators and contact geometry on any mesh."""
    from scipy import sparse

    from multiscale.fe.elasticity import assemble_elasticity
    from multiscale.micro.mesh.unknowns import ElasticMesh, cell_unknowns

    basis = _cell_basis(cell)
    lame, shear = lame_parameters(cell.law.youngs_modulus, cell.law.poissons_ratio)
    unknowns = cell_unknowns(basis, cell.sides)
    expand, nodes = unknowns.expand, unknowns.nodes
    stiffness = sparse.csr_array(expand.T @ assemble_elasticity(basis, lame, shear) @ expand)
    stiffness.sum_duplicates()

    # contact geometry at first touch
    surface = unknowns.coefficients @ basis.doflocs[2]
    obstacle, slopes = _obstacle(cell.obstacle, basis.doflocs[:2, nodes])
    obstacle, _ = at_first_touch(surface, obstacle)
    normal = obstacle_normal(*slopes)
    gap, closing = (obstacle - surface) * normal[:, 2], normal[:, 2]
    follows = unknowns.number[:, 2] < 0  # a node that follows a leading node touches after it
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


def _cell_basis(cell: MeshCell) -> "CellBasis":
    from skfem import Basis
    from skfem.refdom import RefTet, RefTri

    from multiscale.fe.mesh_file import check_orientation

    # exact for straight-sided elements: gradients squared (order p counts per direction on bricks)
    simplex = cell.mesh.refdom in (RefTri, RefTet)
    order = 2 * (cell.element.maxdeg - 1) if simplex else 2 * (cell.element.maxdeg // 3)
    basis = Basis(cell.mesh, cell.element, intorder=max(order, 1))
    check_orientation(basis)
    return basis


def _solver(
    cell: MeshCell,
    basis: "CellBasis",
    unknowns: "CellUnknowns",
    stiffness: "sparse.csr_array",
    normal: np.ndarray,
) -> Callable[..., ContactState]:
    """Return the contact solver: factors of the stiffness, or multigrid if it is large."""
    from scipy import sparse

    from multiscale.micro.elastic.active_set import (
        ElasticBody,
        ReferenceInverse,
        solve_elastic_contact,
    )

    # trace of the displacement along the contact normals, and its transpose
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
        from multiscale.fe.elasticity import rigid_motions
        from multiscale.micro.mesh.unknowns import MultigridInverse

        place, size = unknowns.place, float(np.ptp(basis.doflocs))
        modes = rigid_motions(basis.doflocs.T[place // 3] / size, place % 3)
        inverse = MultigridInverse(stiffness, modes, place, number[:, 2])
    else:
        from multiscale.micro.mesh.unknowns import mean_strain
        from multiscale.numerics.factorisation import factorise

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
    stiffness: "sparse.csr_array", solve_free: Operator, constraint: np.ndarray
) -> tuple[Operator, Operator]:
    """Stiffness and its inverse for displacements with C u = 0; multipliers: side stresses."""
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
    cell: MeshCell, basis: "CellBasis", unknowns: "CellUnknowns"
) -> Callable[[ContactSurface], ContactSurface]:
    """Return the function that prepares a contact surface for averages, on a grid if possible."""
    nodes = unknowns.nodes
    if cell.layer is None:
        uppermost = cache(partial(_uppermost_facets, cell))

        def to_grid(values: np.ndarray) -> np.ndarray:
            nodal, (height, interpolate) = np.zeros(basis.N), uppermost()
            nodal[nodes] = values
            at_points = interpolate @ nodal[unknowns.image][basis.nodal_dofs[0]]
            return np.asarray(at_points.reshape(height.shape))

        return partial(replace, neighbours=unknowns.neighbours, to_grid=to_grid)

    grid, points = cell.layer.surface, basis.doflocs[:2, nodes]
    i, j = (
        np.rint(at / step).astype(int) % n
        for at, step, n in zip(points, grid.spacing, grid.heights.shape, strict=True)
    )
    node = np.empty(grid.heights.shape, dtype=int)
    node[i[::-1], j[::-1]] = np.arange(len(i))[::-1]  # contact node of every point of the grid
    if cell.sides is not CellSides.PERIODIC:  # nodes at both ends of a line
        return partial(replace, neighbours=unknowns.neighbours, to_grid=lambda values: values[node])
    from multiscale.micro.elastic.flat_reference import element_edges

    edges = element_edges(cell.layer)
    return lambda surface: surface.on_grid(node, edges)


def _uppermost_facets(cell: MeshCell) -> "tuple[np.ndarray, sparse.csr_array]":
    """Heights of the uppermost facets at points (nx, ny), m, and interpolation from vertices."""
    from scipy import sparse

    from multiscale.fe.faces import face_of

    mesh, (nx, ny) = cell.mesh, cell.points or (0, 0)
    face = face_of(mesh, "top")
    corner = face.nodes[face.facets].T
    triangles = np.hstack([corner[[0, k, k + 1]] for k in range(1, len(corner) - 1)])
    # grid of points, and the triangle and interpolation weights at each
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
        window = tuple(
            slice(*np.searchsorted(axis, (min(ends) - room, max(ends) + room)))
            for axis, ends, room in zip(axes, ((x0, x1, x2), (y0, y1, y2)), margin[:2], strict=True)
        )
        x, y = np.meshgrid(axes[0][window[0]], axes[1][window[1]], indexing="ij")
        b = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / area
        c = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / area
        weights = np.stack([1.0 - b - c, b, c], axis=-1)
        over = np.all(weights > -near, axis=-1) & (weights @ z > height[*window])
        height[*window][over] = (weights @ z)[over]
        owner[*window][over], share[*window][over] = triangle, weights[over]
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
