"""Elastic continua."""

from multiscale.fe.mesh_file import load_mesh
from multiscale.macro.continuum.body import Body
from multiscale.macro.continuum.contact_steps import ContactStep, SurfaceState, solve_contact
from multiscale.macro.continuum.finite_assembly import FiniteAssembly
from multiscale.macro.continuum.interface import Contact
from multiscale.macro.continuum.rigid_obstacle import (
    RigidCylinder,
    RigidGraph,
    RigidObstacle,
    RigidPlane,
    RigidSphere,
)

__all__ = [
    "Body",
    "Contact",
    "ContactStep",
    "FiniteAssembly",
    "RigidCylinder",
    "RigidGraph",
    "RigidObstacle",
    "RigidPlane",
    "RigidSphere",
    "SurfaceState",
    "load_mesh",
    "solve_contact",
]
