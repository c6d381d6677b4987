"""Elastic bodies for the contact loop: the graph cell, and any scikit-fem mesh and element."""

from dataclasses import dataclass

import numpy as np
from scipy import fft, sparse

from multiscale.errors import CaseError
from multiscale.io.surfaces import Surface
from multiscale.linalg import factorise
from multiscale.micro.cell import Cell, MeshCell, lame_parameters
from multiscale.micro.contact import ElasticBody
from multiscale.micro.mesh import GraphMesh, graded_planes

__all__ = ["ContactProblem", "assemble_elasticity", "assemble_graph_cell", "assemble_mesh_cell"]


@dataclass(frozen=True)
class ContactProblem:
    """A body with the geometry of its contact nodes.

    Attributes
    ----------
    body : ElasticBody
    normal : ndarray
        The obstacle's unit normals into the obstacle, components along axis 1: shape (nx, 3, ny)
        for a graph cell, (nodes, 3) otherwise.
    surface_height, obstacle_height : ndarray
        Before deformation and at first touch, m.
    weight : ndarray
        Nominal area of each contact node, m2; their sum is the nominal area.
    """

    body: ElasticBody
    normal: np.ndarray
    surface_height: np.ndarray
    obstacle_height: np.ndarray
    weight: np.ndarray

    @property
    def nominal_area(self) -> float:
        """Area of the cell's projection on its mean plane, m2."""
        return float(np.sum(self.weight))

    @property
    def closing(self) -> np.ndarray:
        """Share of the approach that closes the gap, 1."""
        return np.asarray(self.normal[:, 2])

    @property
    def gap(self) -> np.ndarray:
        """Distance along the obstacle's normal at first touch, m."""
        return np.asarray((self.obstacle_height - self.surface_height) * self.closing)

    def touching(self) -> "ContactProblem":
        """Return the problem with the obstacle lowered or raised to its first touch."""


def _obstacle_normal(slope_x: np.ndarray, slope_y: np.ndarray) -> np.ndarray:
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=1)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))
