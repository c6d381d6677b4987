"""Substructures and interfaces, and the solvers for them: LATIN and Newton-Schur."""

from multiscale.macro.substructures.bodies import Joint, cut_bodies, split_boxes
from multiscale.macro.substructures.cut import bisect, cut_links, split_grid
from multiscale.macro.substructures.homogenised import homogenise
from multiscale.macro.substructures.motion import simulate_latin
from multiscale.macro.substructures.parallel import Alone, Ranks, Team, world
from multiscale.macro.substructures.problem import Interface, Links, Problem, Substructure
from multiscale.macro.substructures.schur import solve_schur
from multiscale.macro.substructures.solve import solve_latin

__all__ = [
    "Alone",
    "Interface",
    "Joint",
    "Links",
    "Problem",
    "Ranks",
    "Substructure",
    "Team",
    "bisect",
    "cut_bodies",
    "cut_links",
    "homogenise",
    "simulate_latin",
    "solve_latin",
    "solve_schur",
    "split_boxes",
    "split_grid",
    "world",
]
