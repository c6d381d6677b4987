"""The rough joint: two elastic blocks and the law between them."""

from multiscale.macro.joint.assembly import assemble_joint
from multiscale.macro.joint.cycled import cycled_joint, soften
from multiscale.macro.joint.geometry import Block, RoughJoint
from multiscale.macro.joint.solve import rough_joint

__all__ = ["Block", "RoughJoint", "assemble_joint", "cycled_joint", "rough_joint", "soften"]
