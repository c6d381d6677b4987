"""The rough joint: two elastic blocks and the law between them."""

from multiscale.macro.joint.cycled import cycled_joint, soften
from multiscale.macro.joint.even import press_joint
from multiscale.macro.joint.geometry import Block, RoughJoint
from multiscale.macro.joint.joint_assembly import assemble_joint
from multiscale.macro.joint.joint_solver import rough_joint
from multiscale.macro.joint.tread import Footprint, TreadBlock, condense_tread, slide_tread

__all__ = [
    "Block",
    "Footprint",
    "RoughJoint",
    "TreadBlock",
    "assemble_joint",
    "condense_tread",
    "cycled_joint",
    "press_joint",
    "rough_joint",
    "slide_tread",
    "soften",
]
