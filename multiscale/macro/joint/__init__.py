"""The rough joint: two elastic blocks and the law between them."""

from multiscale.macro.joint.even import press_joint
from multiscale.macro.joint.geometry import Block, RoughJoint, soften
from multiscale.macro.joint.joint_assembly import pressed_blocks
from multiscale.macro.joint.joint_solver import rough_joint
from multiscale.macro.joint.tread import (
    Footprint,
    TreadBlock,
    condense_tread,
    slide_tread,
    sliding_block,
)

__all__ = [
    "Block",
    "Footprint",
    "RoughJoint",
    "TreadBlock",
    "condense_tread",
    "press_joint",
    "pressed_blocks",
    "rough_joint",
    "slide_tread",
    "sliding_block",
    "soften",
]
