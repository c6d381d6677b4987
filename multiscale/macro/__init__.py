"""Large structures that carry interface laws."""

from multiscale.macro.continuum import (
    Body,
    Contact,
    ContactProblem,
    ContactStep,
    Cylinder,
    Graph,
    Plane,
    Sphere,
    load_mesh,
    solve_contact,
)
from multiscale.macro.joint import Block, RoughJoint, assemble_joint, rough_joint
from multiscale.macro.monolithic import solve_interface

__all__ = [
    "Block",
    "Body",
    "Contact",
    "ContactProblem",
    "ContactStep",
    "Cylinder",
    "Graph",
    "Plane",
    "RoughJoint",
    "Sphere",
    "assemble_joint",
    "load_mesh",
    "rough_joint",
    "solve_contact",
    "solve_interface",
]
