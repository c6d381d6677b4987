"""Rough contact at the micro scale, condensed into laws for large non-smooth structures."""

__version__ = "0.1.0"
