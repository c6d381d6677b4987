"""Substructures and rough joints: preload, shear cycles, stick, slip and loss.

Question: how stiff is the joint of two blocks, where does it slip, and what does a cycle dissipate?

    python workflows/guides/08_joints.py

reads the law in the folder ``results`` of the first command in the README.
"""

from multiscale.io import open_law
from multiscale.laws import Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import LatinMethod
from multiscale.macro.bodies import stacked_blocks
from multiscale.macro.substructures import joint_path, load_joint
from multiscale.upscaling import law_from_dataset

# A micro-macro method solves the substructures of a structure in parallel. The interface between
# two bodies has a law, here the fitted law with friction: a bed of springs that slip one after the
# other. The friction coefficient and the ratio of tangential to normal stiffness are assumptions;
# cells dissipate 2 to 10 % more in a cycle than the bed.
normal = law_from_dataset(open_law("results/interface_law.nc"))
law = Sliders(normal, friction=0.2, stiffness_ratio=0.8)
steel = Elastic(210e9, 0.3)
blocks = stacked_blocks((0.04, 0.02, 0.01), (4, 2, 1), [steel, steel], [law])
loading = joint_path((5e6, 10e6, 20e6), shear=3e6, cycles=1, steps=4)  # Pa
joint = load_joint(blocks, loading, method=LatinMethod(parts=(2, 1)))
print(joint["joint_stiffness"].values[:3], joint["tangential_stiffness"].values[:3])  # Pa/m
print(joint["slip_fraction"].values)  # share of the joint that slips in a step
print(joint["cycle_energy"].values)  # J

# Both sides of an interface are plane; their meshes need not match. A shear beyond friction ends
# the steps, and the result reports the step. With LATIN a joint may also be rigid (RigidContact:
# unilateral, with Coulomb friction). An Assembly consists of bodies, interfaces between their faces
# and load cases; solve_assembly solves it by AssembledNewton, LatinMethod or NewtonSchur.
#
# The scenes rough_blocks.toml and lap_joint.toml do the same from files. The case bolted_lap starts
# from its surfaces, and takes friction and tangential stiffness from its cells. Lap joints are two
# plates with a bolt hole, meshed by gmsh; the bolt is a constant pressure under its washers, or has
# an elastic shank (bolt = "8 mm") with a variable force. In a case blocks and joints may have
# damage, damage = [0.3, 0], and blocks may have the elastic tensor of a representative volume
# (rve). With homogenise = true in [substructures] a dataset has the stiffness of every substructure
# against the resultants of its interfaces, before and after slackening.
#
# multiscale macro prints, at each preload, the stiffness, the shares that stick, slip and are open,
# the energy dissipated in a cycle, and a caution with the share of the load outside the data of the
# law. If the law has a budget, each answer has the two intervals of guide 02. The dataset has
# traction, jump, state and dissipation at every point. The page draws zones, pressure, loop and
# loss (multiscale.plotting.joint_pictures). The series for ParaView has displacement, von Mises
# stress, strain energy and damage of the bodies, and gap, pressure, shear and state of the joint.
#
# Under mpiexec (pip install '.[mpi]') processes share the substructures, with the same answer:
#
#   mpiexec -n 2 multiscale macro workflows/scenes/tensegrity_substructures.toml -o macro_result.nc
#
# In one process the solver of the whole structure (solve_static) is faster at every size measured,
# up to 128 x 128 modules. NewtonSchur is a Newton method on the interfaces, next to the micro-macro
# LatinMethod; microcases/manual/substructures.md compares their counts.
