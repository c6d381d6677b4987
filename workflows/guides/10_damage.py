"""Damage: cavities and cracks in a volume, its stiffness, and its life in fatigue.

Question: how much do 10 % of pores reduce the area of a section, the stiffness and the life?

    python workflows/guides/10_damage.py
"""

import numpy as np

from multiscale.micro.damage import (
    FatigueMaterial,
    Microcracks,
    Recipe,
    effective_stiffness,
    grow_microcracks,
    max_damage,
    random_spheres,
    softening_of,
    two_scale_fatigue,
    voxelise,
    youngs_modulus_along,
)

# Damage of plane sections of a representative volume, eq (1), has a closed form for cavities and
# flat cracks; read_images("stack.tif") reads a voxel image, with the extra "images". The largest
# damage over the planes of a random medium depends on the size of the volume: it falls towards the
# porosity as the volume grows. The dataset has the size, and mean and quantiles of the damage.
pores = random_spheres((1e-3, 1e-3, 1e-3), 1.5e-4, porosity=0.1, seed=1)
sections = max_damage(pores, level=1, sections=17)
print(float(sections["maximum_damage"]), sections["worst_normal"].values)

# The damage of a section is geometric. The stiffness comes from finite elements on the voxels of an
# image with periodic conditions, and is not (1 - damage) times the stiffness of the matrix. A flat
# crack is one voxel thick, so its error is proportional to the voxel size, and bounded by the
# change from half the resolution. With a crack through the whole section the stiffness is zero, and
# the solution reports it. In a case, [rve] does this for several volumes and for bodies.
stiffness = effective_stiffness(voxelise(pores, 24), 71e9, 0.33).unwrap()  # 6 x 6, Pa
print(youngs_modulus_along(stiffness, np.eye(3)) / 71e9)

# Fatigue. Below the yield stress a weak micro-inclusion flows and is damaged until it cracks. The
# history of stress is uniaxial, or of shape (points, 6).
alloy = FatigueMaterial(71e9, 0.33, fatigue_limit=70e6, damage_strength=0.2e6, hardening=5e9)
life = two_scale_fatigue(np.array([90e6, -90e6]), alloy)
print(float(life["cycles_to_rupture"]))

# Quasi-brittle: cracks of a cube of concrete grow where K_I reaches K_Ic, and the volume softens.
# follow_crack_band of multiscale.macro.continuum uses its softening law for bodies. In a case,
# [growth] does both for several volumes, with intervals.
cracked = Recipe(crack_density=0.066, crack_radius=5.3e-3, crack_spread=0.5).draw((0.1,) * 3, 0)
concrete = Microcracks.of(cracked, youngs_modulus=30e9, poissons_ratio=0.2, toughness=0.5e6)
law = softening_of(grow_microcracks(concrete, 1e6 * np.eye(6)[2], through=True), 1e6)
print(law.strength, law.fracture_energy)  # Pa, J/m2

# workflows/damage_to_joint.py computes stiffness and life of a joint. [fatigue] in a case computes
# the damage of every element of a body under the cycles of its structure.
