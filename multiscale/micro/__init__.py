"""Finite elements on a representative piece of a rough interface."""

from multiscale.io.surfaces import Surface
from multiscale.micro.topography import self_affine

__all__ = ["Surface", "self_affine"]
