"""Unknowns, operators and memory of a granulate, from its number of grains and contact law."""

from typing import TYPE_CHECKING

from multiscale.needs import Needs, choose

if TYPE_CHECKING:
    from multiscale.macro.granulate.model import ContactLaw, Solver

__all__ = ["grain_needs"]

PER_GRAIN, PER_UNKNOWN, PER_FRAME = 1450, 350, 400
"""Peak memory of a dense pile, byte: per grain, per grain and unknown of a contact, and per grain
and frame."""


def grain_needs(
    grains: int,
    frames: int,
    law: "ContactLaw",
    solver: "Solver",
    *,
    wall_friction: float = 0.0,
    strained: bool = False,
) -> Needs:
    """Return the unknowns, operators and memory of a simulation of grains.

    Examples
    --------
    >>> from multiscale.macro.granulate import ContactLaw, Solver
    >>> needs = grain_needs(1000, 11, ContactLaw(friction=0.5), Solver())
    >>> needs.unknowns_per_contact, "springs" in needs.built
    (3, False)
    >>> grain_needs(1000, 11, ContactLaw(friction=0.0), Solver()).unknowns_per_contact
    1
    """
    friction = max(law.friction, wall_friction) > 0.0
    parts = (
        ("sweeps", True, "over the contacts, one after the other, again and again", ""),
        ("friction", friction, "Coulomb's limit at each contact", "no friction is given"),
        ("rotation", friction, "spins and moments of inertia", "nothing turns the grains"),
        (
            "cell strain",
            strained,
            "rates along the axes, branch of each contact",
            "no cell strains",
        ),
        ("springs", law.compliance > 0.0, "of compliant contacts", "contacts are rigid"),
        ("restitution", law.restitution > 0.0, "of pairs that meet fast", "no pair bounces"),
        (
            "colours",
            solver.threads > 1 and not strained,
            "contacts that share no grain are swept side by side",
            "one thread sweeps in the order of the contacts",
        ),
        (
            "assembled problem",
            solver.most_assembled > 0 and not strained,
            f"all contacts at once, where sweeps fail on at most {solver.most_assembled} of them",
            "sweeps alone",
        ),
    )
    spin = ("spin",) if friction else ()
    unknowns = 3 if friction else 1
    return Needs(
        unknowns_per_contact=unknowns,
        kinematics="rigid grains in motion, impulses in place of forces",
        choices=tuple(choose(*part) for part in parts),
        state_variables=("position", "velocity", *spin, "impulse of each contact"),
        fields=("position", "velocity", *spin, "contact force"),
        libraries=("numba",),
        memory=grains * (PER_GRAIN + PER_UNKNOWN * unknowns + PER_FRAME * frames),
    )
