"""Vibration of preloaded structures with joints: frequency and damping against amplitude."""

from multiscale.macro.vibration.backbone import Amplitudes, Backbone, follow_backbone
from multiscale.macro.vibration.preloaded import Preloaded, press_structure
from multiscale.macro.vibration.tangent_modes import TangentModes, structure_mass, tangent_modes

__all__ = [
    "Amplitudes",
    "Backbone",
    "Preloaded",
    "TangentModes",
    "follow_backbone",
    "press_structure",
    "structure_mass",
    "tangent_modes",
]

__dir__ = __all__.copy
