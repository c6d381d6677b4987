"""Vibration of preloaded structures with joints: frequency and damping against amplitude."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
