"""Inequality and friction as mathematics: arrays in, arrays out."""

from multiscale.nonsmooth.coulomb import verify_friction
from multiscale.nonsmooth.friction import solve_friction
from multiscale.nonsmooth.lcp import solve_lcp
from multiscale.nonsmooth.lcp_problem import verify_lcp

__all__ = ["solve_friction", "solve_lcp", "verify_friction", "verify_lcp"]

__dir__ = __all__.copy
