"""Vibration of preloaded structures with joints: frequency and damping against amplitude."""

from multiscale.macro.vibration.backbone import Amplitudes, Backbone, follow_backbone, vibrate
from multiscale.macro.vibration.preloaded import Preloaded, press_structure, require_joined
from multiscale.macro.vibration.tangent_modes import TangentModes, structure_mass, tangent_modes

__all__ = [
    "Amplitudes",
    "Backbone",
    "Preloaded",
    "TangentModes",
    "follow_backbone",
    "press_structure",
    "require_joined",
    "structure_mass",
    "tangent_modes",
    "vibrate",
]

__dir__ = __all__.copy
