"""Dynamics of rigid grains in frictional contact."""

from multiscale.macro.granulate.arrangements import column, deposit, release, silo
from multiscale.macro.granulate.biaxial import biaxial_cell, biaxial_curve
from multiscale.macro.granulate.grain_bodies import CylinderWall, Grains, PlaneWall, box
from multiscale.macro.granulate.grain_cells import compact, shear_layer, shear_response
from multiscale.macro.granulate.grain_simulation import final_grains, simulate_grains
from multiscale.macro.granulate.loose_packing import draw_radii
from multiscale.macro.granulate.model import ContactLaw, Model, Solver
from multiscale.macro.granulate.observables import coordination, love_weber, network

__all__ = [
    "ContactLaw",
    "CylinderWall",
    "Grains",
    "Model",
    "PlaneWall",
    "Solver",
    "biaxial_cell",
    "biaxial_curve",
    "box",
    "column",
    "compact",
    "coordination",
    "deposit",
    "draw_radii",
    "final_grains",
    "love_weber",
    "network",
    "release",
    "shear_layer",
    "shear_response",
    "silo",
    "simulate_grains",
]

__dir__ = __all__.copy
