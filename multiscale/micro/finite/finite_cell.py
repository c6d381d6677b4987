"""From a cell to its scene: bodies, flat cells, opposite side and weights of the equations."""

import numpy as np
from scipy import fft

from multiscale.laws.bulk import Elastic, GradedElastic
from multiscale.micro.cell import FiniteCell
from multiscale.micro.elastic.flat_reference import Reference, flat_inverse, flat_reference
from multiscale.micro.elastic.lateral_fft import LateralInverse
from multiscale.micro.elastic.stiffness import stiffness_operator
from multiscale.micro.finite.large_strain import large_strain_body
from multiscale.micro.finite.preconditioner import FlatCells, join_flat_cells, mixed_reference
from multiscale.micro.finite.scene import CellScene, FiniteBody, linear_body
from multiscale.micro.finite.surfaces import OppositeSide
from multiscale.micro.layer import GraphMesh, PeriodicLayer
from multiscale.surfaces.surface import Surface

__all__ = ["make_scene"]

TANGENTIAL_WEIGHT = 0.3  # relative to the tangential stiffness of a single node


def make_scene(cell: FiniteCell) -> CellScene:
    """Set up the scene of a cell with friction, at large strain or with two bodies."""
    body, reference = _layer(cell)
    bodies: tuple[FiniteBody, ...] = (body,)
    cells = FlatCells((reference,), reference)
    opposite = OppositeSide(cell.surface, cell.obstacle, follows=cell.law.finite_strain)
    if cell.second is not None:
        other = cell.second_layer
        second, opposite_reference = _layer(other)
        compliance = flat_inverse(other, _mesh(other), cell.surface).surface_compliance
        bodies, cells = (body, second), join_flat_cells(reference, opposite_reference, compliance)
        underside = Surface(-other.surface.heights, other.surface.size)
        opposite = OppositeSide(cell.surface, underside)
    weights = _weights(cells.both.inverse)
    return CellScene(bodies, opposite, cell.friction_coefficient, weights, cells)


def _mesh(cell: PeriodicLayer) -> GraphMesh:
    return GraphMesh(cell.surface, cell.planes)


def _weights(inverse: LateralInverse) -> tuple[float, float]:
    """Weights of the contact equations, N/m."""
    symbols = inverse.surface_compliance
    nx, _, ny = inverse.shape
    single = float(fft.irfft2(symbols[0], s=(nx, ny))[0, 0])
    return float(np.median(1.0 / symbols[5])), TANGENTIAL_WEIGHT / single


def _layer(cell: PeriodicLayer) -> tuple[FiniteBody, Reference]:
    """Body, and its flat cell; at large strain both have pressures where volumes are mean."""
    mesh, law = _mesh(cell), cell.law
    precision = np.float64 if cell.nearly_incompressible else np.float32  # of the preconditioner
    if isinstance(law, Elastic | GradedElastic):
        nx, ny, layers = mesh.shape
        stiffness = stiffness_operator(mesh, *cell.moduli, mean_dilatation=cell.mean_dilatation)
        return linear_body(stiffness, (nx, layers, 3, ny)), flat_reference(cell, mesh, precision)
    body = large_strain_body(mesh, law, mixed=cell.mean_dilatation)
    make = mixed_reference if cell.mean_dilatation else flat_reference
    return body, make(cell, mesh, precision)
