"""Studies of the chain: the same answer by a law, by cells at all points and fully resolved."""

from multiscale.studies.cell_law import CellLaw
from multiscale.studies.rough_structures import (
    RoughStructure,
    RoughWave,
    TiltedJoint,
    solve_concurrent,
    solve_direct,
    solve_sequential,
)

__all__ = [
    "CellLaw",
    "RoughStructure",
    "RoughWave",
    "TiltedJoint",
    "solve_concurrent",
    "solve_direct",
    "solve_sequential",
]

__dir__ = __all__.copy
