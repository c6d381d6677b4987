"""Grains: rigid spheres and discs in frictional contact.

Question: how do a hundred spheres settle in a box, and how many contacts does each have?

    python workflows/guides/09_grains.py
"""

import numpy as np

from multiscale.macro import granulate

# Grains touch walls that are fixed, moved or loaded, or fill periodic cells: deposits, silos,
# collapses, and grains as the third body of a joint.
law = granulate.ContactLaw(friction=0.5, compliance=0.02)  # compliance 0: rigid
model = granulate.deposit(np.full(100, 0.01), (0.1, 0.1), law)  # spheres of 1 cm, box of 10 cm
motion = granulate.simulate_grains(model, duration=0.1, step=2e-3)
print(float(motion["converged"].mean()), motion.attrs["cautions"])  # share of steps solved
ends, force, branch = granulate.network(motion)  # of the last frame, N and m
print(granulate.coordination(ends, 100, rattlers_below=2))

# A step with contacts above their tolerance is marked in "converged" and "residual", and in
# "cautions". The force network, the energies, the errors and the stress curve are figures of
# multiscale.plotting; scenes also write the grains and their forces as a series for ParaView.
#
# Without friction (friction=0) a contact has one unknown in place of three and no grain rotates. A
# step then takes a third to a half of the time, and the result has no spins.
#
# With accuracy=0.1 steps have variable lengths: in the step of an impact grains approach by at most
# a tenth of a radius, and "step" is the longest step. Free flight is then exact, and a grain that
# bounces from 1 m follows its closed form within 0.02 radii in 218 steps; with 600 steps of 2 ms
# the error is half a radius. The key "accuracy" of [motion] does the same in a scene.
#
# Accuracy of rigid grains. Dense piles with friction rarely meet a tolerance of 1e-4 in hundreds of
# sweeps: in a deposit of 1000 spheres, 11 % of the steps do so in 300 sweeps, with a median error
# of 5e-3 of the closing velocities. More sweeps or the friction solver do not help, because
# friction makes the rigid problem non-monotone. Three remedies:
#
# - tangential_compliance=0.1 leaves the normal direction rigid, and sticking contacts creep while
#   their force changes: all steps of this deposit meet 1e-4, in 200 sweeps on average, and overlaps
#   stay below 3e-4 radii;
# - compliance=0.02 in all directions takes 77 sweeps, half the time of the first remedy, with
#   overlaps of up to 0.8 % of a radius;
# - without friction an interior point method follows the first 200 sweeps and solves every step.
#
# Restitution. Pairs that meet fast bounce in turn, at their times in the step, before the contacts
# are solved. A bounce never gains energy, also in clusters: with restitution 1 and without friction
# the energy of 60 spheres is constant to 1e-14 over 150 steps, and a row of balls transfers its
# velocity to the last ball; with friction or restitution 0.9 the energy falls in every step. With
# smaller restitution and equal steps, relaxing overlaps may add 1e-5 of all the work in a step.
# Kinetic energy and work of grains with restitution are evaluated at the middle of each step.
#
# Energy. Kinetic energy and the energy of springs grow by up to 1e-6 of all the work in a step with
# a compliance of 0.02, and by 2e-5 with 0.05.
#
# Shear. shear_response gives the response of a sheared layer, from which fit_law takes a friction
# law through friction_observations. compact presses a periodic cell. biaxial_cell shortens the cell
# along z at a given rate and constant pressure on its sides: biaxial_curve returns the stress
# ratio q/p and the volumetric strain against the axial strain. Smooth plates transmit less shear
# than the bulk, since spheres roll on them: with a friction of 0.5 between spheres the shear is
# 0.19 of the pressure at the plates, and 0.32 or more in the bulk.
