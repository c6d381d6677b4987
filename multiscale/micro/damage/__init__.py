"""Damage: plane sections of a representative volume, its stiffness, and fatigue."""

from multiscale.io.images import VoxelImage
from multiscale.laws.bulk.moduli import (
    youngs_modulus_along,
)
from multiscale.micro.damage.cavities import Cavities, voxelise
from multiscale.micro.damage.cavity_packing import boolean_spheres, random_spheres
from multiscale.micro.damage.crack_growth import (
    Microcracks,
    grow_microcracks,
)
from multiscale.micro.damage.fatigue import two_scale_fatigue, woehler_curve
from multiscale.micro.damage.fatigue_material import FatigueMaterial, StressBlock
from multiscale.micro.damage.local_fatigue import local_fatigue
from multiscale.micro.damage.mesh_stiffness import mesh_stiffness
from multiscale.micro.damage.recipe import Recipe
from multiscale.micro.damage.rve import effective_stiffness
from multiscale.micro.damage.sections import max_damage, plane_damage
from multiscale.micro.damage.shapes import (
    Cracks,
    Cylinders,
    Ellipsoids,
    cylinders,
    ellipsoids,
    penny_cracks,
    spheres,
)
from multiscale.micro.damage.volume_growth import grow_volumes, softening_of

__all__ = [
    "Cavities",
    "Cracks",
    "Cylinders",
    "Ellipsoids",
    "FatigueMaterial",
    "Microcracks",
    "Recipe",
    "StressBlock",
    "VoxelImage",
    "boolean_spheres",
    "cylinders",
    "effective_stiffness",
    "ellipsoids",
    "grow_microcracks",
    "grow_volumes",
    "local_fatigue",
    "max_damage",
    "mesh_stiffness",
    "penny_cracks",
    "plane_damage",
    "random_spheres",
    "softening_of",
    "spheres",
    "two_scale_fatigue",
    "voxelise",
    "woehler_curve",
    "youngs_modulus_along",
]

__dir__ = __all__.copy
