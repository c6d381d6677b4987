"""What needs more than one layer: cases and their run, scenes and theirs."""

from multiscale.pipeline.case import find_case, load_case
from multiscale.pipeline.cells import make_cells
from multiscale.pipeline.requirements import requirements
from multiscale.pipeline.run import Results, run, run_micro
from multiscale.pipeline.scene_settings import Scene
from multiscale.pipeline.scenes import homogenised_file, load_scene, run_scene
from multiscale.pipeline.settings import Case
from multiscale.pipeline.sweep import Sweep, load_sweep, run_sweep

__all__ = [
    "Case",
    "Results",
    "Scene",
    "Sweep",
    "find_case",
    "homogenised_file",
    "load_case",
    "load_scene",
    "load_sweep",
    "make_cells",
    "requirements",
    "run",
    "run_micro",
    "run_scene",
    "run_sweep",
]
