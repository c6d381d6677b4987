"""Large structures that carry interface laws.

Which solver takes which structure:

=====================================  ==========================================================
structure                              solvers
=====================================  ==========================================================
``LinkSystem``: bars, cables, beams    :func:`solve_static`, :func:`simulate`
``FiniteAssembly``: bodies of any bulk :func:`solve_contact`: Newton on displacement and reaction
law, Coulomb contact, large            together, or on the reactions alone where everything else is
displacement and sliding               linear
links or elastic bodies, cut           :func:`solve_latin`, :func:`solve_schur`: any interface law
(:func:`cut_links`, ``cut_assembly``)  between the bodies, many substructures, several processes
``Assembly``: elastic bodies, any      :func:`solve_assembly`: assembled Newton, LATIN, Newton-Schur
interface law, rigid plates, bolts
``RoughJoint``: two elastic blocks     :func:`rough_joint`: a normal law, condensed onto the jump;
                                       :func:`pressed_blocks` makes an ``Assembly`` of it
matrices of elastic bodies and a jump  :func:`solve_interface`: any law, all unknowns together
grains                                 :func:`granulate.simulate_grains`
=====================================  ==========================================================
"""

from multiscale.macro import granulate
from multiscale.macro.bodies import (
    Assembly,
    Bolt,
    BoltSection,
    GapMap,
    Interface,
    Platen,
    shank_stiffness,
)
from multiscale.macro.continuum import (
    Body,
    Contact,
    FiniteAssembly,
    RigidCylinder,
    RigidGraph,
    RigidPlane,
    RigidSphere,
    load_mesh,
    solve_contact,
)
from multiscale.macro.discrete import (
    LinkSystem,
    cable_net,
    prestress_by_itself,
    quadruplex_module,
    self_stress,
    solve_static,
    system_from_mesh,
    system_from_table,
    tensegrity_grid,
    truss,
)
from multiscale.macro.dynamics import simulate
from multiscale.macro.joint import (
    Block,
    RoughJoint,
    press_joint,
    pressed_blocks,
    rough_joint,
    soften,
)
from multiscale.macro.monolithic import solve_interface
from multiscale.macro.substructures import (
    AssembledNewton,
    LatinMethod,
    NewtonSchur,
    cut_links,
    homogenise,
    solve_assembly,
    solve_latin,
    solve_schur,
)

__all__ = [
    "AssembledNewton",
    "Assembly",
    "Block",
    "Body",
    "Bolt",
    "BoltSection",
    "Contact",
    "FiniteAssembly",
    "GapMap",
    "Interface",
    "LatinMethod",
    "LinkSystem",
    "NewtonSchur",
    "Platen",
    "RigidCylinder",
    "RigidGraph",
    "RigidPlane",
    "RigidSphere",
    "RoughJoint",
    "cable_net",
    "cut_links",
    "granulate",
    "homogenise",
    "load_mesh",
    "press_joint",
    "pressed_blocks",
    "prestress_by_itself",
    "quadruplex_module",
    "rough_joint",
    "self_stress",
    "shank_stiffness",
    "simulate",
    "soften",
    "solve_assembly",
    "solve_contact",
    "solve_interface",
    "solve_latin",
    "solve_schur",
    "solve_static",
    "system_from_mesh",
    "system_from_table",
    "tensegrity_grid",
    "truss",
]

__dir__ = __all__.copy
