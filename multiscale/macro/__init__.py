"""Large structures that carry interface laws."""

from multiscale.macro import granulate
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
from multiscale.macro.discrete import (
    LinkSystem,
    cable_net,
    critical_factor,
    mechanism_modes,
    quadruplex_module,
    self_stress,
    solve_static,
    system_from_mesh,
    system_from_table,
    tensegrity_grid,
    truss,
)
from multiscale.macro.dynamics import simulate
from multiscale.macro.joint import (
    Block,
    RoughJoint,
    assemble_joint,
    cycled_joint,
    rough_joint,
    soften,
)
from multiscale.macro.monolithic import solve_interface
from multiscale.macro.substructures import (
    cut_bodies,
    cut_links,
    homogenise,
    solve_latin,
    solve_schur,
)

__all__ = [
    "Block",
    "Body",
    "Contact",
    "ContactProblem",
    "ContactStep",
    "Cylinder",
    "Graph",
    "LinkSystem",
    "Plane",
    "RoughJoint",
    "Sphere",
    "assemble_joint",
    "cable_net",
    "critical_factor",
    "cut_bodies",
    "cut_links",
    "cycled_joint",
    "granulate",
    "homogenise",
    "load_mesh",
    "mechanism_modes",
    "quadruplex_module",
    "rough_joint",
    "self_stress",
    "simulate",
    "soften",
    "solve_contact",
    "solve_interface",
    "solve_latin",
    "solve_schur",
    "solve_static",
    "system_from_mesh",
    "system_from_table",
    "tensegrity_grid",
    "truss",
]
