"""Finite elements on a representative piece of a rough interface."""

from multiscale.laws import wlf_shift
from multiscale.laws.bulk.moduli import contact_modulus
from multiscale.micro.cell import (
    CellSides,
    FiniteCell,
    FlatCell,
    GraphCell,
    MeshCell,
    SecondBody,
)
from multiscale.micro.cell_maker import Cell
from multiscale.micro.cell_solver import solve_cell
from multiscale.micro.coating import Coating
from multiscale.micro.ensemble import run_ensemble
from multiscale.micro.mesh.file_cell import cell_from_file
from multiscale.micro.mesh.graph_elements import ElementKind, graph_mesh_cell
from multiscale.micro.path import Path
from multiscale.micro.shear import shear_path
from multiscale.micro.slide import slide_cell
from multiscale.micro.viscoelastic_sliding import RelaxingSolid, solve_sliding
from multiscale.surfaces import self_affine
from multiscale.surfaces.surface import Surface

__all__ = [
    "Cell",
    "CellSides",
    "Coating",
    "ElementKind",
    "FiniteCell",
    "FlatCell",
    "GraphCell",
    "MeshCell",
    "Path",
    "RelaxingSolid",
    "SecondBody",
    "Surface",
    "cell_from_file",
    "contact_modulus",
    "graph_mesh_cell",
    "run_ensemble",
    "self_affine",
    "shear_path",
    "slide_cell",
    "solve_cell",
    "solve_sliding",
    "wlf_shift",
]

__dir__ = __all__.copy
