"""Linear elastic cells below height maps: flat layers, and meshes that follow the surface."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.micro.averages import recovered_force
from multiscale.micro.finite.finite_cell import FiniteCell
from multiscale.micro.layer import GraphMesh, PeriodicLayer, SecondBody, statistics_of
from multiscale.micro.path import (
    CellModel,
    ContactState,
    ElasticCell,
    Path,
    cell_choices,
    obstacle_normal,
    untouched,
)
from multiscale.needs import Needs
from multiscale.surfaces.fourier import rms_slope
from multiscale.surfaces.preparation import composite
from multiscale.surfaces.surface import Surface

Operator = Callable[[np.ndarray], np.ndarray]

ELASTIC = 5.5e-7  # s per load step and unknown on a core, measured


@dataclass(frozen=True, eq=False)
class GraphCell(PeriodicLayer):
    """A linear elastic layer with a mesh that follows its surface, pressed by a rigid obstacle.

    Contact acts along the normal of the rigid obstacle, without friction. For the parameters see
    :class:`PeriodicLayer`; a law that is not linear is refused.
    """

    recovers_stress: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.law.finite_strain:
            raise CaseError("a graph cell is linear elastic; use FiniteCell for large strain")

    def needs(self) -> Needs:
        """Return components, memory and time of a load step."""
        return Needs(
            kinematics="small strain, the mesh follows the surface",
            choices=cell_choices(
                {
                    "stiffness": True,
                    "layer factors": True,
                    "mean dilatation": self.mean_dilatation,
                    "tilt": self.nearly_incompressible,
                    "obstacle normals": self.obstacle is not None,
                    "element moduli": self.heterogeneous,
                    "coating": bool(self.coating),
                }
            ),
            libraries=("numba",),
            memory=self.memory(0.0),
            seconds=ELASTIC * self.unknowns,
        )

    def model(self, path: Path, *, recover_stress: bool = False) -> CellModel[Any]:
        """Set up the contact problem for a path; with sliding as a finite cell."""
        if path.slide is not None:
            fields = self.surface, self.depth, self.layers, self.law, self.obstacle
            return FiniteCell(*fields, coating=self.coating).model(path)
        path.check_still()
        return assemble_graph_cell(self, recover_stress=recover_stress)


def assemble_graph_cell(cell: GraphCell, *, recover_stress: bool = False) -> ElasticCell:
    """Set up the operators and the contact geometry of a graph cell."""
    from multiscale.micro.elastic.active_set import (
        ElasticBody,
        ReferenceInverse,
        solve_elastic_contact,
    )
    from multiscale.micro.elastic.flat_reference import (
        element_edges,
        flat_reference,
        surface_slopes,
    )
    from multiscale.micro.elastic.stiffness import stiffness_operator

    surface = cell.surface
    (nx, ny), spacing = surface.heights.shape, surface.spacing
    mesh = GraphMesh(surface, cell.planes)
    lame, shear = cell.moduli
    # single precision costs no iterations; nearly incompressible cells need double precision
    dtype = np.float64 if cell.nearly_incompressible else np.float32
    reference = flat_reference(cell, mesh, dtype)
    # contact along the normals of the obstacle
    obstacle = cell.raised_obstacle
    normal = obstacle_normal(*surface_slopes(obstacle, spacing))
    along, push = _along_normals(None if cell.obstacle is None else normal)
    vertical, stiffness = reference.vertical
    convolves = cell.obstacle is None and reference.convolves

    def compliance(force: np.ndarray) -> np.ndarray:
        return vertical(force) if convolves else along(reference.compliance(push(force)))

    def solve(
        force: np.ndarray | None, correct: Operator, out: np.ndarray | None = None
    ) -> np.ndarray:
        return reference.solve(force, lambda moved: -push(correct(along(moved))), out)

    def add(vector: np.ndarray, values: np.ndarray) -> None:
        vector[:, -1] += push(values)

    body = ElasticBody(
        apply=stiffness_operator(mesh, lame, shear, mean_dilatation=cell.mean_dilatation),
        trace=lambda u: along(u[:, -1]),
        add=add,
        inverse=ReferenceInverse(solve, compliance, stiffness),
        shape=(nx, cell.layers, 3, ny),
        dtype=dtype,
    )

    closing = normal[:, 2]
    return ElasticCell(
        partial(solve_elastic_contact, body, (obstacle - surface.heights) * closing, closing),
        normal,
        surface.heights,
        obstacle,
        cell.node_area,
        surface_displacement=lambda u: u[:, -1],
        recover=partial(_recover, cell, mesh) if recover_stress else None,
        edges=element_edges(cell),
    )


def _recover(
    cell: GraphCell, mesh: GraphMesh, displacement: np.ndarray, active: np.ndarray
) -> np.ndarray:
    """Force on the contact spots from the stress of the uppermost elements, N."""
    from skfem import ElementHex1

    (nx, ny), spacing = cell.surface.heights.shape, cell.surface.spacing
    top = mesh.hexahedra(first_layer=cell.layers - 1)
    i, j = (np.rint(top.p[k] / spacing[k]).astype(int) % n for k, n in ((0, nx), (1, ny)))
    upper = np.zeros(top.nvertices, dtype=bool)
    upper[np.unique(top.facets[:, top.boundaries["top"]])] = True
    layer = np.where(upper, -1, -2)
    centre = top.p[:, top.t].mean(axis=1)
    cells = [np.floor(centre[k] / spacing[k]).astype(int) for k in range(2)]
    moduli = (
        value[-1] if value.ndim == 1 else value[cells[0], -1, cells[1]] for value in cell.moduli
    )
    return recovered_force(
        top, ElementHex1(), displacement[i, layer, :, j].T, active[i, j] & upper, *moduli
    )


def _along_normals(normal: np.ndarray | None) -> tuple[Operator, Operator]:
    """Return the projection of surface vectors on the normals, or z, and its transpose."""
    if normal is not None:
        return (
            lambda vector: np.asarray(np.sum(vector * normal, axis=1)),
            lambda component: np.asarray(component[:, None] * normal),
        )

    def push(component: np.ndarray) -> np.ndarray:
        vector = np.zeros((len(component), 3, component.shape[1]))
        vector[:, 2] = component
        return vector

    return lambda vector: vector[:, 2], push


STEEPEST = 0.5  # largest root mean square slope of the expansion in the slopes
TOLERANCE = 1e-6  # relative to the range of the gap; see solve_flat
FLAT, EXPANDED = 1.1e-6, 1.8e-6  # s per load step and point on a core, measured


@dataclass(frozen=True, eq=False)
class FlatCell(PeriodicLayer):
    """A flat elastic layer with the roughness as gap.

    Fast, and accurate for small slopes: relative to the conforming cell its error is of first order
    in the slope, or of second order with an expanded compliance. In addition to the parameters of
    :class:`PeriodicLayer`:

    Parameters
    ----------
    hardness : float, optional, largest local pressure, Pa: a simple model of plastic flow
    slope_order : int
        Order of the error in the slopes of both surfaces: 1, or 2 with
        :func:`~.compliance.expanded_compliance`.
    second : SecondBody, optional
        Makes the obstacle deformable: the compliances of both bodies add up.

    A law that is not linear and moduli that vary within a layer are refused.
    """

    hardness: float | None = None
    slope_order: int = 1
    second: SecondBody | None = None
    small_slopes: ClassVar[bool] = True
    recovers_stress: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(body.law.finite_strain for body in self.bodies):
            raise CaseError(
                "a flat cell has neither friction nor a law at large strain; use the conforming "
                "geometry"
            )
        if any(body.heterogeneous for body in self.bodies):
            raise CaseError(
                "moduli of a flat cell vary from layer to layer, not from element to element; use "
                "the conforming geometry"
            )
        if self.hardness is not None:
            require("the hardness", self.hardness, "(0, inf)", "Pa")
        if self.slope_order not in (1, 2):
            raise CaseError(f"slope_order of a flat cell must be 1 or 2, got {self.slope_order}")
        if self.slope_order == 2:
            self._check_expansion()

    def _check_expansion(self) -> None:
        """Refuse cells for which the expansion in the slopes is not derived."""
        for body in self.bodies:
            if body.coating or np.any([np.ptp(value) for value in body.layer_moduli]):
                raise CaseError(
                    "slope_order = 2 is derived for bodies of a single material, since faces "
                    "between materials are rough too; leave out coatings and moduli of layers, or "
                    "set slope_order to 1"
                )
            if body.depth < 0.5 * (period := max(self.surface.size)):
                raise CaseError(
                    f"slope_order = 2 is derived for half-spaces, but the depth of "
                    f"{body.depth:.3g} m is less than half of the period of {period:.3g} m; raise "
                    f"the depth"
                )
        slope = max(rms_slope(surface) for surface in self.surfaces)
        if slope > STEEPEST:
            raise CaseError(
                f"slope_order = 2 expands in slopes, but a surface has a root mean square slope "
                f"of {slope:.3g}, beyond {STEEPEST:g}; use the conforming geometry"
            )

    @property
    def surfaces(self) -> tuple[Surface, Surface]:
        """The surface and the underside of the obstacle, with heights out of each body."""
        under = 0.0 * self.surface.heights if self.obstacle is None else -self.obstacle.heights
        return self.surface, Surface(under, self.surface.size)

    @property
    def bodies(self) -> tuple[PeriodicLayer, ...]:
        """The deformable bodies, both flat."""
        return (self,) if self.second is None else (self, self.second.layer(self.surface))

    def surface_record(self, *, heights: bool) -> dict[str, np.ndarray]:
        """Return the statistics of the sum of both surfaces, with its heights on request, m."""
        return statistics_of(composite(*self.surfaces), heights=heights)

    def element_cautions(self) -> list[str]:
        """Return no warnings: there are no elements."""
        return []

    def needs(self) -> Needs:
        """Return components, memory and time of a load step."""
        nx, ny = self.surface.heights.shape
        expanded = self.slope_order == 2
        return Needs(
            kinematics="small strain, roughness as gap of a flat layer",
            choices=cell_choices(
                {
                    "hardness cap": self.hardness is not None,
                    "opposite body": self.second is not None,
                    "coating": any(body.coating for body in self.bodies),
                    "slope expansion": expanded,
                },
                {
                    "stiffness": "a flat cell solves on its surface only",
                    "stress recovery": "a flat cell has no stress field",
                    "slope expansion": "slopes are assumed small: errors are of first order in "
                    "the slopes (slope_order)",
                },
            ),
            libraries=("numba",),
            memory=8 * nx * ny * (32 if expanded else 20),
            seconds=nx * ny * (EXPANDED if expanded else FLAT),
        )

    def model(self, path: Path, *, recover_stress: bool = False) -> ElasticCell:
        """Set up the contact problem of the cell for a path."""
        path.check_still()
        return assemble_flat_cell(self)


def flat_compliance(cell: FlatCell) -> np.ndarray:
    """Symbol of the compliance of all bodies to nodal forces, m/N; coatings have exact faces."""
    from multiscale.micro.elastic.compliance import layered_compliance

    symbols = []
    for body in cell.bodies:
        if body.coating:
            planes = np.concatenate([[0.0], body.faces[::-1], [body.depth]])
            moduli = body.moduli_between(planes)
        else:
            planes, moduli = body.planes, body.layer_moduli
        shape, size = body.surface.heights.shape, body.surface.size
        symbols.append(layered_compliance(shape, size, planes, *moduli))
    return np.asarray(np.sum(symbols, axis=0) / np.prod(cell.surface.spacing))


def assemble_flat_cell(cell: FlatCell) -> ElasticCell:
    """Set up the contact problem of a flat elastic layer with roughness as gap."""
    from multiscale.micro.elastic.compliance import expanded_compliance
    from multiscale.micro.elastic.flat_contact import coarse_start, solve_flat
    from multiscale.micro.elastic.lateral_fft import SurfaceFilter

    heights, obstacle, symbol = cell.surface.heights, cell.raised_obstacle, flat_compliance(cell)
    nx, ny = heights.shape
    normal = np.zeros((nx, 3, ny))
    normal[:, 2] = 1.0

    gap, closing = obstacle - heights, np.ones((nx, ny))
    flat = SurfaceFilter(symbol)
    respond: Callable[[np.ndarray], np.ndarray] = flat
    lift = respond  # along z; forces of expanded bodies act along their normal
    if cell.slope_order == 2:
        moduli = [np.array(body.layer_moduli)[:, 0] for body in cell.bodies]
        lame, shear = np.array([*moduli, (0.0, np.inf)][:2]).T
        respond = expanded_compliance(cell.surfaces, symbol, shear, 0.5 * lame / (lame + shear))
        lift = partial(respond, vertical=True)
    cap = np.inf if cell.hardness is None else cell.hardness * float(np.prod(cell.surface.spacing))

    def solve(
        *,
        load: float | None = None,
        approach: float | None = None,
        start: ContactState | None = None,
        tolerance: float = TOLERANCE,
    ) -> ContactState:
        if load == 0.0 or (approach is not None and approach <= 0.0):
            return untouched((nx, 3, ny), gap, closing, approach)
        guess = None
        if load is not None:
            guess = coarse_start(flat, gap, closing, load=load, cap=cap)
        if guess is None and start is not None:
            guess = start.force
        contact = solve_flat(
            respond,
            gap,
            closing,
            load=load,
            approach=approach,
            cap=cap,
            start=guess,
            max_iterations=5000,
            tolerance=max(tolerance, TOLERANCE),
        )
        displacement = np.zeros((nx, 3, ny))
        displacement[:, 2] = -lift(contact.value)
        return ContactState(
            displacement,
            contact.value,
            contact.approach,
            contact.value > 0.0,
            contact.value,
            contact.status,
            contact.residuals[-1:],
            len(contact.residuals),
        )

    return ElasticCell(solve, normal, heights, obstacle, cell.node_area, lambda u: u, cap=cap)
