"""From a cell to its scene: body, preconditioner, obstacle and weights of the contact equations."""

import numpy as np
from scipy import fft

from multiscale.laws.bulk import J2, NeoHookean, Prony
from multiscale.micro.cell import Cell
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

TANGENTIAL_WEIGHT = 0.3  # relative to the tangential stiffness of a single node


def make_scene(cell: Cell) -> CellScene:
    """Set up the scene of a cell with friction, at large strain or with two bodies."""
    body, reference = _body(cell), _reference(cell)
    mu = cell.friction_coefficient
    if cell.opposite is None:
        obstacle = HeightObstacle(cell.surface, cell.obstacle, follows=cell.bulk is not None)
        return RigidScene(body, obstacle, mu, _weights(reference.inverse), reference)
    other = cell.opposite_cell
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


def _mesh(cell: Cell) -> GraphMesh:
    planes = graded_planes(cell.depth, cell.layers, min(cell.surface.spacing))
    return GraphMesh(cell.surface, planes)


def _flat_inverse(cell: Cell, grid: Surface) -> LateralInverse:
    """Factorise the flat cell on the points of a surface."""
    return factorise_flat_cell(
        grid.heights.shape,
        grid.spacing,
        _mesh(cell).planes,
        *cell.layer_moduli,
        mean_dilatation=cell.nearly_incompressible,
    )


def _reference(cell: Cell) -> Reference:
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


def _body(cell: Cell) -> FiniteBody:
    mesh, soft = _mesh(cell), cell.nearly_incompressible
    nx, ny, layers = mesh.shape
    if cell.bulk is None:
        stiffness = stiffness_operator(mesh, *cell.moduli, mean_dilatation=soft)
        return linear_body(stiffness, (nx, layers, 3, ny))
    assert isinstance(cell.bulk, NeoHookean | J2 | Prony)
    return large_strain_body(mesh, cell.bulk, mean_dilatation=soft or isinstance(cell.bulk, J2))
