"""Damage: plane sections of a representative volume, its stiffness, and fatigue."""

from multiscale.io.images import VoxelImage
from multiscale.micro.damage.bodies import (
    Cracks,
    Cylinders,
    Ellipsoids,
    cylinders,
    ellipsoids,
    penny_cracks,
    spheres,
)
from multiscale.micro.damage.cavities import Cavities, crack_density_tensor, voxelise
from multiscale.micro.damage.packing import boolean_spheres, lattice, random_spheres
from multiscale.micro.damage.sections import max_damage, plane_damage

__all__ = [
    "Cavities",
    "Cracks",
    "Cylinders",
    "Ellipsoids",
    "VoxelImage",
    "boolean_spheres",
    "crack_density_tensor",
    "cylinders",
    "ellipsoids",
    "lattice",
    "max_damage",
    "penny_cracks",
    "plane_damage",
    "random_spheres",
    "spheres",
    "voxelise",
]
