"""From discrete to continuum: laws of many bodies, and their limits.

Question: which friction and height does a layer of grains have, how does a joint use them, and when
is a grid of cables and bars equivalent to a plate?

    python workflows/guides/13_discrete_to_continuum.py
"""

import numpy as np

from multiscale.macro import granulate, solve_static, tensegrity_grid
from multiscale.macro.links import EquivalentPlate, compare_with_links, plate_cell, solve_plate
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

# The joint takes the law of its case, or of another case by law = "grains.toml", at the speed of
# [interface]. If most load is at pressures outside the cells, answers are unknown. Cells that
# do not slide by their distance within 20000 steps are refused, with a sufficient speed.
#
# The height h (1 + sqrt(p_c / p)), because the solid fraction falls linearly with I, is fitted to
# every cell: the stiffness of a law of six cells has an interval of 16 to 18 %, a law of free form
# has 165 to 240 %, and five cells of 60 spheres have 39 %. Misfits beyond the scatter of the cells
# widen the interval.
#
# How accurate is such a law? Six cells of 100 spheres with a friction of 0.5, at inertial
# numbers from .05 to .3, give a friction of .241 ± .021 and .214 ± .015 and a height of 37.1 and
# 36.7 mm (± 1.2 mm) at two pressures between the fitted pressures (95 %). Six other cells that are
# sheared at these pressures have .232 ± .019 and .206 ± .013, 36.7 and 36.1 mm. Three cells of
# twice the area have a friction of .234 where the small cells have .214. Plates with a friction of
# 0.1 slide on the grains with this friction: the law depends on the plates. Most of the scatter of
# the height comes from the volume of the grains, 3 % between these cells; 0.9 % remain at equal
# volume, which all cells of [third_body] have.

# A periodic cell of cables and bars is the cell of a plate. Its eight strains are extensions and
# shear in the plane, curvatures and twist, and transverse shears; the nodes of the cell relax
# periodically, and links go slack. Membrane forces, moments and transverse forces are averages of
# link forces over the area of the cell, as (1)-(3) of the source average over an element:
cell = plate_cell(tensegrity_grid(1, prestress=160.0), (1.0, 1.0))
print(cell.stiffness.diagonal())  # N/m, but N m for the curvatures

# The plate has the loads, masses and supports of the links, and is compared with them:
grid, factors = tensegrity_grid(4, prestress=160.0), [0.1, 1.0]
plate = EquivalentPlate(grid, cell, elements=(4, 4))
rest = compare_with_links(solve_plate(plate, factors), solve_static(grid, factors))
print(rest["plate_error"].values)  # root mean square over the nodes, relative
#
# When is a discrete structure a continuum? With 4, 8, 16 and 32 modules across, taut, displacements
# have errors of 20, 6.2, 2.7 and 1.4 %, first frequencies of 1.7, 4.2, .8 and .5 %
# (workflows/figures/equivalent_plate.png): with 16 modules or more. With every eighth cable slack
# they are 41, 6.3, 4.8, 3.4 % and 39, 14, 2.8, .03 %, as zones of slack cables are a few modules
# wide. Membrane compression between the fixed edges then lowers the first frequency by a third. The
# scene `equivalent_plate` reports plate and links at every load factor.
