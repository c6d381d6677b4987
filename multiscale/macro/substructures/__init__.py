"""Substructures and interfaces, and the micro-macro solver for them."""

from multiscale.macro.substructures.assembled import Assembled, assemble
from multiscale.macro.substructures.bodies import Joint, cut_bodies, split_boxes
from multiscale.macro.substructures.cut import bisect, cut_links, split_grid
from multiscale.macro.substructures.lap import LapShape
from multiscale.macro.substructures.loading import JointLoading, load_joint
from multiscale.macro.substructures.parallel import Alone, Ranks, Team
from multiscale.macro.substructures.problem import Interface, Links, Problem, Substructure
from multiscale.macro.substructures.rough import RoughAssembly, lap_joint, stacked_blocks
from multiscale.macro.substructures.solve import solve_latin

__all__ = [
    "Alone",
    "Assembled",
    "Interface",
    "Joint",
    "JointLoading",
    "LapShape",
    "Links",
    "Problem",
    "Ranks",
    "RoughAssembly",
    "Substructure",
    "Team",
    "assemble",
    "bisect",
    "cut_bodies",
    "cut_links",
    "lap_joint",
    "load_joint",
    "solve_latin",
    "split_boxes",
    "split_grid",
    "stacked_blocks",
]
