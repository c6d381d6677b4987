"""Studies of the chain itself: one answer with a law, with cells everywhere and fully resolved."""

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
