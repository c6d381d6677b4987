"""What needs more than one layer: cases and their run, scenes and theirs."""

from multiscale.pipeline.case import find_case, load_case, load_tyre
from multiscale.pipeline.case_cells import make_cells
from multiscale.pipeline.case_response import run_micro
from multiscale.pipeline.concurrent import CellLaw
from multiscale.pipeline.end_to_end import EndToEndCase, end_to_end
from multiscale.pipeline.planner import Plan, plan
from multiscale.pipeline.requirements import requirements
from multiscale.pipeline.rough_scenes import RoughWave, TiltedJoint
from multiscale.pipeline.rough_structure import (
    RoughStructure,
    solve_concurrent,
    solve_direct,
    solve_sequential,
)
from multiscale.pipeline.run import Results, run
from multiscale.pipeline.scene_requirements import scene_requirements
from multiscale.pipeline.scene_settings import Scene
from multiscale.pipeline.scenes import homogenised_file, load_scene, run_scene
from multiscale.pipeline.settings import Case
from multiscale.pipeline.sweep import Sweep, load_sweep, name_point, run_sweep
from multiscale.pipeline.three_ways import three_ways
from multiscale.pipeline.tyre_settings import TyreCase

__all__ = [
    "Case",
    "CellLaw",
    "EndToEndCase",
    "Plan",
    "Results",
    "RoughStructure",
    "RoughWave",
    "Scene",
    "Sweep",
    "TiltedJoint",
    "TyreCase",
    "end_to_end",
    "find_case",
    "homogenised_file",
    "load_case",
    "load_scene",
    "load_sweep",
    "load_tyre",
    "make_cells",
    "name_point",
    "plan",
    "requirements",
    "run",
    "run_micro",
    "run_scene",
    "run_sweep",
    "scene_requirements",
    "solve_concurrent",
    "solve_direct",
    "solve_sequential",
    "three_ways",
]
