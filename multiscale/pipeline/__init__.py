"""What needs more than one layer: cases of every kind and their run."""

from multiscale.pipeline.case import case_of_image, load_case
from multiscale.pipeline.case_cells import make_cells
from multiscale.pipeline.planner import Plan, plan
from multiscale.pipeline.requirements import refuse_excess, requirements
from multiscale.pipeline.run import Results, run, run_macro
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stages.cells import run_micro
from multiscale.pipeline.sweep import Sweep, load_sweep, run_sweep
from multiscale.pipeline.tyre_settings import TyreCase

__all__ = [
    "Case",
    "Plan",
    "Results",
    "Sweep",
    "TyreCase",
    "case_of_image",
    "load_case",
    "load_sweep",
    "make_cells",
    "plan",
    "refuse_excess",
    "requirements",
    "run",
    "run_macro",
    "run_micro",
    "run_sweep",
]

__dir__ = __all__.copy
