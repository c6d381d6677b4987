"""Structures in contact: bodies on any mesh, with friction, and their solvers.

Question: which pressure does a block exert on a floor when its top is pushed down and sideways?

    python workflows/guides/06_contact.py
"""

import numpy as np
from skfem import MeshQuad

from multiscale.laws.bulk import Elastic
from multiscale.macro import Body, Contact, FiniteAssembly, RigidPlane, solve_contact
from multiscale.nonsmooth import solve_friction

# Bodies are elastic, hyperelastic or plastic, on any two- or three-dimensional mesh with named
# boundaries: of scikit-fem, or from a file of gmsh, Salome, Abaqus and others. They touch each
# other, also with non-matching meshes, and rigid obstacles, with Coulomb friction.
mesh = MeshQuad().refined(3).with_defaults()  # a unit square with named sides
block = Body(mesh, Elastic(1e9, 0.3), supports={"top": (1e-4, -1e-3)})
floor = RigidPlane((0.0, 0.0), (0.0, 1.0))
problem = FiniteAssembly(
    {"block": block}, {"floor": Contact(("block", "bottom"), floor, friction_coefficient=0.2)}
)
step = solve_contact(problem)[-1].unwrap()
print(step.contact["floor"].pressure)  # Pa, at the nodes of the contact

# The solvers of complementarity and friction problems take plain arrays and return a Solution:
# value, status, residuals with their times, and the methods tried. The status follows from an
# independent check of the residual.
#
# A mass of 2 kg hits the ground at 1 m/s while it slides at 3 m/s, friction coefficient 0.5:
solution = solve_friction(np.diag([0.5, 0.5]), np.array([-1.0, 3.0]), np.array([0.5]))
print(solution.status.name, solution.value)  # N s, normal first
