"""From a cell to its scene: body, preconditioner, obstacle and weights of the contact equations."""

import numpy as np
from scipy import fft

from multiscale.laws.bulk import J2, NeoHookean, Prony
from multiscale.micro.cell import Cell
from multiscale.micro.finite.body import Body, linear_body
from multiscale.micro.finite.large_strain import large_strain_body
from multiscale.micro.finite.obstacle import Obstacle
from multiscale.micro.finite.reference import Reference
from multiscale.micro.finite.scene import Scene
from multiscale.micro.graph_cell import surface_slopes
from multiscale.micro.lateral_fft import factorise_flat_cell
from multiscale.micro.mesh import GraphMesh, graded_planes
from multiscale.micro.operator import stiffness_operator

__all__ = ["make_scene"]

TANGENTIAL_WEIGHT = 0.3  # of the stiffness of a node against a force in the plane


def make_scene(cell: Cell) -> Scene:
    """Set up what solving a cell with friction or at large strain takes."""
    surface = cell.surface
    (nx, ny), spacing = surface.heights.shape, surface.spacing
    mesh = GraphMesh(surface, graded_planes(cell.depth, cell.layers, min(spacing)))
    soft = cell.nearly_incompressible
    inverse = factorise_flat_cell(
        (nx, ny), spacing, mesh.planes, *cell.layer_moduli, mean_dilatation=soft
    )
    slopes = surface_slopes(surface.heights, spacing) if soft else None
    symbols = inverse.surface_compliance
    own = float(fft.irfft2(symbols[0], s=(nx, ny))[0, 0])
    return Scene(
        _body(cell, mesh, soft),
        Reference(inverse, mesh.map_factor[1:], slopes),
        Obstacle(surface, cell.obstacle, follows=cell.bulk is not None),
        cell.friction_coefficient,
        (float(np.median(1.0 / symbols[5])), TANGENTIAL_WEIGHT / own),
    )


def _body(cell: Cell, mesh: GraphMesh, soft: bool) -> Body:
    nx, ny, layers = mesh.shape
    if cell.bulk is None:
        stiffness = stiffness_operator(mesh, *cell.moduli, mean_dilatation=soft)
        return linear_body(stiffness, (nx, layers, 3, ny))
    assert isinstance(cell.bulk, NeoHookean | J2 | Prony)
    return large_strain_body(mesh, cell.bulk, mean_dilatation=soft or isinstance(cell.bulk, J2))
