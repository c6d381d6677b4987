"""Elastic continua."""

from multiscale.fe.mesh_file import load_mesh
from multiscale.macro.continuum.body import Body
from multiscale.macro.continuum.contact_steps import ContactStep, solve_contact
from multiscale.macro.continuum.crack_band import follow_crack_band
from multiscale.macro.continuum.finite_assembly import FiniteAssembly
from multiscale.macro.continuum.interface import Contact
from multiscale.macro.continuum.rigid_obstacle import (
    RigidCylinder,
    RigidGraph,
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
    "RigidPlane",
    "RigidSphere",
    "follow_crack_band",
    "load_mesh",
    "solve_contact",
]
