"""Unknowns, operators and memory of a structure of links, from its laws and the analysis."""

from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from multiscale.needs import Needs, choose

if TYPE_CHECKING:
    from multiscale.macro.discrete.link_system import LinkSystem

__all__ = ["link_needs"]

LINK_MEMORY, UNKNOWN_MEMORY = (600, 200), (600, 100)
"""Peak memory per link and per unknown, byte: for operators and factors, and for the results of
each step. Measured on grids and nets of 12,000 to 58,000 links."""

SUPERLU_MEMORY = 2500
"""Additional memory per unknown, byte, if SuperLU factorises because pypardiso is missing."""

STEP_TIME = 8e-5  # s of an unknown in a step, on a grid of 9,400 unknowns


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
    unknowns = int((~np.asarray(system.fixed, dtype=bool)).sum())
    rigid = bool(np.isinf(system.stiffness).any())
    lower, upper = system.bounds
    one_sided = bool((np.isfinite(lower) | np.isfinite(upper)).any())
    parts = (
        ("tangent", True, "stiffness of the links that are taut", ""),
        (
            "slack",
            one_sided,
            "a cable or strut that would bear the other sign carries nothing",
            "every link carries tension and compression",
        ),
        (
            "moved positions",
            exact,
            "lengths and directions follow the nodes",
            "displacements count as small",
        ),
        (
            "geometric stiffness",
            exact or stability,
            "of the tensions, in the tangent" + ("" if exact else " whose eigenvalue is sought"),
            "displacements count as small",
        ),
        (
            "eigenvalues",
            stability,
            "smallest ones of the tangent, without and with geometric stiffness",
            "not asked for",
        ),
        (
            "beam modes",
            system.n_components == 6,
            "bending and twist, with the rotations of the nodes",
            "links carry a tension alone",
        ),
        ("mass", moving, "of the nodes, in the matrix of every step", "at rest"),
        (
            "impulses",
            moving and rigid,
            "jumps of velocity where links of fixed length become taut",
            "every link is extensible" if moving else "at rest",
        ),
    )
    factors = 0 if find_spec("pypardiso") else SUPERLU_MEMORY
    return Needs(
        unknowns_per_contact=1,
        kinematics="large displacements" if exact else "small displacements",
        choices=tuple(choose(*part) for part in parts),
        state_variables=("displacement", "velocity", "tension") if moving else (),
        fields=("tension", "slack", "displacement"),
        libraries=("numba",),
        seconds=STEP_TIME * unknowns * steps,
        memory=factors * unknowns
        + sum(
            count * (once + steps * each)
            for count, (once, each) in ((system.n_links, LINK_MEMORY), (unknowns, UNKNOWN_MEMORY))
        ),
    )
