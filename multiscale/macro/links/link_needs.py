"""Unknowns, operators and memory of a structure of links, from its laws and the analysis."""

from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from multiscale.needs import Choice, Needs

if TYPE_CHECKING:
    from multiscale.macro.links.link_system import LinkSystem

__all__ = ["link_needs"]

LINK_MEMORY, UNKNOWN_MEMORY = (600, 200), (600, 100)
"""Peak memory per link and per unknown, byte: for operators and factors, and for the results of
each step. Measured on grids and nets of 12,000 to 58,000 links."""

SUPERLU_MEMORY = 2500
"""Additional memory per unknown, byte, if SuperLU factorises because pypardiso is missing."""

STEP_TIME = 8e-5
"""Time of an unknown in a step, s, on a grid of 9,400 unknowns."""


def link_needs(
    system: "LinkSystem",
    *,
    exact: bool = False,
    stability: bool = False,
    moving: bool = False,
    steps: int = 1,
) -> Needs:
    """Return the unknowns, operators and memory of an analysis of links.

    Examples
    --------
    >>> from multiscale.macro import tensegrity_grid
    >>> needs = link_needs(tensegrity_grid(2))
    >>> "tangent" in needs.built, "geometric stiffness" in needs.built
    (True, False)
    """
    links, unknowns = system.n_links, int((~np.asarray(system.fixed, dtype=bool)).sum())
    rigid = bool(np.isinf(system.stiffness).any())
    one_sided = bool(np.isfinite(system.bounds).any())
    choices = (
        Choice("tangent", "stiffness of the taut links"),
        Choice("slack", "cables without compression, struts without tension", one_sided),
        Choice("moved positions", "lengths and directions at the displaced nodes", exact),
        Choice("geometric stiffness", "of the tensions, for the tangent", exact or stability),
        Choice("eigenvalues", "the smallest of the tangent, for stability", stability),
        Choice("beam modes", "bending and twist, with nodal rotations", system.n_components == 6),
        Choice("mass", "of the nodes, in the matrix of every step", moving),
        Choice("impulses", "velocity jumps at links of fixed length", moving and rigid),
    )
    factors = 0 if find_spec("pypardiso") else SUPERLU_MEMORY
    link_memory, unknown_memory = (
        once + steps * each for once, each in (LINK_MEMORY, UNKNOWN_MEMORY)
    )
    return Needs(
        unknowns_per_contact=1,
        kinematics="large displacements" if exact else "small displacements",
        choices=choices,
        state_variables=("displacement", "velocity", "tension") if moving else (),
        fields=("tension", "slack", "displacement"),
        libraries=("numba",),
        seconds=STEP_TIME * unknowns * steps,
        memory=links * link_memory + unknowns * (unknown_memory + factors),
    )
