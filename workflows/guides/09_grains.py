"""Grains: rigid spheres and discs in frictional contact.

Question: how do a hundred spheres settle in a box, and how many contacts does each have?

    python workflows/guides/09_grains.py
"""

import numpy as np

from multiscale.macro import granulate

# Grains meet walls that are held, moved or loaded, or fill periodic cells: deposits, silos,
# collapses, and grains as the third body of a joint.
law = granulate.ContactLaw(friction=0.5, compliance=0.02)  # compliance 0: rigid
model = granulate.deposit(np.full(100, 0.01), (0.1, 0.1), law)  # spheres of 1 cm, box of 10 cm
motion = granulate.simulate_grains(model, duration=0.1, step=2e-3)
print(float(motion["converged"].mean()), motion.attrs["cautions"])  # share of steps solved
ends, force, branch = granulate.network(motion)  # of the last frame, N and m
print(granulate.coordination(ends, 100, rattlers_below=2))

# A step whose contacts miss their tolerance is marked in "converged" and "residual", and in
# "cautions". The force network, the energies, the errors and the stress curve are figures of
# multiscale.plotting; scenes also leave the grains and their forces as a series for ParaView.
#
# Without friction anywhere (friction=0) a contact has one unknown in place of three and nothing
# turns. A step then takes a third to a half of the time, and the result has no spins.
#
# With accuracy=0.1 steps change their length: in the step of an impact grains approach by at most a
# tenth of a radius, and "step" is the longest step. Free flight is then exact, and a grain that
# bounces from 1 m follows its closed form within 0.02 radii in 218 steps; 600 steps of 2 ms are off
# by half a radius. The key "accuracy" of [motion] does the same in a scene.
#
# Accuracy of rigid grains. Dense piles with friction rarely meet a tolerance of 1e-4 in hundreds of
# sweeps: of a deposit of 1000 spheres, 11 % of the steps do in 300 sweeps, with a median error of
# 5e-3 of the closing velocities. Of eight such steps 2000 sweeps, also proximal sweeps, left six
# above 1e-3, and the friction solver on the assembled operator left the one that it was given at
# 1.4e-3. Overlaps stay below a thousandth of a radius all the same. With a compliance of 0.02 every
# step meets the tolerance in 76 sweeps on average; with 0.005 still 99 % do, in 306 sweeps. Without
# restitution nothing overlaps by more than 0.8 % of a radius. Conjugate directions need one
# thread.
#
# Energy. Kinetic energy and the energy in overlaps grow by up to 1e-6 of all the work in a step
# with a compliance of 0.02, and by 2e-5 with 0.05. Grains with restitution bounce within a step of
# their impact and overlap as little as others. Grains without any loss, or nearly so, gain energy
# where several meet in a step, and most without friction: of all the work in a step up to 1.5 %
# with restitution 1 and friction .5, 5 % without friction, and with restitution 0.9 1e-4 and 0.4 %,
# in a deposit of 100 spheres of 1 cm with steps of 2 ms. With accuracy=0.05 the 5 % become 0.7 %.
# Grains lose in other steps what they win in one: their energy stayed below the energy at the
# start.
#
# Shear. shear_response gives the response of a sheared layer, from which fit_law takes a friction
# law through friction_observations. compact presses a periodic cell. biaxial_cell shortens the cell
# along z at a given rate while the pressure on its sides stays: biaxial_curve gives the stress
# ratio q/p and the volumetric strain against the axial strain. Smooth plates transmit less shear
# than the bulk bears, since spheres roll on them: with a friction of 0.5 between spheres the plates
# transmit 0.19 of the pressure, where the bulk mobilises 0.32 and more.
