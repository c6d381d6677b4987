"""Elastic bodies with interfaces between their faces, and builders of them."""

from multiscale.lazy_names import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
