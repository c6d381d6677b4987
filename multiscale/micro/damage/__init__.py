"""Damage: plane sections of a representative volume, its stiffness, and fatigue."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
