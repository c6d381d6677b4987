"""The periodic graph cell as an elastic body: matrix-free stiffness, lateral-FFT inverse."""

from collections.abc import Callable
from functools import partial

import numpy as np

from multiscale.micro.averages import recovered_force
from multiscale.micro.cell import GraphCell, PeriodicLayer
from multiscale.micro.contact_area import EdgeLayer, edge_layer
from multiscale.micro.contact_state import ElasticCell, at_first_touch, obstacle_normal
from multiscale.micro.elastic_contact import ElasticBody, solve_elastic_contact
from multiscale.micro.elastic_operator import stiffness_operator
from multiscale.micro.flat_reference import flat_reference, surface_slopes
from multiscale.micro.graph_mesh import GraphMesh
from multiscale.micro.lateral_fft import factorise_flat_cell
from multiscale.micro.layered import layered_compliance

__all__ = ["assemble_graph_cell", "element_edges"]

Operator = Callable[[np.ndarray], np.ndarray]

EDGE_POINTS = 32  # of the waves that tell what elements do at an edge of contact


def assemble_graph_cell(cell: GraphCell, *, recover_stress: bool = False) -> ElasticCell:
    """Set up the operators that a graph cell needs, and its contact geometry."""
    surface = cell.surface
    (nx, ny), spacing = surface.heights.shape, surface.spacing
    mesh = GraphMesh(surface, cell.planes)
    lame, shear = cell.moduli
    # iterations with single precision are as many; nearly incompressible cells need all digits
    dtype = np.float64 if cell.nearly_incompressible else np.float32
    reference = flat_reference(cell, mesh, dtype)
    obstacle, _ = at_first_touch(
        surface.heights, 0.0 if cell.obstacle is None else cell.obstacle.heights
    )
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
        solve=solve,
        trace=lambda u: along(u[:, -1]),
        add=add,
        compliance=compliance,
        surface_stiffness=stiffness,
        shape=(nx, cell.layers, 3, ny),
        dtype=dtype,
    )

    closing = normal[:, 2]
    return ElasticCell(
        partial(solve_elastic_contact, body, (obstacle - surface.heights) * closing, closing),
        normal,
        surface.heights,
        obstacle,
        np.full((nx, ny), spacing[0] * spacing[1]),
        surface_displacement=lambda u: u[:, -1],
        recover=partial(_recover, cell, mesh) if recover_stress else None,
        edges=element_edges(cell),
    )


def element_edges(cell: PeriodicLayer) -> tuple[EdgeLayer, EdgeLayer]:
    """Return what the elements of the bodies of a cell do at an edge along x and y."""
    n, edges = EDGE_POINTS, []
    for spacing in cell.surface.spacing:
        discrete, exact = np.zeros((2, n // 2 + 1))
        for body in cell.bodies:
            planes = body.planes
            inverse = factorise_flat_cell(
                (n, 1),
                (spacing, spacing),
                planes,
                *body.layer_moduli,
                mean_dilatation=body.mean_dilatation,
            )
            discrete += spacing**2 * inverse.surface_compliance[5][: n // 2 + 1, 0]
            exact += layered_compliance((1, n), (1.0, n * spacing), planes, *body.layer_moduli)[0]
        edges.append(edge_layer(discrete / exact))
    return edges[0], edges[1]


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
    """Part of surface vectors along the obstacle's normals, or along z, and the vectors of parts.

    Vectors and normals have the shape (nx, 3, ny), and parts (nx, ny).
    """
    if normal is not None:
        return (
            lambda vector: np.asarray(np.sum(vector * normal, axis=1)),
            lambda part: np.asarray(part[:, None] * normal),
        )

    def push(part: np.ndarray) -> np.ndarray:
        vector = np.zeros((len(part), 3, part.shape[1]))
        vector[:, 2] = part
        return vector

    return lambda vector: vector[:, 2], push
