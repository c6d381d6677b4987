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

# A semismooth Newton method solves geometry, material, contact and friction together. A step that
# fails is divided. A path that cannot be completed keeps its solved steps, with the reason in the
# attribute "ended".
#
# The answer of a plastic body depends on its increments. The approach changes by at most a fortieth
# of the range of heights in each increment, or half of it with Path(refinement=2). A case uses both
# for one realisation: a caution and the term "increments" of the error budget contain the remaining
# error (1 to 3 %). Friction is integrated backward in each increment, so the error of the work of
# friction is positive and proportional to the length of the increments.
#
# In bodies that flow or have a Poisson's ratio of .4 or more, the pressure of each element is a
# separate unknown. A cell with a slope of .5 and a Poisson's ratio of .4999 then takes as many
# iterations as a cell with .49: 8 Newton iterations per increment, and 9 linear iterations in each.

# With SecondBody the obstacle is the surface of a second deformable body with a separate law, and
# both bodies touch in the current configuration. slide_cell presses a cell and slides it at each
# of several pressures. Both bodies are periodic, so the distance may be many periods.
small = Surface(0.5e-6 * x[:, None] * x, (50e-6, 50e-6))
under = Surface(-small.heights, small.size)  # seen from below: summits meet at first
body = SecondBody(50e-6, 8, Elastic(210e9, 0.3))
pair = Cell(small, 50e-6, 8, 210e9, 0.3, obstacle=under, friction_coefficient=0.2, opposite=body)
slid = slide_cell(pair, (20e6, 80e6), 50e-6, steps=8)  # one period
print(slid["effective_friction"], slid["steady_friction"])

# Contact is enforced at the nodes of the first body, so its mesh should not be the coarser mesh. If
# the number of points of the second body does not divide the number of the first body, a uniform
# pressure is reproduced within a few per cent.
#
# workflows/ploughing.py slides hard on soft steel, which is ploughed, and draws friction against
# pressure and distance. An increment of sliding times the rms slope is by default as large as the
# largest increment of approach; ploughing is then 5 to 10 % too low.
#
# Agreement with GetFEM and CalculiX at large strain is in workflows/bench.md.
