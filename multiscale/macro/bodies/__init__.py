"""Elastic bodies with interfaces between their faces, and builders of them."""

from multiscale.fe.lap_mesh import LapShape
from multiscale.macro.bodies.assembly import Assembly, Interface
from multiscale.macro.bodies.assembly_builders import lap_joint, stacked_blocks
from multiscale.macro.bodies.bolt import Bolt, BoltSection, shank_stiffness
from multiscale.macro.bodies.gap_map import GapMap
from multiscale.macro.bodies.platen import Platen

__all__ = [
    "Assembly",
    "Bolt",
    "BoltSection",
    "GapMap",
    "Interface",
    "LapShape",
    "Platen",
    "lap_joint",
    "shank_stiffness",
    "stacked_blocks",
]
