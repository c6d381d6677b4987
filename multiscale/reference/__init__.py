"""Closed forms that the solvers are checked against: plain functions of arrays."""

from multiscale.reference import full_contact, johnson, joint, layer, persson, westergaard

__all__ = ["full_contact", "johnson", "joint", "layer", "persson", "westergaard"]
