"""Substructures and interfaces, and the solvers for them: LATIN and Newton-Schur."""

from multiscale.fe.lap_mesh import LapShape
from multiscale.macro.substructures.cut import bisect, cut_links, split_grid
from multiscale.macro.substructures.cut_bodies import Joint, cut_bodies, split_boxes
from multiscale.macro.substructures.cut_motion import simulate_latin
from multiscale.macro.substructures.homogenised import homogenise
from multiscale.macro.substructures.joint_fields import add_body_fields
from multiscale.macro.substructures.latin_solver import solve_latin
from multiscale.macro.substructures.loading import JointLoading, load_joint
from multiscale.macro.substructures.parallel import Alone, Ranks, Team, world
from multiscale.macro.substructures.problem import CutInterface, CutProblem, Links, Substructure
from multiscale.macro.substructures.rough import RoughAssembly, lap_joint, stacked_blocks
from multiscale.macro.substructures.schur import solve_schur
from multiscale.macro.substructures.whole_structure import Assembled, assemble

__all__ = [
    "Alone",
    "Assembled",
    "CutInterface",
    "CutProblem",
    "Joint",
    "JointLoading",
    "LapShape",
    "Links",
    "Ranks",
    "RoughAssembly",
    "Substructure",
    "Team",
    "add_body_fields",
    "assemble",
    "bisect",
    "cut_bodies",
    "cut_links",
    "homogenise",
    "lap_joint",
    "load_joint",
    "simulate_latin",
    "solve_latin",
    "solve_schur",
    "split_boxes",
    "split_grid",
    "stacked_blocks",
    "world",
]
