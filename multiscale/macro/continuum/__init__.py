"""Elastic continua."""

from multiscale.macro.continuum.blocks import (
    box_mesh,
    displacement_basis,
    face_operator,
    face_unknowns,
    stiffness_matrix,
)

__all__ = ["box_mesh", "displacement_basis", "face_operator", "face_unknowns", "stiffness_matrix"]
