"""Substructures and interfaces, and the solvers for them: LATIN and Newton-Schur."""

from multiscale.macro.substructures.assembly_methods import (
    AssembledNewton,
    LatinMethod,
    NewtonSchur,
    solve_assembly,
)
from multiscale.macro.substructures.bolted_path import Method
from multiscale.macro.substructures.cut import bisect, cut_links, split_grid
from multiscale.macro.substructures.cut_bodies import cut_assembly, split_boxes
from multiscale.macro.substructures.cut_motion import simulate_latin
from multiscale.macro.substructures.followed_path import condense_assembly
from multiscale.macro.substructures.homogenised import homogenise
from multiscale.macro.substructures.joint_fields import (
    add_body_fields,
    element_corners,
    element_stress,
    list_elements,
)
from multiscale.macro.substructures.joint_loading import (
    FEW_STEPS,
    FollowedJoint,
    JointLoading,
    follow_joint,
    load_joint,
    measure_joint,
)
from multiscale.macro.substructures.latin_solver import solve_latin
from multiscale.macro.substructures.load_path import LoadPath, follow_cut_loads, require_held
from multiscale.macro.substructures.method_choice import JointSize, choose_method
from multiscale.macro.substructures.parallel import Alone, ProcessGroup, Ranks, world
from multiscale.macro.substructures.problem import CutInterface, CutProblem, Links, Substructure
from multiscale.macro.substructures.schur import solve_schur
from multiscale.macro.substructures.whole_solver import solve_whole
from multiscale.macro.substructures.whole_structure import Assembled, assemble

__all__ = [
    "FEW_STEPS",
    "Alone",
    "Assembled",
    "AssembledNewton",
    "CutInterface",
    "CutProblem",
    "FollowedJoint",
    "JointLoading",
    "JointSize",
    "LatinMethod",
    "Links",
    "LoadPath",
    "Method",
    "NewtonSchur",
    "ProcessGroup",
    "Ranks",
    "Substructure",
    "add_body_fields",
    "assemble",
    "bisect",
    "choose_method",
    "condense_assembly",
    "cut_assembly",
    "cut_links",
    "element_corners",
    "element_stress",
    "follow_cut_loads",
    "follow_joint",
    "homogenise",
    "list_elements",
    "load_joint",
    "measure_joint",
    "require_held",
    "simulate_latin",
    "solve_assembly",
    "solve_latin",
    "solve_schur",
    "solve_whole",
    "split_boxes",
    "split_grid",
    "world",
]

__dir__ = __all__.copy
