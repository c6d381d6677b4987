"""The periodic graph cell as an elastic body: matrix-free stiffness, lateral-FFT inverse."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.averages import recovered_force
from multiscale.micro.finite.finite_cell import FiniteCell
from multiscale.micro.layer import GraphMesh, PeriodicLayer
from multiscale.micro.path import CellModel, ElasticCell, Path, cell_choices, obstacle_normal
from multiscale.needs import Needs

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
