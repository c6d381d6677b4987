"""Studies of the chain itself: one answer with a law, with cells everywhere and fully resolved."""

from multiscale.studies.concurrent import CellLaw
from multiscale.studies.end_to_end import EndToEndCase, end_to_end
from multiscale.studies.rough_structure import (
    RoughStructure,
    solve_concurrent,
    solve_direct,
    solve_sequential,
)
from multiscale.studies.rough_wave import RoughWave
from multiscale.studies.three_ways import three_ways
from multiscale.studies.tilted_joint import TiltedJoint

__all__ = [
    "CellLaw",
    "EndToEndCase",
    "RoughStructure",
    "RoughWave",
    "TiltedJoint",
    "end_to_end",
    "solve_concurrent",
    "solve_direct",
    "solve_sequential",
    "three_ways",
]

__dir__ = __all__.copy
