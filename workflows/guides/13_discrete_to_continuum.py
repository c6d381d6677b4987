"""From discrete to continuum: many bodies as a law, and where that holds.

Question: which friction and height has a layer of grains, and how does a joint take them?

    python workflows/guides/13_discrete_to_continuum.py
"""

import numpy as np

from multiscale.macro import granulate
from multiscale.pipeline import load_case, requirements

# Grains as a third body. A layer of rigid grains between two plates is a representative volume: its
# traction and jump are the averages (2)-(3) of the source, with the forces of the grains on the
# plate over its area in place of tractions. The grains obey (6) and (9) of the source.
radii, law = np.full(16, 0.005), granulate.ContactLaw(friction=0.3)
options = {"n_realisations": 1, "n_steps": 40}  # as many as they take to slide by 20 diameters
response = granulate.shear_response(radii, (0.06, 0.06), [1e3], [0.05], law, **options)
print(response["mean_gap"].values, response["traction"].values)  # m and Pa, normal first

# Rigid grains have no scale of time: height H and friction depend on the inertial number
# I = (v / H) d sqrt(rho / p) only, with diameter d, density rho, pressure p and speed v. A law of
# several pressures at one speed holds at every speed v, at pressures in proportion to v squared.
case = load_case("third_body")  # [grains] and [third_body]: cells, their law, and a joint with it
print(requirements(case).built["cells of grains"])

# The joint takes the law of its case, or of another by law = "grains.toml", at the speed of
# [interface]. Where most load is at pressures outside the cells, answers are unknown. Cells that
# do not slide by their distance within 20000 steps are refused, with a speed that suffices.
#
# How well does such a law hold? Six cells of 100 spheres with a friction of 0.5, at inertial
# numbers from .05 to .3, give a friction of .241 ± .021 and .214 ± .015 and a height of 37.1 and
# 36.7 mm (± 1.2 mm) at two pressures between the fitted ones (95 %). Six other cells that are
# sheared at these pressures have .232 ± .019 and .206 ± .013, 36.7 and 36.1 mm. Three cells of
# twice the area have a friction of .234 where the small cells have .214. Plates with a friction of
# 0.1 slide on the grains at that friction: the plates are a part of the law. Most of the scatter of
# the height is the volume of the grains, 3 % between these cells, and 0.9 % remain at equal volume,
# which [third_body] gives to all of its cells.
