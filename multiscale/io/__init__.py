"""Readers and writers: the only place where files are opened."""

from multiscale.io.surfaces import Surface, read_surface

__all__ = ["Surface", "read_surface"]
