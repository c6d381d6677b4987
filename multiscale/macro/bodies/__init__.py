"""Elastic bodies with interfaces between their faces, and builders of them."""

from multiscale.fe.lap_mesh import LapShape
from multiscale.macro.bodies.assembly import Assembly, Interface, Platen
from multiscale.macro.bodies.assembly_builders import lap_joint, stacked_blocks

__all__ = ["Assembly", "Interface", "LapShape", "Platen", "lap_joint", "stacked_blocks"]
