"""The periodic graph cell as an elastic body: matrix-free stiffness, lateral-FFT inverse."""

from collections.abc import Callable

import numpy as np
from scipy import fft

from multiscale.micro.averages import recovered_force
from multiscale.micro.cell import Cell, lame_parameters
from multiscale.micro.contact import ContactProblem, ElasticBody, obstacle_normal
from multiscale.micro.lateral_fft import LateralInverse, factorise_flat_cell
from multiscale.micro.mesh import GraphMesh, graded_planes
from multiscale.micro.operator import stiffness_operator

__all__ = ["assemble_graph_cell"]


def assemble_graph_cell(cell: Cell) -> ContactProblem:
    """Set up operators and contact geometry of a graph cell.

    Raises
    ------
    CaseError
        If the numbers of points are odd or the cell folds over.
    """
    surface = cell.surface
    (nx, ny), spacing = surface.heights.shape, surface.spacing
    mesh = GraphMesh(surface, graded_planes(cell.depth, cell.layers, min(spacing)))
    lame, shear = (
        np.full(cell.layers, float(value))
        for value in lame_parameters(cell.youngs_modulus, cell.poissons_ratio)
    )
    inverse = factorise_flat_cell((nx, ny), spacing, mesh.planes, lame, shear)

    if cell.obstacle is None:
        obstacle = np.full((nx, ny), surface.heights.max())
        normal = np.zeros((nx, 3, ny))
        normal[:, 2] = 1.0
        contact = _flat_obstacle_operators(inverse)
    else:
        obstacle = cell.obstacle.heights + np.max(surface.heights - cell.obstacle.heights)
        normal = obstacle_normal(*(_slope(obstacle, axis, spacing[axis]) for axis in (0, 1)))
        contact = _graph_obstacle_operators(inverse, normal)
    trace, add, push, compliance = contact

    stiffness = 1.0 / inverse.surface_compliance[5]

    def solve(force: np.ndarray, correct: Callable[[np.ndarray], np.ndarray] | None) -> np.ndarray:
        if correct is None:
            return inverse.solve(force)
        return inverse.solve(force, lambda surface_u: push(-correct(trace(surface_u[:, None]))))

    body = ElasticBody(
        apply=stiffness_operator(mesh, lame, shear),
        solve=solve,
        trace=trace,
        add=add,
        compliance=compliance,
        surface_stiffness=lambda values: _filter(values, stiffness),
        shape=(nx, cell.layers, 3, ny),
    )

    def recover(displacement: np.ndarray, active: np.ndarray) -> np.ndarray:
        from skfem import ElementHex1

        top = mesh.hexahedra(first_layer=cell.layers - 1)
        i, j = (np.rint(top.p[k] / spacing[k]).astype(int) % n for k, n in ((0, nx), (1, ny)))
        upper = np.zeros(top.nvertices, dtype=bool)
        upper[np.unique(top.facets[:, top.boundaries["top"]])] = True
        layer = np.where(upper, -1, -2)
        return recovered_force(
            top,
            ElementHex1(),
            displacement[i, layer, :, j].T,
            active[i, j] & upper,
            lame[-1],
            shear[-1],
        )

    return ContactProblem(
        body,
        normal,
        surface.heights,
        obstacle,
        np.full((nx, ny), spacing[0] * spacing[1]),
        surface_displacement=lambda u: u[:, -1],
        recover=recover,
    )


_Operators = tuple[
    Callable[[np.ndarray], np.ndarray],  # trace
    Callable[[np.ndarray, np.ndarray], None],  # add
    Callable[[np.ndarray], np.ndarray],  # push: contact forces to forces on the surface
    Callable[[np.ndarray], np.ndarray],  # compliance
]


def _slope(heights: np.ndarray, axis: int, step: float) -> np.ndarray:
    """Periodic differences of fourth order: local, so that a kink stays a kink."""
    near = np.roll(heights, -1, axis) - np.roll(heights, 1, axis)
    far = np.roll(heights, -2, axis) - np.roll(heights, 2, axis)
    return np.asarray((8.0 * near - far) / (12.0 * step))


def _filter(values: np.ndarray, symbol: np.ndarray) -> np.ndarray:
    """Multiply by a symbol in the lateral Fourier space."""
    return np.asarray(fft.irfft2(fft.rfft2(values) * symbol, s=values.shape, overwrite_x=True))


def _flat_obstacle_operators(inverse: LateralInverse) -> _Operators:
    """One unknown per contact node, along z."""

    def trace(u: np.ndarray) -> np.ndarray:
        return u[:, -1, 2]

    def add(vector: np.ndarray, values: np.ndarray) -> None:
        vector[:, -1, 2] += values

    def push(force: np.ndarray) -> np.ndarray:
        nx, ny = force.shape
        pushed = np.zeros((nx, 3, ny))
        pushed[:, 2] = force
        return pushed

    symbol = inverse.surface_compliance[5]
    return trace, add, push, lambda force: _filter(force, symbol)


def _graph_obstacle_operators(inverse: LateralInverse, normal: np.ndarray) -> _Operators:
    """One unknown per contact node, along the obstacle's normal."""

    def trace(u: np.ndarray) -> np.ndarray:
        return np.asarray(np.sum(u[:, -1] * normal, axis=1))

    def add(vector: np.ndarray, values: np.ndarray) -> None:
        vector[:, -1] += values[:, None] * normal

    def push(force: np.ndarray) -> np.ndarray:
        return np.asarray(force[:, None] * normal)

    def compliance(force: np.ndarray) -> np.ndarray:
        return np.asarray(np.sum(inverse.surface_response(push(force)) * normal, axis=1))

    return trace, add, push, compliance
