"""Structures of nodes and links: trusses, frames, tensegrities and cable nets."""

from multiscale.macro.discrete.compatibility import compatibility
from multiscale.macro.discrete.link_structures import cable_net, truss
from multiscale.macro.discrete.link_system import LinkSystem
from multiscale.macro.discrete.link_tables import system_from_mesh, system_from_table
from multiscale.macro.discrete.mechanism import prestress_by_itself, self_stress
from multiscale.macro.discrete.statics import solve_static
from multiscale.macro.discrete.tensegrity import quadruplex_module, tensegrity_grid

__all__ = [
    "LinkSystem",
    "cable_net",
    "compatibility",
    "prestress_by_itself",
    "quadruplex_module",
    "self_stress",
    "solve_static",
    "system_from_mesh",
    "system_from_table",
    "tensegrity_grid",
    "truss",
]
