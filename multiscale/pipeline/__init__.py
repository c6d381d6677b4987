"""What needs more than one layer: cases, and the run from surface to joint."""

from multiscale.pipeline.case import find_case, load_case
from multiscale.pipeline.cells import make_cells
from multiscale.pipeline.requirements import requirements
from multiscale.pipeline.run import Results, run, run_micro
from multiscale.pipeline.settings import Case

__all__ = [
    "Case",
    "Results",
    "find_case",
    "load_case",
    "make_cells",
    "requirements",
    "run",
    "run_micro",
]
