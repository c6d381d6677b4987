"""Large strain, plasticity and friction in a cell, and two bodies that slide over each other.

Question: how much of the contact slips, and how much of the metal flows, when a bump is pressed,
sheared and unloaded?

    python workflows/guides/05_large_strain.py
"""

import numpy as np

from multiscale.laws.bulk import J2, Elastic
from multiscale.micro import Cell, Path, SecondBody, Surface, slide_cell, solve_cell

# A cell takes a law at large strain (NeoHookean; J2 in logarithmic strain with linear and
# saturating hardening; Prony), and Coulomb friction against a flat or rough rigid obstacle that
# slides.
x = np.cos(2 * np.pi * np.arange(16) / 16)
bumps = Surface(1e-6 * x[:, None] * x, (50e-6, 50e-6))  # m
steel = J2(210e9, 0.3, yield_stress=1.1e9, hardening_modulus=2e9)
cell = Cell(bumps, 50e-6, 8, 210e9, 0.3, bulk=steel, friction_coefficient=0.2)
path = Path(
    pressure=(0.5e9, 0.5e9, 0.1e9),  # press, shear, unload
    slide=((0.0, 0.0), (0.2e-6, 0.0), (0.2e-6, 0.0)),
)
pressed = solve_cell(cell, path, tolerance=1e-6)
print(pressed["traction"], pressed["slip_fraction"], pressed["flowing_fraction"])

# One semismooth Newton iteration solves geometry, material, contact and friction together. A step
# of a path is cut where it fails. A path that cannot be completed keeps its solved steps and gives
# the reason in the attribute "ended".
#
# The answer of a plastic body depends on its increments. The approach moves by at most a fortieth
# of the range of heights in each increment; Path(refinement=2) halves that. A case does so for one
# realisation: a caution and the term "increments" of the error budget state the remaining error
# (1 to 3 %). Friction is integrated backward in each increment, so that the work of friction is too
# large in proportion to the length of the increments.
#
# In bodies that flow or whose Poisson's ratio is .4 and more, the pressure of each element is an
# unknown of its own. So a cell with a slope of .5 and a Poisson's ratio of .4999 takes as many
# iterations as a cell with .49: 8 Newton iterations per increment, and 9 linear iterations in each.

# With SecondBody the obstacle is a second deformable body behind its underside, with a law of its
# own, and both bodies meet in the current configuration. slide_cell presses a cell and slides it at
# each of several pressures. Both bodies are periodic, so that the way may be many periods long.
small = Surface(0.5e-6 * x[:, None] * x, (50e-6, 50e-6))
under = Surface(-small.heights, small.size)  # seen from below: summits meet at first
body = SecondBody(50e-6, 8, Elastic(210e9, 0.3))
pair = Cell(small, 50e-6, 8, 210e9, 0.3, obstacle=under, friction_coefficient=0.2, opposite=body)
slid = slide_cell(pair, (20e6, 80e6), 50e-6, steps=8)  # one period
print(slid["effective_friction"], slid["steady_friction"])

# The nodes of the first body carry the contact, so that the first body should not be the coarser
# one: where the points of the second body do not divide the points of the first body, a uniform
# pressure is reproduced within a few per cent.
#
# Metal that flows is ploughed: workflows/ploughing.py slides hard on soft steel and draws friction
# against pressure and distance. The increments count there too: sliding up the rms slope closes by
# default as much in each increment as the approach may, and ploughing comes out 5 to 10 % low.
#
# Agreement with GetFEM and CalculiX at large strain is in workflows/bench.md.
