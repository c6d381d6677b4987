"""From a cell to its scene: body, preconditioner, obstacle and weights of the contact equations."""

import numpy as np
from scipy import fft

from multiscale.laws.bulk import Elastic, GradedElastic
from multiscale.micro.cell import FiniteCell, PeriodicLayer
from multiscale.micro.elastic_operator import stiffness_operator
from multiscale.micro.finite.finite_body import FiniteBody, linear_body
from multiscale.micro.finite.height_obstacle import HeightObstacle
from multiscale.micro.finite.large_strain import large_strain_body
from multiscale.micro.finite.pair_reference import PairReference, add_compliances
from multiscale.micro.finite.pair_scene import PairScene
from multiscale.micro.finite.reference import Reference
from multiscale.micro.finite.scene import CellScene, RigidScene
from multiscale.micro.finite.two_bodies import Halves, Underside, join_bodies
from multiscale.micro.graph_cell import surface_slopes
from multiscale.micro.graph_mesh import GraphMesh, graded_planes
from multiscale.micro.lateral_fft import LateralInverse, factorise_flat_cell
from multiscale.surfaces.surface import Surface

__all__ = ["make_scene"]

TANGENTIAL_WEIGHT = 0.3  # of the stiffness of a node against a force in the plane


def make_scene(cell: FiniteCell) -> CellScene:
    """Set up what solving a cell with friction, at large strain or with two bodies takes."""
    body, reference = _body(cell), _reference(cell)
    mu = cell.friction_coefficient
    if cell.second is None:
        obstacle = HeightObstacle(cell.surface, cell.obstacle, follows=cell.law.finite_strain)
        return RigidScene(body, obstacle, mu, _weights(reference.inverse), reference)
    other = cell.second_layer
    second = _body(other)
    compliance = _flat_inverse(other, cell.surface).surface_compliance
    both = Reference(add_compliances(reference.inverse, compliance), np.ones(1))
    halves = Halves((body.shape, second.shape))
    return PairScene(
        join_bodies(body, second),
        Underside(cell.surface, Surface(-other.surface.heights, other.surface.size)),
        mu,
        _weights(both.inverse),
        PairReference(reference, _reference(other), both, halves),
        halves,
    )


def _mesh(cell: PeriodicLayer) -> GraphMesh:
    planes = graded_planes(cell.depth, cell.layers, min(cell.surface.spacing))
    return GraphMesh(cell.surface, planes)


def _flat_inverse(cell: PeriodicLayer, grid: Surface) -> LateralInverse:
    """Factorise the flat cell on the points of a surface."""
    return factorise_flat_cell(
        grid.heights.shape,
        grid.spacing,
        _mesh(cell).planes,
        *cell.layer_moduli,
        mean_dilatation=cell.nearly_incompressible,
    )


def _reference(cell: PeriodicLayer) -> Reference:
    soft = cell.nearly_incompressible
    slopes = surface_slopes(cell.surface.heights, cell.surface.spacing) if soft else None
    inverse = _flat_inverse(cell, cell.surface)
    return Reference(inverse, _mesh(cell).map_factor[1:], slopes)


def _weights(inverse: LateralInverse) -> tuple[float, float]:
    """Weights of the contact equations, N/m."""
    symbols = inverse.surface_compliance
    nx, _, ny = inverse.shape
    own = float(fft.irfft2(symbols[0], s=(nx, ny))[0, 0])
    return float(np.median(1.0 / symbols[5])), TANGENTIAL_WEIGHT / own


def _body(cell: PeriodicLayer) -> FiniteBody:
    mesh, law = _mesh(cell), cell.law
    if isinstance(law, Elastic | GradedElastic):
        nx, ny, layers = mesh.shape
        stiffness = stiffness_operator(mesh, *cell.moduli, mean_dilatation=cell.mean_dilatation)
        return linear_body(stiffness, (nx, layers, 3, ny))
    return large_strain_body(mesh, law, mean_dilatation=cell.mean_dilatation)
