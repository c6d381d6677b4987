"""What needs more than one layer: cases and their run, scenes and theirs."""

from multiscale.pipeline.case import find_case, load_case
from multiscale.pipeline.cells import make_cells
from multiscale.pipeline.concurrent import CellLaw
from multiscale.pipeline.requirements import requirements
from multiscale.pipeline.run import Results, run, run_micro
from multiscale.pipeline.scene_settings import Scene
from multiscale.pipeline.scenes import load_scene, run_scene
from multiscale.pipeline.settings import Case

__all__ = [
    "Case",
    "CellLaw",
    "Results",
    "Scene",
    "find_case",
    "load_case",
    "load_scene",
    "make_cells",
    "requirements",
    "run",
    "run_micro",
    "run_scene",
]
