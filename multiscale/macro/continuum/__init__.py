"""Elastic continua."""

from multiscale.macro.continuum.body import Body
from multiscale.macro.continuum.contact import ContactStep, SurfaceState, solve_contact
from multiscale.macro.continuum.interface import Contact
from multiscale.macro.continuum.mesh_file import load_mesh
from multiscale.macro.continuum.obstacle import Cylinder, Graph, Obstacle, Plane, Sphere
from multiscale.macro.continuum.system import ContactProblem

__all__ = [
    "Body",
    "Contact",
    "ContactProblem",
    "ContactStep",
    "Cylinder",
    "Graph",
    "Obstacle",
    "Plane",
    "Sphere",
    "SurfaceState",
    "load_mesh",
    "solve_contact",
]
