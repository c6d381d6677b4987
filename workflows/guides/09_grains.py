"""Grains: rigid spheres and discs in frictional contact.

Question: how do a hundred spheres settle in a box, and how many contacts does each have?

    python workflows/guides/09_grains.py
"""

import numpy as np

from multiscale.macro import granulate

# Grains meet walls that are fixed, moved or loaded, or fill periodic cells: deposits, silos,
# collapses, and grains as the third body of a joint.
law = granulate.ContactLaw(friction=0.5, compliance=0.02)  # compliance 0: rigid
model = granulate.deposit(np.full(100, 0.01), (0.1, 0.1), law)  # spheres of 1 cm, box of 10 cm
motion = granulate.simulate_grains(model, duration=0.1, step=2e-3)
print(float(motion["converged"].mean()), motion.attrs["cautions"])  # share of steps solved
ends, force, branch = granulate.network(motion)  # of the last frame, N and m
print(granulate.coordination(ends, 100, rattlers_below=2))

# A step with contacts above their tolerance is marked in "converged" and "residual", and in
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
# 5e-3 of the closing velocities, and neither more sweeps nor the friction solver help: friction
# makes the rigid problem non-monotone. Three remedies:
#
# - tangential_compliance=0.1 leaves the normal direction rigid, and contacts that stick creep while
#   their force changes: all steps of this deposit meet 1e-4, in 200 sweeps on average, and overlaps
#   stay below 3e-4 radii;
# - compliance=0.02 along and across the normal takes 77 sweeps, half the time of the former, with
#   overlaps of up to 0.8 % of a radius;
# - without friction interior points follow the first 200 sweeps, and every step is solved.
#
# Restitution. Pairs that meet fast bounce in turn, at their times in the step, before the contacts
# are solved. A bounce never gains energy, also in clusters: with restitution 1 and without friction
# 150 steps of a deposit of 60 spheres keep it within 1e-14, a row of balls hands its velocity to
# the last one, and with friction or restitution 0.9 it falls in every step. With smaller
# restitution and in steps of one length overlaps that relax may add 1e-5 of all the work in a step.
# Kinetic energy and work of grains with restitution belong to the middle of each step.
#
# Energy. Kinetic energy and the energy of springs grow by up to 1e-6 of all the work in a step with
# a compliance of 0.02, and by 2e-5 with 0.05.
#
# Shear. shear_response gives the response of a sheared layer, from which fit_law takes a friction
# law through friction_observations. compact presses a periodic cell. biaxial_cell shortens the cell
# along z at a given rate while the pressure on its sides stays: biaxial_curve gives the stress
# ratio q/p and the volumetric strain against the axial strain. Smooth plates transmit less shear
# than the bulk bears, since spheres roll on them: with a friction of 0.5 between spheres the plates
# transmit 0.19 of the pressure, where the bulk mobilises 0.32 and more.
