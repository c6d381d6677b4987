"""Rigid grains in frictional contact: the far end of the way from a truss to a granulate."""

from multiscale.macro.granulate.arrangements import column, deposit, release, silo
from multiscale.macro.granulate.biaxial import biaxial_cell, biaxial_curve
from multiscale.macro.granulate.grain_bodies import CylinderWall, Grains, PlaneWall, Wall, box
from multiscale.macro.granulate.grain_cells import compact, shear_layer, shear_response
from multiscale.macro.granulate.grain_simulation import final_grains, simulate_grains
from multiscale.macro.granulate.loose_packing import draw_radii, place_loosely
from multiscale.macro.granulate.model import ContactLaw, Model, Solver
from multiscale.macro.granulate.observables import coordination, love_weber, network

__all__ = [
    "ContactLaw",
    "CylinderWall",
    "Grains",
    "Model",
    "PlaneWall",
    "Solver",
    "Wall",
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
    "place_loosely",
    "release",
    "shear_layer",
    "shear_response",
    "silo",
    "simulate_grains",
]
