"""Large structures that carry interface laws."""

from multiscale.macro.joint import Block, RoughJoint, assemble_joint, rough_joint
from multiscale.macro.monolithic import solve_interface

__all__ = ["Block", "RoughJoint", "assemble_joint", "rough_joint", "solve_interface"]
