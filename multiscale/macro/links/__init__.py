"""Structures of nodes and links: trusses, frames, tensegrities and cable nets."""

from multiscale.lazy_names import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
